"""A program compiled once has, for each set of values, the optimum of the program solved alone."""

from __future__ import annotations

import pickle
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest

from casid.errors import SolveError
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solution import Evaluation
from casid.estimation.nlp.solver import Solver

SOLVERS = pytest.mark.parametrize("solver", [Solver("ipopt"), Solver("sqpmethod")], ids=repr)


def least_squares(name: str = "least squares") -> Nlp:
    """min theta' gram theta - 2 cross' theta + power subject to B theta = b, data as parameters."""
    nlp = Nlp(name)
    theta = ca.vertcat(*[nlp.variable(f"theta{i}", 0.5) for i in range(3)])
    gram, cross = nlp.parameter("gram", 3, 3), nlp.parameter("cross", 3)
    B, b = nlp.parameter("B", 1, 3), nlp.parameter("b")
    nlp.minimize(ca.bilin(gram, theta, theta) - 2 * ca.dot(cross, theta) + nlp.parameter("power"))
    nlp.equality(ca.mtimes(B, theta), b, "affine")
    return nlp


def moments(seed: int, size: float = 1.0):
    """Values for `least_squares`, and the optimum by its KKT system."""
    rng = np.random.default_rng(seed)
    Phi, y = size * rng.normal(size=(40, 3)), size * rng.normal(size=40)
    B, b = rng.normal(size=(1, 3)), rng.normal(size=1)
    G, c = Phi.T @ Phi, Phi.T @ y
    kkt = np.block([[2 * G / size**2, B.T], [B, np.zeros((1, 1))]])
    theta = np.linalg.solve(kkt, np.r_[2 * c / size**2, b])[:3]
    return {"gram": G, "cross": c, "B": B, "b": b, "power": y @ y}, theta


@SOLVERS
def test_each_set_of_values_has_the_solution_of_its_kkt_system(solver):
    compiled = least_squares().compile(solver)
    for seed in range(5):
        values, theta = moments(seed)
        solution = compiled.solve(values)
        assert solution.is_converged
        # cond(KKT) is below 100 for these seeds: 1e-9 leaves room for the solver's own tolerance
        assert solution.x == pytest.approx(theta, abs=1e-9)
        assert solution.constraint_jacobian == pytest.approx(values["B"])
        assert solution.hessian == pytest.approx(2 * values["gram"])
        direct = values["gram"] @ theta @ theta - 2 * values["cross"] @ theta + values["power"]
        assert solution.value == pytest.approx(direct, rel=1e-9)


@SOLVERS
@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_the_size_of_the_data_does_not_move_the_optimum(solver, size):
    """Signals in micro-units or mega-units: the objective changes by 1e-12 to 1e12."""
    values, theta = moments(3, size)
    assert least_squares().compile(solver).solve(values).x == pytest.approx(theta, abs=1e-8)


def test_one_solve_leaves_nothing_behind_for_the_next():
    compiled = least_squares().compile()
    first = compiled.solve(moments(1)[0])
    kept = first.x.copy(), first.hessian.copy(), first.constraint_jacobian.copy()
    compiled.solve(moments(2)[0])
    for was, now in zip(kept, (first.x, first.hessian, first.constraint_jacobian), strict=True):
        assert np.array_equal(was, now)
    assert np.array_equal(compiled.solve(moments(1)[0]).x, kept[0])


def test_a_pickled_program_solves_as_before():
    compiled = least_squares().compile()
    again = pickle.loads(pickle.dumps(compiled))
    values, _ = moments(4)
    assert np.array_equal(again.solve(values).x, compiled.solve(values).x)
    assert repr(again) == repr(compiled)
    assert "3 variables, 1 constraints, parameters gram 3x3" in repr(again)


def decay(product: bool = True) -> Nlp:
    """1/2 sum (y - a exp(-b t) - c)^2 with a b <= limit and c >= 0, nonlinear in its variables."""
    nlp = Nlp("decay")
    a, b = nlp.variable("a", 1.0), nlp.variable("b", 1.0)
    c = nlp.variable("c", 1.0, lower=0.0)
    t, y = nlp.parameter("t", 30), nlp.parameter("y", 30)
    nlp.minimize(0.5 * ca.sumsqr(a * ca.exp(-b * t) + c - y))
    if product:
        nlp.between(a * b, -np.inf, nlp.parameter("limit"), "product")
    return nlp


def record(seed: int):
    t = np.linspace(0.0, 3.0, 30)
    return {"t": t, "y": 2 * np.exp(-0.8 * t) + 0.05 * np.random.default_rng(seed).normal(size=30)}


@SOLVERS
def test_compiled_and_plain_solutions_agree_with_bounds_and_inequalities(solver):
    nlp = decay()
    compiled = nlp.compile(solver)
    near, active = [1.5, 0.7, 0.1], set()
    for seed in range(6):
        for limit in (1.2, 10.0):
            values = record(seed) | {"limit": limit}
            plain = nlp.solve(solver, near, parameters=values)
            solution = compiled.solve(values, near)
            assert solution.is_converged
            assert solution.x == pytest.approx(plain.x, abs=1e-6)
            assert solution.value == pytest.approx(plain.value, rel=1e-7)
            assert (solution.at_lower, solution.at_upper) == (plain.at_lower, plain.at_upper)
            active |= {(solution.at_lower, limit == 1.2)}
            assert solution["a"] * solution["b"] <= limit + 1e-6
    assert len(active) == 3  # inequality and bound, bound alone, neither


def test_a_point_short_of_the_optimum_is_not_converged():
    values = record(1) | {"limit": 10.0}
    with pytest.raises(SolveError, match="after 1 iterations .*raise max_iterations"):
        decay().compile(Solver(max_iterations=1)).solve(values)
    returned = decay().compile(Solver(max_iterations=1)).solve(values, throw=False)
    assert not returned.is_converged
    assert returned.scaled_gradient > 1e-3


def test_the_measure_of_optimality_is_that_of_the_plain_program():
    """Near an optimum (gradient 1e-2 to 1e-5) both give one number: multipliers apart."""
    values = record(2)
    nlp = decay(product=False)
    optimum = nlp.solve(parameters=values).x
    for step in (1e-2, 1e-4):
        stay = Solver(options={"ipopt.max_iter": 0, "ipopt.bound_push": 1e-16})
        start = optimum + step
        plain = nlp.solve(stay, start, parameters=values, throw=False)
        compiled = nlp.compile(stay).solve(values, start, throw=False)
        assert compiled.scaled_gradient == pytest.approx(plain.scaled_gradient, rel=1e-9)
        assert compiled.scaled_gradient > 1e-6


def test_limits_are_numbers_or_expressions_of_parameters():
    """min |x - target|^2 with limits in all combinations projects onto the box."""

    def nlp(kind: str) -> Nlp:
        program = Nlp(kind)
        x = ca.vertcat(program.variable("a", 0.0), program.variable("b", 0.0))
        low, high = program.parameter("low", 2), program.parameter("high", 2)
        program.minimize(ca.sumsqr(x - program.parameter("target", 2)))
        limits = {
            "numbers": ([-1.0, -1.0], [1.0, 2.0]),
            "expressions": (low, high),
            "lower": (low, np.array([1.0, 2.0])),
            "upper": (-1.0, high),
            "one-sided": (-np.inf, high),
        }
        program.between(x, *limits[kind])
        return program

    values = {"low": [-1.0, -1.0], "high": [1.0, 2.0]}
    for kind in ("numbers", "expressions", "lower", "upper", "one-sided"):
        compiled = nlp(kind).compile()
        for target in ([3.0, 0.5], [0.3, 5.0], [0.2, 0.2]):
            assert compiled.solve(values | {"target": target}).x == pytest.approx(
                np.minimum(target, [1.0, 2.0]), abs=1e-7
            )


def test_an_equality_may_have_a_parameter_for_its_value():
    nlp = Nlp()
    x = ca.vertcat(nlp.variable("a", 1.0), nlp.variable("b", 1.0))
    nlp.minimize(ca.sumsqr(x))
    nlp.equality(x[0] + x[1], 2 * nlp.parameter("half"))
    compiled = nlp.compile()
    for half in (1.0, -3.0):
        assert compiled.solve({"half": half}).x == pytest.approx([half, half], abs=1e-9)


def test_vectors_may_lie_and_scalars_need_no_brackets():
    values, theta = moments(5)
    compiled = least_squares().compile()
    for b in (values["b"], float(values["b"][0]), [[values["b"][0]]]):
        shaped = values | {"b": b, "B": values["B"].ravel(), "cross": values["cross"][:, None]}
        assert compiled.solve(shaped).x == pytest.approx(theta, abs=1e-9)


def test_a_program_that_cannot_be_expanded_keeps_its_answer():
    """A rootfinder inside the objective has no scalar operations to expand into."""
    s, q = ca.SX.sym("s"), ca.SX.sym("q")
    root = ca.rootfinder("root", "newton", {"x": s, "p": q, "g": s**3 + s - q})
    nlp = Nlp()
    a = nlp.variable("a", 1.0)
    nlp.minimize((root(1.0, a) - nlp.parameter("target")) ** 2)
    # s(a) = target at a = target^3 + target
    assert nlp.compile().solve({"target": 2.0})["a"] == pytest.approx(10.0, rel=1e-6)


def test_starts_steer_and_are_checked():
    nlp = Nlp("valley")
    a = nlp.variable("a", 0.5, lower=-2.0, upper=2.0)
    nlp.minimize((a**2 - nlp.parameter("square")) ** 2 + 1)
    compiled = nlp.compile()
    assert compiled.solve({"square": 1.0}, [-0.5])["a"] == pytest.approx(-1.0, abs=1e-6)
    assert compiled.solve({"square": 1.0}, [0.5])["a"] == pytest.approx(1.0, abs=1e-6)
    with pytest.raises(SolveError, match="a = 3 lies outside .*move the start inside or widen"):
        compiled.solve({"square": 1.0}, [3.0])
    with pytest.raises(SolveError, match="start has 2 values for 1 variables"):
        compiled.solve({"square": 1.0}, [0.0, 1.0])


@SOLVERS
@pytest.mark.parametrize("noise", [1e-3, 1e-6])
def test_data_with_little_noise_are_solved_to_rounding(solver, noise):
    """A lifted program (theta = g(a, b)) has the optimum of the eliminated one.

    At noise 1e-6 a criterion of 1e-11 is left of 1e2 at the start: no relative tolerance of a
    solver reaches so deep, Newton steps on the optimality conditions do.
    """
    rng = np.random.default_rng(3)
    Phi = rng.normal(size=(20, 2))
    Y = Phi @ [2.0 * 0.5, 2.0 + 0.5] + noise * rng.normal(size=20)
    values = {"Phi": Phi, "Y": Y}
    found = {}
    for is_lifted in (False, True):
        nlp = Nlp()
        a, b = nlp.variable("a", 1.6), nlp.variable("b", 0.3)
        theta = ca.vertcat(a * b, a + b)
        if is_lifted:
            free = ca.vertcat(nlp.variable("theta0", 0.5), nlp.variable("theta1", 2.0))
            nlp.equality(free - theta)
            theta = free
        nlp.minimize(ca.sumsqr(nlp.parameter("Y", 20) - nlp.parameter("Phi", 20, 2) @ theta))
        solution = nlp.compile(solver).solve(values)
        assert solution.scaled_gradient < 1e-7
        found[is_lifted] = solution.x[:2]
    assert found[True] == pytest.approx(found[False], rel=1e-10)
    exact = np.linalg.lstsq(Phi, Y, rcond=None)[0]  # the map is onto here: ordinary least squares
    assert np.prod(found[True]) == pytest.approx(exact[0], rel=1e-10)


# Refusals


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"b": None}, "no value for parameter b; give values for exactly gram, cross, B, b"),
        ({"beta": 1.0}, "no parameter is called beta; give values for exactly gram"),
        ({"gram": np.eye(2)}, r"gram has shape \(2, 2\); give \(3, 3\), as it was declared"),
        ({"gram": np.arange(9.0)}, r"gram has shape \(9,\); give \(3, 3\)"),
        ({"cross": 1.0}, r"cross has shape \(\); give \(3, 1\)"),
        ({"cross": [1.0, np.nan, 0.0]}, "parameter cross holds values that are not finite; fix"),
    ],
)
def test_values_that_do_not_fit_are_refused(change, words):
    values = {k: v for k, v in (moments(1)[0] | change).items() if v is not None}
    with pytest.raises(SolveError, match=words):
        least_squares().compile().solve(values)
    with pytest.raises(SolveError, match=words):
        least_squares().solve(parameters=values)


def test_a_program_with_parameters_is_not_solved_without_their_values():
    with pytest.raises(SolveError, match="no value for parameter gram, cross.*give values"):
        least_squares().solve()
    nlp = Nlp()
    nlp.minimize(nlp.variable("x", 1.0) ** 2)
    with pytest.raises(SolveError, match="no parameter is called a; give values for exactly none"):
        nlp.solve(parameters={"a": 1.0})


def test_a_criterion_cannot_be_compiled_and_keeps_parameters_in_its_constraints():
    class Bowl:
        n_constraints = 0

        def evaluate(self, x):
            return Evaluation(float(x @ x), 2 * x, 2 * np.eye(len(x)))

    nlp = Nlp("bowl")
    a, b = nlp.variable("a", 1.0), nlp.variable("b", 0.0)
    nlp.minimize(Bowl())
    nlp.equality(a + b, nlp.parameter("sum"))
    with pytest.raises(SolveError, match="a Bowl cannot be compiled.*CasADi expression.*or call"):
        nlp.compile()
    assert nlp.solve(parameters={"sum": 3.0}).x == pytest.approx([1.5, 1.5], abs=1e-6)


def test_undeclared_symbols_and_missing_objectives_are_named():
    nlp = Nlp("stray")
    nlp.minimize(nlp.variable("a", 1.0) * ca.MX.sym("stranger"))
    with pytest.raises(SolveError, match="use stranger; declare them with variable or parameter"):
        nlp.compile()
    with pytest.raises(SolveError, match="no objective; call minimize first"):
        Nlp().compile()


def test_names_and_shapes_of_parameters_are_checked_when_declared():
    nlp = Nlp()
    nlp.variable("a", 1.0)
    nlp.parameter("b")
    with pytest.raises(SolveError, match="'a' declared twice; give it another name"):
        nlp.parameter("a")
    with pytest.raises(SolveError, match="'b' declared twice; give it another name"):
        nlp.variable("b", 1.0)
    with pytest.raises(SolveError, match="0 rows and 1 columns; give at least one of each"):
        nlp.parameter("c", 0)


def test_columns_of_constraints_have_one_length():
    nlp = Nlp()
    x = ca.vertcat(nlp.variable("a", 1.0), nlp.variable("b", 1.0))
    with pytest.raises(SolveError, match=r"constraint pair compares .*give columns of one length"):
        nlp.equality(x, [1.0, 2.0, 3.0], "pair")
    with pytest.raises(SolveError, match=r"constraint pair\[1\] has lower 2 above upper 1; exch"):
        nlp.between(x, [0.0, 2.0], [1.0, 1.0], "pair")


def test_contradictions_and_starts_without_value_say_so_for_the_values_given():
    nlp = Nlp("impossible")
    a, b = nlp.variable("a", 1.0), nlp.variable("b", 1.0)
    nlp.minimize(a**2 + b**2 + ca.sqrt(nlp.parameter("c")))
    for name in ("first", "second"):
        nlp.equality(a + b, nlp.parameter(name), name)
    compiled = nlp.compile()
    values = {"c": 1.0, "first": 1.0, "second": 1.0}
    assert compiled.solve(values).x == pytest.approx([0.5, 0.5], abs=1e-6)
    with pytest.raises(SolveError, match="contradict each other .*drop one"):
        compiled.solve(values | {"second": 3.0})
    with pytest.raises(SolveError, match=r"not finite at the start \(a = 1, b = 1\); change"):
        compiled.solve(values | {"c": -1.0})
    # and the compiled program is as good as new after either
    assert compiled.solve(values).x == pytest.approx([0.5, 0.5], abs=1e-6)


@SOLVERS
def test_active_bounds_are_named(solver):
    """min |x - target|^2 in [0, 1] for each: the targets outside are held by a bound."""
    nlp = Nlp()
    x = ca.vertcat(*[nlp.variable(n, 0.5, lower=0.0, upper=1.0) for n in "abc"])
    nlp.minimize(ca.sumsqr(x - nlp.parameter("target", 3)))
    compiled = nlp.compile(solver)
    solution = compiled.solve({"target": [-1.0, 0.5, 3.0]})
    assert (solution.at_lower, solution.at_upper) == (("a",), ("c",))
    solution = compiled.solve({"target": [0.2, 1.5, -3.0]})
    assert (solution.at_lower, solution.at_upper) == (("c",), ("b",))


def test_values_are_continuous_in_the_data():
    """Halving a step in the data halves the step of the optimum: a smooth program's sensitivity."""
    compiled = decay(product=False).compile()
    base = record(7)
    optimum = compiled.solve(base).x
    change = np.cos(np.arange(30.0))
    steps = [
        np.linalg.norm(compiled.solve(base | {"y": base["y"] + e * change}).x - optimum)
        for e in (4e-3, 2e-3, 1e-3)
    ]
    for longer, shorter in pairwise(steps):
        assert longer / shorter == pytest.approx(2.0, rel=0.02)


def test_a_program_without_parameters_needs_no_values():
    nlp = Nlp()
    a = nlp.variable("a", 1.0)
    nlp.minimize((a - 2) ** 2)
    assert nlp.compile().solve()["a"] == pytest.approx(2.0)
    with pytest.raises(SolveError, match="no value for parameter gram, .*give values for exactly"):
        least_squares().compile().solve()
