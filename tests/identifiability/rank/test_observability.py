"""The rank of the observability matrix is exact: full rank is a proof, a deficiency has a bound."""

from __future__ import annotations

import json
import math
from fractions import Fraction
from types import SimpleNamespace

import casadi as ca
import mpmath
import numpy as np
import pytest
import sympy as sp
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from casid.algebra.prime_field import (
    echelon,
    inverse,
    is_prime,
    matmul,
    null_space,
    random_prime,
    rank,
    to_field,
    to_rational,
)
from casid.errors import ModelError
from casid.identifiability.equations.equation_file import parse_system, read_equations
from casid.identifiability.equations.system import System
from casid.identifiability.rank.error_bound import failure_probabilities, minor_sizes
from casid.identifiability.rank.observability import observability, rank_at
from casid.identifiability.rank.program_reader import program_of
from casid.identifiability.rank.series import Schedule, Series
from tests.support.shared import shared

P = 2_147_483_629  # the second largest prime below 2^31
FILES = (
    *("akt_fujita", "bilirubin", "cgv1990", "crauste", "crn", "goodwin", "hdnl", "hiv_wodarz"),
    *("jakstat", "kd1999", "leukaemia", "llw", "mapk6", "nfkb_full", "pharm", "qy", "seaijrc"),
    *("si_issue419", "si_issue503", "siwr1"),
)


def system(equations, outputs, params, **fields):
    """A system from formulas."""
    mapping = {
        "states": list(equations),
        "params": params,
        "equations": equations,
        "outputs": outputs,
        **fields,
    }
    return parse_system(mapping, name="example")


def of_file(name):
    path = shared(f"identifiability/{name}.json")
    return read_equations(path).systems[0], json.loads(path.read_text())["expected"]


# -- published models --------------------------------------------------------------------------


@pytest.mark.parametrize("name", FILES)
def test_published_models_have_their_rank_and_their_verdicts(name):
    """Models and answers of StructuralIdentifiability.jl and STRIKE-GOLDD."""
    model, expected = of_file(name)
    found = observability(model)
    assert (found.rank, found.unknowns) == (expected["rank"], expected["unknowns"])
    assert found.deficiency == expected.get("parameter_deficiency", found.deficiency)
    for parameter in expected["locally_identifiable"]:
        assert found.identifiable[parameter], parameter
    for parameter in expected["non_identifiable"]:
        assert not found.identifiable[parameter], parameter
    for state in expected.get("observable_states", []):
        assert found.observable[0][state], state
    for state in expected.get("unobservable_states", []):
        assert not found.observable[0][state], state
    assert found.is_certified
    assert not found.is_partial
    assert found.error_bound == 0.0 if found.is_full else found.error_bound <= 1e-12


@pytest.mark.parametrize("name", ["me_catenary5", "me_cyclic5"])
def test_each_replicate_with_states_of_its_own_tells_more(name):
    model, expected = of_file(name)
    counts = expected["parameter_deficiency_by_number_of_replicates"]
    found = [observability([model] * n).deficiency for n in range(1, len(counts) + 1)]
    assert found == counts
    assert found.index(0) + 1 == expected["replicates_needed"]


def test_known_initial_states_are_no_unknowns_and_may_tell_parameters():
    model, expected = of_file("si_issue503")
    some = observability(model.where(known_initial=("x1",)))
    assert (some.rank, some.unknowns) == (8, 10)
    assert not any(some.identifiable.values())
    every = observability(model.where(known_initial=model.states))
    assert (every.rank, every.unknowns, every.error_bound) == (7, 7, 0.0)
    assert all(every.identifiable.values())


# -- traps -------------------------------------------------------------------------------------


def riccati(power=2, **fields):
    return system({"S": f"1 + a*S**{power}"}, {"y": "S"}, ["a"], **fields)


def test_at_a_special_initial_value_a_derivative_without_news_is_not_the_last():
    """S' = 1 + a S^2, S(0) = 0: S = t + a t^3/3 + ..., so a first shows in the third derivative."""
    found = observability(riccati(known_initial={"S": 0}))
    assert (found.rank, found.unknowns, found.orders) == (1, 1, (3,))
    assert found.identifiable == {"a": True}
    assert observability(riccati()).orders < found.orders


def test_a_special_point_that_tells_less_than_its_neighbours_is_not_certified():
    """S' = 1 + a S^m, S(0) = 0: a shows in derivative m + 1, past every patience if m is large."""
    assert observability(riccati(9, known_initial={"S": 0})).identifiable == {"a": True}
    late = observability(riccati(40, known_initial={"S": 0}))
    assert (late.identifiable, late.is_certified) == ({"a": False}, False)
    # Where the rank is what it is almost everywhere, nothing later can add to it.
    same = system({"x": "-k*x"}, {"y": "c*x"}, ["k", "c"], known_initial={"x": 1})
    assert observability(same).is_certified
    lost = system({"x": "-a*b*x"}, {"y": "x"}, ["a", "b"], known_initial={"x": 1})
    deficient = observability(lost)
    assert (deficient.rank, deficient.unknowns, deficient.is_certified) == (1, 2, True)


@pytest.mark.parametrize(
    ("equation", "state"),
    [
        ("a*sin(x)", 0),
        ("a*(1 - cos(x))", 0),
        ("a*tan(x)", 0),
        ("a*(exp(x) - 1)", 0),
        ("a*log(x)", 1),
        ("a*tanh(x)", 0),
        ("a*sinh(x)", 0),
        ("a*atan(x)", 0),
        ("a*asin(x)", 0),
        ("a*(sqrt(x) - 2)", 4),
        ("a*(1 - x**(1/3))", 1),
    ],
)
def test_at_rest_nothing_is_told(equation, state):
    """A transcendental function keeps its value where it is rational, such as sin 0 = 0."""
    model = system({"x": equation}, {"y": "x"}, ["a"], known_initial={"x": state})
    assert observability(model).identifiable == {"a": False}
    moving = model.where(initial_values={"x": Fraction(1, 3)})
    assert observability(moving).identifiable == {"a": True}


@pytest.mark.parametrize(
    "zero",
    [
        "exp(x)*exp(-x) - 1",
        "exp(2*x) - exp(x)**2",
        "exp(x) - exp(x/2)**2",
        "exp(x/2)*exp(x/3) - exp(5*x/6)",
        "exp(-b*x)*exp(b*x) - 1",
        "(exp(x) - 1)/(exp(x) + 1) - tanh(x/2)",
        "tanh(x)*cosh(x) - sinh(x)",
        "sin(x)**2 + cos(x)**2 - 1",
        "sin(-x) + sin(x)",
        "cos(-x) - cos(x)",
        "x**1.5 - x*sqrt(x)",
        "exp(b + x) - exp(b)*exp(x)",
        "log(b*x) - log(b) - log(x)",
        "log(b/x) - log(b) + log(x)",
        "log(b**3) - 3*log(b)",
        "log(exp(b*x)) - b*x",
        "exp(log(b)) - b",
        "sqrt(b*x) - sqrt(b)*sqrt(x)",
        "(b*x)**0.3 - b**0.3*x**0.3",
        "(2*x)**b - 2**b*x**b",
        "sign(2*x) - sign(x)",
        "abs(-x) - abs(x)",
    ],
)
def test_an_identity_between_functions_tells_nothing(zero):
    model = system({"x": "-x + b*x**2"}, {"y": f"a*({zero})", "y2": "x"}, ["a", "b"])
    assert observability(model).identifiable == {"a": False, "b": True}


def test_an_unlucky_prime_hides_a_parameter_and_random_primes_do_not():
    model = system({"x": f"-{P}*k*x"}, {"y": "x"}, ["k"])
    assert observability(model, primes=[P]).identifiable == {"k": False}
    other = observability(model, primes=[2_147_483_647])
    assert other.identifiable == {"k": True}
    assert other.error_bound == 0.0
    for seed in range(20):
        assert observability(model, seed=seed).is_full


def test_a_parameter_at_zero_takes_with_it_what_it_multiplies():
    model = system({"x": "-c*k*x"}, {"y": "x", "y2": "c"}, ["k", "c"])
    assert observability(model).identifiable == {"k": True, "c": True}
    found = observability(model.where(at={"c": Fraction(0)}))
    assert found.identifiable == {"k": False, "c": True}
    assert not found.is_certified
    assert observability(model.where(at={"c": Fraction(1, 3)})).is_full


def test_equal_rates_cannot_be_told_apart_from_one_another():
    """Two modes with rates k1 = k2 are one: their weights are told as a sum only."""
    equations = {"x1": "-k1*x1", "x2": "-k2*x2"}
    names = ["k1", "k2", "c"]
    model = system(equations, {"y": "x1 + c*x2"}, names, known_initial=["x1"])
    at_one = observability(model.where(at={"k1": Fraction(2), "k2": Fraction(2)}))
    assert at_one.rank < observability(model).rank


# -- immersion ---------------------------------------------------------------------------------

SYMPY = SimpleNamespace(
    **{n: getattr(sp, n) for n in ("sin", "cos", "tan", "exp", "log", "sqrt", "asin", "acos")},
    **{n: getattr(sp, n) for n in ("atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh")},
    **{n: getattr(sp, n) for n in ("erf", "atan2", "sign")},
    fabs=sp.Abs,
    third=sp.Rational(1, 3),
)
CASADI = SimpleNamespace(
    **{n: getattr(ca, n) for n in vars(SYMPY) if n != "third"}, third=Fraction(1, 3).__float__()
)
FUNCTIONS = {
    **{
        name: lambda m, z, n, name=name: getattr(m, name)(z)
        for name in vars(SYMPY)
        if name not in ("third", "atan2", "acosh", "fabs", "sign")
    },
    "acosh": lambda m, z, n: m.acosh(1 + z),
    "atan2": lambda m, z, n: m.atan2(z, 1 + n),
    "third": lambda m, z, n: z**m.third,
    "power n": lambda m, z, n: z**n,
    "power 1.5": lambda m, z, n: z**1.5 if m is CASADI else z ** sp.Rational(3, 2),
    "power -2": lambda m, z, n: z**-2,
    "mixed": lambda m, z, n: m.exp(-n * z) * m.sin(z),
}
MODELS = {
    "scaled": lambda F, m, x, v, a, b, n: ([-a * F(m, b * x, n)], [x]),
    "scaled twice": lambda F, m, x, v, a, b, n: ([-a * b * F(m, x, n)], [x + n]),
    "hidden": lambda F, m, x, v, a, b, n: ([v, -a * F(m, x, n) - b * v], [n * v]),
}


def immersed(function, model):
    """The model in CasADi, and by sympy's Lie derivatives at 60 digits: rank and verdicts."""
    F, equations = FUNCTIONS[function], MODELS[model]
    names = ["x", "v", "a", "b", "n"]
    sx = {n: ca.SX.sym(n) for n in names}
    f, h = equations(F, CASADI, *sx.values())
    states = ("x", "v")[: len(f)]
    made = System(
        name=f"{model} {function}",
        states=states,
        parameters=("a", "b", "n"),
        outputs=tuple(f"y{i}" for i in range(len(h))),
        symbols={n: sx[n] for n in (*states, "a", "b", "n")},
        f=ca.vertcat(*f),
        h=ca.vertcat(*h),
    )
    symbols = {n: sp.Symbol(n, positive=True) for n in names}
    return made, numerical_rank(*equations(F, SYMPY, *symbols.values()), symbols, states)


def numerical_rank(f, h, symbols, states):
    """Rank and, column by column, whether leaving it out lowers the rank; with a clear gap."""
    columns = [symbols[n] for n in (*states, "a", "b", "n")]
    point = dict(zip(columns, [sp.Rational(k, 97) for k in (31, 47, 59, 41, 67)], strict=False))
    rows = []
    derivatives = [sp.sympify(y) for y in h]
    for _ in range(len(columns) + 1):
        for y in derivatives:
            rows.append([sp.diff(y, c).evalf(60, subs=point) for c in columns])
        derivatives = [
            sum(sp.diff(y, symbols[s]) * g for s, g in zip(states, f, strict=True))
            for y in derivatives
        ]
    with mpmath.workdps(60):
        matrix = [[mpmath.mpf(str(v)) for v in row] for row in rows]

    def rank_of(chosen):
        with mpmath.workdps(60):
            part = mpmath.matrix([[row[j] for j in chosen] for row in matrix])
            values = [v / mpmath.norm(part) for v in mpmath.svd_r(part, compute_uv=False)]
        assert not any(1e-40 < v < 1e-20 for v in values), values  # a gap of twenty digits
        return sum(1 for v in values if v >= 1e-20)

    every = range(len(columns))
    total = rank_of(every)
    return total, [rank_of([k for k in every if k != j]) < total for j in every]


@pytest.mark.parametrize(
    ("function", "model"),
    [
        *((f, "scaled") for f in FUNCTIONS if f != "mixed"),
        pytest.param("mixed", "scaled", marks=pytest.mark.slow),
        *(pytest.param(f, "scaled twice", marks=pytest.mark.slow) for f in FUNCTIONS),
        *((f, "hidden") for f in ("sin", "exp", "log", "sqrt", "power n")),
    ],
)
def test_the_rational_immersion_has_the_rank_of_the_function_itself(function, model):
    """Against Lie derivatives of the function itself, by sympy, evaluated with 60 digits."""
    made, (expected, told) = immersed(function, model)
    found = observability(made)
    assert found.rank == expected
    verdicts = [*found.observable[0].values(), *found.identifiable.values()]
    assert verdicts == told


def test_each_side_of_a_kink_tells_its_own():
    """x' = -a x where x > 0 and -b x where x < 0: a record on each side tells a and b."""
    rate = "(a*(1 + sign(x)) + b*(1 - sign(x)))/2"
    found = observability(system({"x": f"-({rate})*x"}, {"y": "x"}, ["a", "b"]))
    assert found.has_kinks
    assert found.is_full
    scaled = observability(system({"x": "-a*abs(b*x)"}, {"y": "x"}, ["a", "b"]))
    assert (scaled.rank, scaled.unknowns) == (2, 3)
    lost = observability(system({"x": "-a*sign(b*x)"}, {"y": "x"}, ["a", "b"]))
    assert not lost.identifiable["b"]


def test_a_parameter_that_acts_in_one_quadrant_only_is_found():
    quadrant = "a*(1 + sign(x))*(1 - sign(z))*(1 + sign(v))*(1 - sign(w))"
    states = {n: f"-{k}*{n}" for k, n in enumerate("xzvw", 1)}
    outputs = {"y": quadrant, **{f"y{n}": n for n in states}}
    for seed in range(5):
        assert observability(system(states, outputs, ["a"]), seed=seed).is_full
    five = {**states, "r": "-5*r"}
    many = system(five, {"y": f"{quadrant}*(1 - sign(r))*b*c", "yr": "r"}, ["a", "b", "c"])
    assert not observability(many).is_certified


@pytest.mark.parametrize(
    ("name", "expression"),
    [
        (r"fmin \(min\)", lambda x, a: a * ca.fmin(x, 1)),
        (r"fmax \(max\)", lambda x, a: a * ca.fmax(x, 1)),
        ("floor", lambda x, a: a * ca.floor(x)),
        ("ceil", lambda x, a: a * ca.ceil(x)),
        ("fmod", lambda x, a: ca.fmod(x, a)),
        ("lt", lambda x, a: ca.if_else(x < 1, a, x)),
        ("erfinv", lambda x, a: a * ca.erfinv(x)),
    ],
)
def test_what_no_differential_equation_describes_is_refused_by_name(name, expression):
    x, a = ca.SX.sym("x"), ca.SX.sym("a")
    made = System("kinked", ("x",), ("a",), ("y",), {"x": x, "a": a}, expression(x, a), x)
    with pytest.raises(ModelError, match=rf"kinked: {name} is neither rational.*tanh"):
        observability(made)


# -- bad input ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fields",
    [
        {"equations": {"x": "a/((x + a)**2 - x*x - 2*a*x - a*a)"}},
        {"equations": {"x": "x/a"}, "parameters_at": {"a": 0}},
        {"equations": {"x": "a*log(x)"}, "known_initial": {"x": 0}},
        {"equations": {"x": "a*sqrt(x)"}, "known_initial": {"x": 0}},
    ],
)
def test_a_model_without_a_point_is_refused(fields):
    made = parse_system({"states": ["x"], "params": ["a"], "outputs": {"y": "x"}, **fields})
    with pytest.raises(ModelError, match="no point was found.*special values"):
        observability(made)


def test_unknown_inputs_and_no_experiment_are_refused_with_what_to_do():
    made = system({"x": "-a*x + w"}, {"y": "x"}, ["a"], unknown_inputs=["w"])
    with pytest.raises(ModelError, match="w is an unknown input; eliminate it"):
        observability(made)
    with pytest.raises(ModelError, match="no experiment given; name"):
        observability([])


def test_known_inputs_and_their_derivatives_are_one_signal():
    """y = u' - b u of x' = u with b u from the input itself: b is told, and no more than b."""
    x, b, u, du = (ca.SX.sym(n) for n in ("x", "b", "u", "du"))
    made = System(
        "differentiated",
        ("x",),
        ("b",),
        ("y",),
        {"x": x, "b": b, "u": u, "du": du},
        du,
        b * (x - u),
        inputs=("u",),
        input_derivatives={"du": ("u", 1)},
    )
    # x - u is constant: y = b (x(0) - u(0)), one number for b and x(0).
    found = observability(made)
    assert (found.rank, found.unknowns) == (1, 2)
    assert observability(made.where(known_initial=("x",))).is_full
    free = made.where(inputs=("u", "du"), input_derivatives={})
    assert observability(free).is_full


def test_at_a_constant_input_less_is_told_than_by_a_moving_one():
    moving = system({"x": "-a*x + b*u"}, {"y": "x - c"}, ["a", "b", "c"], inputs=["u"])
    constant = system({"x": "-a*x + b*u"}, {"y": "x - c"}, ["a", "b", "c"], known_constants=["u"])
    assert observability(moving).is_full
    assert observability(constant).rank == observability(moving).rank - 1


# -- cut short ---------------------------------------------------------------------------------


def test_what_a_time_limit_or_an_order_cuts_is_proven_as_far_as_it_goes():
    model, _ = of_file("nfkb_full")
    whole = observability(model)
    ranks = []
    for order in range(8):
        cut = observability(model, max_order=order)
        ranks.append(cut.rank)
        assert cut.is_partial
        assert math.isnan(cut.error_bound)
        assert not cut.is_certified
        assert max(cut.orders) <= order
        assert all(whole.identifiable[p] for p, told in cut.identifiable.items() if told)
        assert all(whole.observable[0][x] for x, told in cut.observable[0].items() if told)
    assert ranks == sorted(ranks)
    assert whole.orders == (8,)  # the last one, which adds nothing
    assert ranks[-1] == whole.rank
    none = observability(model, time_limit=0.0)
    assert none.is_partial
    assert none.rank < whole.rank
    assert not observability(model, time_limit=3600.0).is_partial


def test_full_rank_before_the_cut_is_no_partial_answer():
    model, _ = of_file("hdnl")
    assert observability(model, max_order=2).is_full
    assert not observability(model, max_order=2).is_partial
    assert observability(model, max_order=1).is_partial


# -- the error bound ---------------------------------------------------------------------------

RATIONAL = {
    "rates": ({"x": "-a*x + b/(c + x)"}, {"y": "x"}, ["a", "b", "c"]),
    "nested": ({"x": "a/(1 + x/(b + x))"}, {"y": "b*x/3 + x**2/7"}, ["a", "b"]),
    "decimals": ({"x": "0.37*a*x - 1.25*x**3/b"}, {"y": "a*x"}, ["a", "b"]),
    "two states": ({"x": "-a*x*z", "z": "a*x*z - b*z**2"}, {"y": "z"}, ["a", "b"]),
}


@pytest.mark.parametrize("name", RATIONAL)
def test_no_minor_exceeds_the_degree_and_the_norm_that_the_bound_counts(name):
    """The minors of the rows' numerators over a common denominator, by sympy."""
    equations, outputs, params = RATIONAL[name]
    made = system(equations, outputs, params)
    program = program_of(made)
    x = [sp.Symbol(n) for n in (*made.states, *made.parameters)]
    table = {s.name: s for s in x}
    f, h = (
        [sp.sympify(text, locals=table, rational=True) for text in texts.values()]
        for texts in (equations, outputs)
    )
    order = 1 if name == "nested" else len(x) - 1
    lie = [h]
    for _ in range(order):
        lie.append([sum(sp.diff(y, s) * g for s, g in zip(x, f, strict=False)) for y in lie[-1]])
    rows = [[sp.diff(y, s) for s in x] for ys in lie for y in ys]
    sizes = minor_sizes(program, len(rows), order)
    denominators = math.lcm(*(c.denominator for t in program.sums.values() for c in t.values()))
    columns = list(range(len(x)))[: len(rows)]
    minor = sp.Matrix([[row[j] for j in columns] for row in rows[: len(columns)]]).det()
    numerator = sp.Poly(sp.numer(sp.together(minor)), *x)
    size = sizes[order]
    assert numerator.total_degree() <= size.degree
    content, primitive = numerator.clear_denoms()[1].primitive()
    norm = float(sp.log(sum(abs(c) for c in primitive.coeffs()), 2))
    assert norm <= size.bits + size.cleared * math.log2(denominators)
    assert content != 0


def test_each_further_point_lowers_the_error_bound():
    model, _ = of_file("goodwin")
    rng = np.random.default_rng(4)
    primes = [random_prime(rng) for _ in range(5)]
    bounds = [observability(model, primes=primes[:n]).error_bound for n in range(1, 6)]
    assert all(later < 1e-2 * earlier for earlier, later in zip(bounds, bounds[1:], strict=False))
    strict = observability(model, error_bound=1e-30)
    assert strict.error_bound <= 1e-30
    assert len(strict.points) > len(observability(model).points)


def test_the_bound_grows_with_rank_order_and_copies():
    program = program_of(system(*RATIONAL["rates"]))
    at = failure_probabilities(program, 3, 5, columns=4)
    assert at == sorted(at)
    by_rank = [failure_probabilities(program, r, 5, columns=9)[-1] for r in range(8)]
    assert by_rank == sorted(by_rank)
    one, two = (failure_probabilities(program, 6, 5, columns=8, copies=c)[-1] for c in (1, 2))
    assert two >= one


def test_degrees_beyond_the_prime_end_with_a_bound_of_one():
    """No number of points decides a polynomial of higher degree than there are field elements."""
    x, a, b = (ca.SX.sym(n) for n in ("x", "a", "b"))
    term = x
    for _ in range(7):
        term = term**60
    made = System("steep", ("x",), ("a", "b"), ("y",), {"x": x, "a": a, "b": b}, a * b * term, x)
    assert observability(made).error_bound == 1.0


# -- the series against the functions themselves -----------------------------------------------


def test_the_series_is_the_taylor_series_of_the_output():
    """y = x of x' = -k x^2, x(0) = 2: x = 2/(1 + 2 k t), coefficients 2 (-2k)^j, exactly."""
    model = system({"x": "-k*x**2"}, {"y": "x"}, ["k"])
    series = Series(Schedule(model), {"x": 2, "k": 3}, P, np.random.default_rng(0))
    for j, rows in zip(range(12), series.rows(), strict=False):
        assert series.outputs()[0] == 2 * (-6) ** j % P
        # d/dx0 of x0 (-k x0)^j and d/dk, at x0 = 2, k = 3
        by_x0 = (j + 1) * (-6) ** j
        by_k = 2 * j * (-2) ** j * 3 ** (j - 1) if j else 0
        assert rows[0].tolist() == [by_x0 % P, by_k % P]


# -- invariances -------------------------------------------------------------------------------


@st.composite
def networks(draw):
    """Mass-action networks of two to four states, some deficient and some not."""
    n = draw(st.integers(2, 4))
    params = [f"k{i}" for i in range(draw(st.integers(2, 4)))]
    rates = {f"x{i}": [f"-1*x{i}"] for i in range(n)}
    for k in params:
        i, j, other = (draw(st.integers(0, n - 1)) for _ in range(3))
        term = f"{k}*x{i}" + draw(st.sampled_from(["", f"*x{other}", f"/(1 + x{other})"]))
        rates[f"x{i}"].append(f"-{term}")
        rates[f"x{j}"].append(f"+{term}")
    seen = draw(st.sets(st.integers(0, n - 1), min_size=1, max_size=2))
    gains = draw(st.lists(st.sampled_from(["", f"*{params[0]}"]), min_size=n, max_size=n))
    outputs = {f"y{i}": f"x{i}{gains[i]}" for i in sorted(seen)}
    return {x: " ".join(terms) for x, terms in rates.items()}, outputs, params


@given(networks(), st.randoms(use_true_random=False))
@settings(max_examples=25)
def test_names_and_order_are_no_matter(network, random):
    equations, outputs, params = network
    found = observability(system(equations, outputs, params))
    items, shuffled = list(equations.items()), list(params)
    random.shuffle(items)
    random.shuffle(shuffled)
    again = observability(system(dict(items), outputs, shuffled), seed=1)
    assert (again.rank, again.unknowns) == (found.rank, found.unknowns)
    assert dict(again.identifiable) == dict(found.identifiable)
    assert dict(again.observable[0]) == dict(found.observable[0])

    def renamed(text):
        return text.replace("k", "rate_").replace("x", "amount")

    other = observability(
        system(
            {renamed(x): renamed(e) for x, e in equations.items()},
            {y: renamed(e) for y, e in outputs.items()},
            [renamed(p) for p in params],
        )
    )
    assert list(other.identifiable.values()) == list(found.identifiable.values())
    assert list(other.observable[0].values()) == list(found.observable[0].values())


@given(networks(), st.fractions(max_denominator=50).filter(bool))
@settings(max_examples=25)
def test_units_of_parameters_are_no_matter(network, scale):
    equations, outputs, params = network
    made = system(equations, outputs, params)
    symbol = ca.SX.sym(params[0])
    old = made.symbols[params[0]]
    factor = ca.SX(scale.numerator) / ca.SX(scale.denominator)
    f, h = ca.substitute([made.f, made.h], [old], [symbol * factor])
    scaled = made.where(f=f, h=h, symbols={**made.symbols, params[0]: symbol})
    found, again = observability(made), observability(scaled)
    assert again.rank == found.rank
    assert dict(again.identifiable) == dict(found.identifiable)


@given(networks(), st.lists(st.integers(-3, 3), min_size=4, max_size=4))
@settings(max_examples=25)
def test_an_invertible_mixture_of_outputs_tells_the_same(network, entries):
    equations, outputs, params = network
    made = system(equations, outputs, params)
    ny = len(outputs)
    mixture = np.array(entries[: ny * ny] if ny == 2 else entries[:1]).reshape(ny, ny)
    assume(round(np.linalg.det(mixture)) != 0)
    mixed = made.where(h=ca.mtimes(ca.DM(mixture), made.h))
    found, again = observability(made), observability(mixed)
    assert again.rank == found.rank
    assert dict(again.identifiable) == dict(found.identifiable)
    assert dict(again.observable[0]) == dict(found.observable[0])


@given(networks(), st.integers(0, 1))
@settings(max_examples=25)
def test_another_output_or_experiment_never_loses_a_parameter(network, state):
    equations, outputs, params = network
    made = system(equations, outputs, params)
    found = observability(made)
    richer = observability(system(equations, {**outputs, "more": f"x{state}"}, params))
    known = made.where(known_initial=made.states)
    for better in (richer, observability([made, made]), observability([made, known])):
        assert better.rank >= found.rank
        assert all(better.identifiable[p] for p, told in found.identifiable.items() if told)
        assert better.deficiency <= found.deficiency


def test_a_full_rank_needs_one_point_and_one_point_gives_the_same_rank():
    model, _ = of_file("crn")
    assert len(observability(model).points) == 1
    point = rank_at(model, P, rng=np.random.default_rng(0), values={"k1": 5})
    assert point.values["k1"] == 5
    assert point.rank == 12


# -- the field ---------------------------------------------------------------------------------

elements = st.integers(0, P - 1)


@given(elements, elements, elements)
def test_the_field_obeys_the_integers_modulo_p(a, b, c):
    x, y, z = (np.array([[v]], dtype=np.int64) for v in (a, b, c))

    def product(*factors):
        out = factors[0]
        for f in factors[1:]:
            out = matmul(out, f, P)
        return int(out[0, 0])

    assert product(x, y) == a * b % P == product(y, x)
    assert product(x, y, z) == a * b * c % P
    assert product(x, (y + z) % P) == (a * b + a * c) % P
    if a:
        assert int(inverse(np.array([a]), P)[0]) * a % P == 1


@given(st.lists(st.integers(1, P - 1), min_size=1, max_size=9))
def test_inverses_are_found_all_at_once(values):
    assert inverse(np.array(values), P).tolist() == [pow(v, -1, P) for v in values]
    with pytest.raises(ZeroDivisionError):
        inverse(np.array([*values, 0]), P)


@pytest.mark.parametrize("terms", [0, 1, 63, 64, 65, 128, 200])
def test_products_of_matrices_are_exact_however_long_the_sum(terms):
    rng = np.random.default_rng(terms)
    a, b = rng.integers(P - 9, P, (3, terms)), rng.integers(P - 9, P, (terms, 2))
    expected = (a.astype(object) @ b.astype(object)) % P if terms else np.zeros((3, 2))
    assert matmul(a, b, P).tolist() == expected.tolist()
    stacked = matmul(np.stack([a, a]), np.stack([b, b]), P)
    assert stacked[1].tolist() == expected.tolist()


@st.composite
def integer_matrices(draw):
    rows, columns = draw(st.integers(1, 5)), draw(st.integers(1, 5))
    entry = st.one_of(st.just(0), st.integers(-9, 9))
    values = draw(st.lists(entry, min_size=rows * columns, max_size=rows * columns))
    return np.array(values, dtype=np.int64).reshape(rows, columns)


@given(integer_matrices())
def test_the_rank_of_small_integers_is_that_over_the_rationals(matrix):
    """Hadamard: no minor exceeds (9 sqrt 5)^5 = 3.4e6, so no prime above 2^30 divides one."""
    assert rank(matrix, P) == sp.Matrix(matrix.tolist()).rank()


@given(integer_matrices())
def test_an_echelon_form_is_its_own_and_spans_the_same(matrix):
    reduced, pivots = echelon(matrix, P)
    again, same = echelon(reduced, P)
    assert again.tolist() == reduced.tolist()
    assert same == pivots == sorted(pivots)
    assert reduced[:, pivots].tolist() == np.eye(len(pivots), dtype=int).tolist()
    assert rank(np.vstack([matrix, reduced]), P) == len(pivots)


@given(integer_matrices())
def test_the_null_space_is_all_that_the_matrix_takes_to_zero(matrix):
    basis = null_space(matrix, P)
    assert len(basis) == matrix.shape[1] - rank(matrix, P)
    assert not matmul(matrix % P, basis.T, P).any()
    assert rank(basis, P) == len(basis)


@given(st.integers(-30_000, 30_000), st.integers(1, 30_000))
def test_a_small_fraction_comes_back_from_the_field(numerator, denominator):
    fraction = Fraction(numerator, denominator)
    assert to_rational(to_field(fraction, P), P) == fraction


@given(elements)
def test_a_fraction_that_comes_back_is_that_element(value):
    fraction = to_rational(value, P)
    if fraction is not None:
        assert to_field(fraction, P) == value
        assert max(abs(fraction.numerator), fraction.denominator) <= math.sqrt(P / 2)


@given(st.integers(2, 10**6))
def test_primes_are_those_of_sympy(n):
    assert is_prime(n) == sp.isprime(n)
    assert is_prime(n + 2**30) == sp.isprime(n + 2**30)


def test_random_primes_lie_between_the_powers_of_two():
    rng = np.random.default_rng(0)
    drawn = [random_prime(rng) for _ in range(200)]
    assert all(2**30 < p < 2**31 and sp.isprime(p) for p in drawn)
    assert len(set(drawn)) == len(drawn)
