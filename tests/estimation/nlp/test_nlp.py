"""NLPs have the optimum that theory gives them, whichever solver finds it, or say why not."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest

from casid.errors import SolveError
from casid.estimation.nlp.criterion import FALL, PATIENCE
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solution import Evaluation, judged
from casid.estimation.nlp.solver import LEADS_TO_KNOWN, NEARBY, Solver, descending

SOLVERS = pytest.mark.parametrize("solver", [Solver("ipopt"), Solver("sqpmethod")], ids=repr)
N = 30
T = np.linspace(0.0, 3.0, N)
Y = 2.0 * np.exp(-0.8 * T) + 0.3 + 0.05 * np.random.default_rng(3).normal(size=N)


def quadratic_program(n: int = 4, m: int = 2, seed: int = 3):
    """min 1/2 x'Hx - c'x subject to Ax = b, and its solution by the KKT system."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    H, c = root @ root.T + np.eye(n), rng.normal(size=n)
    A, b = rng.normal(size=(m, n)), rng.normal(size=m)
    kkt = np.block([[H, A.T], [A, np.zeros((m, m))]])
    return H, c, A, b, np.linalg.solve(kkt, np.r_[c, b])[:n]


@dataclass(frozen=True)
class Decay:
    """1/2 sum (y - a exp(-b t) - c)^2 as a criterion; with `own`, a + c = 2.5 as its constraint."""

    exact: bool = False
    own: bool = False

    @property
    def n_constraints(self) -> int:
        return int(self.own)

    def evaluate(self, x):
        a, b, c = x
        e = np.exp(-b * T)
        r = a * e + c - Y
        J = np.column_stack([e, -a * T * e, np.ones(N)])
        H = J.T @ J
        if self.exact:
            cross, second = -np.sum(r * T * e), np.sum(r * a * T**2 * e)
            H = H + np.array([[0, cross, 0], [cross, second, 0], [0, 0, 0]])
        own = (np.array([a + c - 2.5]), np.array([[1.0, 0.0, 1.0]])) if self.own else ()
        return Evaluation(0.5 * float(r @ r), J.T @ r, H, *own)


def decay(criterion: Decay | None, constraints: str = "", scale: float | None = None) -> Nlp:
    """The same problem, with a criterion or (None) as an expression."""
    nlp = Nlp("decay")
    a, b, c = (nlp.variable(n, 1.0, scale=scale) for n in "abc")
    nlp.minimize(
        criterion if criterion is not None else 0.5 * ca.sumsqr(a * ca.exp(-b * T) + c - Y)
    )
    if "linear" in constraints:
        nlp.equality(a + c - 2.5, name="sum")
    if "product" in constraints:
        nlp.equality(a * b, 1.7, name="product")
    return nlp


@SOLVERS
def test_a_quadratic_program_has_the_solution_of_its_kkt_system(solver):
    H, c, A, b, expected = quadratic_program()
    nlp = Nlp()
    x = ca.vertcat(*[nlp.variable(f"x{i}", 1.0) for i in range(4)])
    nlp.minimize(0.5 * ca.bilin(ca.DM(H), x, x) - ca.dot(ca.DM(c), x))
    for row, value in zip(A, b, strict=True):
        nlp.equality(ca.dot(ca.DM(row), x), value)
    solution = nlp.solve(solver)
    assert solution.x == pytest.approx(expected, abs=1e-8)  # Ipopt's tol is 1e-9
    assert solution.is_converged
    assert solution.constraint_jacobian == pytest.approx(A, abs=1e-14)
    assert solution.hessian == pytest.approx(H, abs=1e-13)


@SOLVERS
@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1e3, 1e6])
def test_scales_of_variables_do_not_move_the_optimum(solver, factor):
    """Variables in units from 1/factor to factor have the same physical optimum."""
    H, c, A, b, expected = quadratic_program()
    units = factor ** np.linspace(-1, 1, 4)
    nlp = Nlp()
    x = ca.vertcat(*[nlp.variable(f"x{i}", u, scale=u) for i, u in enumerate(units)]) / units
    nlp.minimize(0.5 * ca.bilin(ca.DM(H), x, x) - ca.dot(ca.DM(c), x))
    for row, value in zip(A, b, strict=True):
        nlp.equality(ca.dot(ca.DM(row), x), value)
    solution = nlp.solve(solver)
    assert solution.x / units == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_the_declared_scale_steers_the_solver_and_not_the_answer(scale):
    reference = decay(None).solve()
    assert decay(None, scale=scale).solve().x == pytest.approx(reference.x, rel=1e-6)


@SOLVERS
@pytest.mark.parametrize("exact", [False, True], ids=["gauss-newton", "exact"])
@pytest.mark.parametrize("constraints", ["", "linear", "product", "linear product"])
def test_a_criterion_is_the_expression_it_computes(solver, exact, constraints):
    """Same optimum to the solver's tolerance: Gauss-Newton changes the path, not the gradient."""
    expression = decay(None, constraints).solve()
    assert expression.is_converged
    solution = decay(Decay(exact), constraints).solve(solver)
    assert solution.is_converged
    assert solution.x == pytest.approx(expression.x, rel=1e-5)
    assert solution.value == pytest.approx(expression.value, rel=1e-9)
    if "product" in constraints:
        assert solution["a"] * solution["b"] == pytest.approx(1.7, abs=1e-7)


@SOLVERS
def test_a_constraint_of_the_criterion_is_one_of_the_program(solver):
    own = decay(Decay(own=True), "product").solve(solver)
    declared = decay(Decay(), "linear product").solve(solver)
    assert own.x == pytest.approx(declared.x, rel=1e-6)
    assert own.constraint_jacobian == pytest.approx(declared.constraint_jacobian, rel=1e-5)


def test_the_criterion_is_evaluated_once_a_point():
    """Value, gradient and Gauss-Newton matrix share one pass over the data."""
    points: list[bytes] = []

    class Counting(Decay):
        def evaluate(self, x):
            points.append(x.tobytes())
            return super().evaluate(x)

    solution = decay(Counting()).solve()
    repeats = sum(p == q for p, q in zip(points, points[1:], strict=False))
    assert repeats == 0
    assert len(points) < 3 * (solution.iterations + 2)


class Kink:
    """1 + |a| + b^2, whose minimum no gradient shows; `passes` counts the values asked for."""

    n_constraints = 0

    def __init__(self):
        self.passes = 0

    def evaluate(self, x):
        self.passes += 1
        a, b = x
        slope = np.array([np.sign(a), 2 * b])
        return Evaluation(1 + abs(a) + b**2, slope, np.diag([1.0, 2.0]))


class KinkWithValueAlone(Kink):
    def __init__(self):
        super().__init__()
        self.alone = 0

    def value_alone(self, x):
        self.alone += 1
        return 1 + abs(x[0]) + x[1] ** 2


def at_kink(criterion: Kink):
    """From where Newton's steps of one pass over the kink: 0.3 -> -0.7."""
    nlp = Nlp("kink")
    nlp.variable("a", 2.3)
    nlp.variable("b", 1.0)
    nlp.minimize(criterion)
    return nlp.solve(throw=False, natural_scales=True)


def test_a_search_at_a_kink_ends_at_its_best_point():
    """Steps of 1, halved until they fall: n times at a distance of 2^-n, up to 2^-20 or FALL."""
    criterion = Kink()
    solution = at_kink(criterion)
    assert solution.value == pytest.approx(1.0, abs=FALL)
    assert solution.status == "Search_Direction_Becomes_Too_Small"
    assert "kink" in solution.remedy
    assert criterion.passes < 20 * 21 / 2 + 2 * PATIENCE


@pytest.mark.parametrize("enough", [1e-2, 1e-4, 1e-6])
def test_a_search_that_may_end_early_ends_within_the_share_it_was_given(enough):
    """Gauss and Newton's step promises what is left to gain, but for the residual's curvature."""
    best = decay(Decay()).solve(NEARBY)
    passes: list[int] = []

    class Counting(Decay):
        def evaluate(self, x):
            passes[-1] += 1
            return super().evaluate(x)

    for share in (0.0, enough):
        passes.append(0)
        end = decay(Counting()).solve(
            Solver(options=NEARBY.options, enough=share), throw=False, natural_scales=True
        )
        assert best.value * (1 - 1e-12) <= end.value <= best.value * (1 + 2 * share + 1e-9)
    assert end.status == "Solve_Succeeded"
    assert passes[1] < passes[0]


def test_a_search_at_a_kink_ends_sooner_where_less_is_enough():
    """Each step halves the way to the kink, and five of them leave a thirtieth of it."""
    whole, early = Kink(), Kink()
    at_kink(whole)
    nlp = Nlp("kink")
    nlp.variable("a", 2.3)
    nlp.variable("b", 1.0)
    nlp.minimize(early)
    end = nlp.solve(Solver(options=NEARBY.options, enough=1e-2), throw=False, natural_scales=True)
    assert end.value == pytest.approx(1.0, abs=0.02)
    assert end.status == "Search_Direction_Becomes_Too_Small"
    assert early.passes < whole.passes / 2


class Slope:
    """1000 - x, of which every step of Gauss and Newton takes one; `steps` counts them."""

    n_constraints = 0

    def __init__(self):
        self.steps = 0

    def evaluate(self, x):
        self.steps += 1
        return Evaluation(1000.0 - x[0], np.array([-1.0]), np.eye(1))


@pytest.mark.parametrize(("below", "ends_early"), [(960.0, True), (980.0, False), (np.inf, False)])
def test_a_search_ends_where_its_pace_would_not_bring_it_low_enough(below, ends_early):
    """At one a step, thirty steps come below 980 and never below 960."""
    criterion = Slope()
    nlp = Nlp("slope")
    nlp.variable("x", 0.0)
    nlp.minimize(criterion)
    solver = Solver(max_iterations=30, options=NEARBY.options, enough=1e-9, below=below)
    end = nlp.solve(solver, throw=False, natural_scales=True)
    assert (criterion.steps < 15) == ends_early
    assert end.status == (
        "Search_Direction_Becomes_Too_Small" if ends_early else "Maximum_Iterations_Exceeded"
    )


@pytest.mark.parametrize(("share", "leads"), [(1.0, True), (0.5, False), (2.0, False)])
def test_a_search_ends_where_its_steps_lead_to_a_minimum_that_is_known(share, leads):
    """A point half way to the minimum, or as far behind it, is none, and the search goes on."""
    best = decay(Decay()).solve(NEARBY)
    known = tuple(1.0 + share * (best.x - 1.0))  # every variable starts at 1
    solver = Solver(options=NEARBY.options, enough=1e-12, known=known)
    end = decay(Decay()).solve(solver, throw=False, natural_scales=True)
    assert (end.status == LEADS_TO_KNOWN) == leads
    assert leads or end.value == pytest.approx(best.value, rel=1e-9)


def test_a_criterion_with_constraints_is_solved_to_its_end_whatever_is_enough():
    """It may have to rise for as long as they are not met."""
    solver = Solver(options=NEARBY.options, enough=0.5)
    whole, early = (decay(Decay(), "product").solve(s) for s in (Solver(), solver))
    assert early.x == pytest.approx(whole.x, rel=1e-6)


def test_a_search_without_steps_that_rise_has_no_watchdog():
    key = "ipopt.watchdog_shortened_iter_trigger"
    again = descending(None)
    assert again is not None
    assert again.options[key] == 0
    assert descending(again) is None
    assert descending(Solver("sqpmethod")) is None


def test_shortened_steps_take_the_value_alone():
    """Derivatives are computed at the start, at points that are taken, and for first steps."""
    criterion, whole = KinkWithValueAlone(), Kink()
    solution, same = at_kink(criterion), at_kink(whole)
    assert solution.value == pytest.approx(same.value, abs=FALL)
    assert criterion.alone > 0
    assert criterion.passes < 2 * (solution.iterations + 2) + 1
    assert criterion.passes < whole.passes


@SOLVERS
def test_active_bounds_are_named_and_their_gradient_points_outwards(solver):
    """min (a-2)^2 + (b+1)^2 + (c-1)^2 in the box a <= 1.5, b >= 0 ends in the corner."""
    nlp = Nlp()
    a = nlp.variable("a", 1.0, upper=1.5)
    b, c = nlp.variable("b", 0.5, lower=0.0), nlp.variable("c", 0.5, lower=0.0, upper=3.0)
    nlp.minimize((a - 2) ** 2 + (b + 1) ** 2 + (c - 1) ** 2)
    solution = nlp.solve(solver)
    assert (solution.at_lower, solution.at_upper) == (("b",), ("a",))
    assert solution.x == pytest.approx([1.5, 0.0, 1.0], abs=1e-7)
    assert solution.is_converged


@SOLVERS
def test_an_inactive_inequality_changes_nothing_and_an_active_one_does(solver):
    for limit, expected in ((10.0, [2.0, -1.0]), (0.5, [1.75, -1.25])):  # projection on the line
        nlp = Nlp()
        a, b = nlp.variable("a", 1.0), nlp.variable("b", 0.3)
        nlp.minimize((a - 2) ** 2 + (b + 1) ** 2)
        nlp.between(a + b, -10.0, limit)
        assert nlp.solve(solver).x == pytest.approx(expected, abs=1e-6)


def test_a_point_short_of_the_optimum_is_not_converged_whatever_holds_it():
    """An inequality that does not bind lends no multiplier to hide the gradient behind."""
    nlp = Nlp()
    a = nlp.variable("a", 1.0)
    nlp.minimize((a - 2) ** 4 + 1)
    nlp.between(a, -5.0, 5.0)
    stopped = nlp.solve(Solver(max_iterations=1), throw=False)
    assert stopped.status == "Maximum_Iterations_Exceeded"
    assert not stopped.is_converged
    assert nlp.solve().is_converged


@SOLVERS
def test_data_without_noise_converge_though_the_criterion_vanishes(solver):
    """At f = 0 no direction of the gradient is left to judge by; the Newton step is."""
    nlp = Nlp()
    a, b = nlp.variable("a", 2.0), nlp.variable("b", 0.7)
    nlp.minimize(0.5 * ca.sumsqr(a * ca.exp(-b * T) - 3 * np.exp(-0.5 * T)))
    assert nlp.solve(solver).x == pytest.approx([3.0, 0.5], rel=1e-7)


@SOLVERS
def test_a_linear_objective_on_a_circle_ends_where_the_gradient_is_normal(solver):
    nlp = Nlp()
    a, b = nlp.variable("a", 1.0), nlp.variable("b", 0.3)
    nlp.minimize(a + b)
    nlp.equality(a**2 + b**2, 2.0)
    assert nlp.solve(solver).x == pytest.approx([-1.0, -1.0], abs=1e-7)


def test_a_stationary_maximum_is_no_optimum():
    nlp = Nlp()
    a = nlp.variable("a", 0.0, lower=-1.0, upper=2.0)
    nlp.minimize(-(a**2))
    stuck = nlp.solve(Solver(options={"ipopt.max_iter": 0}), throw=False)
    assert stuck.x == pytest.approx([0.0])
    assert not stuck.is_converged


# Refusals: what, where, how to mend


@pytest.mark.parametrize(
    ("start", "limits", "words"),
    [
        (3.0, {"lower": 4.0}, "start a = 3 lies outside its bounds .*move the start inside or"),
        (3.0, {"lower": 4.0, "upper": 2.0}, r"bounds of a cross \(4 > 2\); exchange"),
        (float("nan"), {}, "start a = nan; give a finite number"),
        ("1", {}, "start a = '1'; give a finite number"),
    ],
)
def test_impossible_starts_and_bounds_are_refused_when_declared(start, limits, words):
    with pytest.raises(SolveError, match=words):
        Nlp().variable("a", start, **limits)


def test_a_name_is_declared_once():
    nlp = Nlp()
    nlp.variable("a", 1.0)
    with pytest.raises(SolveError, match="declared twice; give it another name"):
        nlp.variable("a", 1.0)


def test_crossing_limits_of_a_constraint_are_refused():
    nlp = Nlp()
    with pytest.raises(SolveError, match="constraint gap has lower 2 above upper 1; exchange them"):
        nlp.between(nlp.variable("a", 1.0), 2.0, 1.0, "gap")


def test_contradictory_constraints_say_so():
    nlp = Nlp("impossible")
    a, b = nlp.variable("a", 1.0), nlp.variable("b", 1.0)
    nlp.minimize(a**2 + b**2)
    nlp.equality(a + b, 1.0)
    nlp.equality(a + b, 3.0)
    with pytest.raises(SolveError, match="contradict each other .*drop one") as caught:
        nlp.solve()
    assert "constraint violation 1.0e+00" in str(caught.value)
    returned = nlp.solve(throw=False)  # for studies over many starts
    assert not returned.is_converged
    assert "drop one" in returned.remedy


def test_an_objective_without_value_at_the_start_names_the_start():
    nlp = Nlp()
    a = nlp.variable("a", -1.0)
    nlp.minimize(ca.log(a) ** 2)
    with pytest.raises(SolveError, match=r"not finite at the start \(a = -1\); change the start"):
        nlp.solve()
    assert nlp.solve(start=[3.0])["a"] == pytest.approx(1.0, abs=1e-7)


def test_an_objective_without_lower_bound_diverges_with_a_mend():
    nlp = Nlp()
    nlp.minimize(-nlp.variable("a", 1.0))
    with pytest.raises(SolveError, match="runs to infinity: give it bounds, or fix it"):
        nlp.solve()


def test_too_few_iterations_are_named_as_such():
    with pytest.raises(SolveError, match="after 1 iterations .*raise max_iterations"):
        decay(None).solve(Solver(max_iterations=1))


def test_an_unknown_plug_in_is_refused_by_name():
    with pytest.raises(SolveError, match=r"'ipopd' is no CasADi plug-in .*Solver\('ipopt'\)"):
        decay(None).solve(Solver("ipopd"))


def test_an_unknown_option_is_refused_by_name():
    with pytest.raises(SolveError, match=r"nonsense; check Solver\(options="):
        decay(None).solve(Solver(options={"ipopt.nonsense": 1}))


def test_an_option_that_sqpmethod_lacks_is_named_with_its_neighbours():
    wrong = Solver("sqpmethod", options={"tol_d": 1e-9})
    with pytest.raises(SolveError, match=r"Unknown option: tol_d \(nearest: tol_du.*check Solver"):
        decay(None).solve(wrong)
    assert decay(None).solve(Solver("sqpmethod", options={"tol_du": 1e-9})).is_converged


@pytest.mark.parametrize("criterion", [None, Decay()], ids=["expression", "criterion"])
def test_another_quadratic_program_is_an_option_like_any_other(criterion):
    """Each plug-in has options of its own: those of the default QP are not handed to another."""
    daqp = Solver("sqpmethod", options={"qpsol": "daqp"})
    wanted = decay(criterion).solve(Solver("sqpmethod")).x
    assert decay(criterion).solve(daqp).x == pytest.approx(wanted, rel=1e-7)
    one = Solver("sqpmethod", options={"qpsol_options": {"print_iteration": False}})
    with pytest.raises(SolveError, match="Unknown option: print_iteration .nearest: print_iter"):
        decay(None).solve(one)


def test_a_solvers_name_stands_for_the_solver():
    wanted = decay(None).solve(Solver("sqpmethod"))
    found = decay(None).solve("sqpmethod")
    assert (found.solver, found.x.tolist()) == ("sqpmethod", wanted.x.tolist())
    compiled = decay(None).compile("sqpmethod")
    assert compiled.solve({}).solver == "sqpmethod"
    assert compiled.with_solver("ipopt").solve({}).solver == "ipopt"
    with pytest.raises(SolveError, match=r"a dict is no solver; give Solver\('ipopt'\)"):
        decay(None).solve({"name": "ipopt"})
    with pytest.raises(SolveError, match=r"write Solver\('sqpmethod', options={'qpsol': 'daqp'}\)"):
        decay(None).solve("sqpmethod/daqp")


def test_a_start_of_wrong_length_and_a_missing_objective_are_refused():
    with pytest.raises(SolveError, match="start has 2 values for 3 variables; .* a, b, c"):
        decay(None).solve(start=[1.0, 2.0])
    with pytest.raises(SolveError, match="no objective; call minimize first"):
        Nlp().solve()


def test_what_is_no_objective_is_refused_with_what_would_be_one():
    nlp = Nlp("sum")
    a, b = nlp.variable("a", 1.0), nlp.variable("b", 1.0)
    x = ca.SX.sym("x", 2)
    with pytest.raises(SolveError, match=r"sum: the objective is made of SX symbols.*\(MX\), or c"):
        nlp.minimize(ca.sumsqr(x - 2))
    residuals = ca.vertcat(a - 2, b - 2)
    with pytest.raises(SolveError, match=r"2 rows and 1 columns; give one number, as ca.sumsqr"):
        nlp.minimize(residuals)
    for number in (3.0, np.float64(3.0), np.zeros(2), ca.DM(3.0)):
        with pytest.raises(SolveError, match="depends on no variable; give a CasADi expression of"):
            nlp.minimize(number)
    nlp.minimize(ca.sumsqr(residuals))
    mended = nlp.solve().x
    nlp.minimize(ca.Function("f", [x], [ca.sumsqr(x - 2)])(ca.vertcat(a, b)))
    assert mended == pytest.approx([2.0, 2.0])
    assert nlp.solve().x == pytest.approx([2.0, 2.0])


def test_a_constraint_of_foreign_symbols_is_refused():
    nlp = Nlp()
    nlp.variable("a", 1.0)
    with pytest.raises(SolveError, match="constraint gap is made of SX .*nlp.variable"):
        nlp.equality(ca.SX.sym("a"), 1.0, "gap")
    with pytest.raises(SolveError, match="constraint gap holds the text 'a'; give a number, or"):
        nlp.equality("a", 1.0, "gap")


@pytest.mark.parametrize("act", ["solve", "compile"])
def test_a_program_without_variables_asks_for_one(act):
    nlp = Nlp("empty")
    nlp.minimize(ca.MX(1.0))
    with pytest.raises(SolveError, match=r"empty: no variables; .*a = nlp.variable\('a', 1.0\)"):
        getattr(nlp, act)()
    a = nlp.variable("a", 1.0)
    nlp.minimize(a**2)
    getattr(nlp, act)()


@pytest.mark.parametrize("compiled", [False, True])
def test_a_start_may_name_the_variables_that_it_moves(compiled):
    """cos has an optimum every 2 pi: the one that is found tells the start."""
    nlp = Nlp("waves")
    a, b = nlp.variable("a", 3.0), nlp.variable("b", 3.0)
    nlp.minimize(ca.cos(a) + ca.cos(b))

    def solve(start):
        return nlp.compile().solve({}, start) if compiled else nlp.solve(start=start)

    assert solve({"b": 9.0}).x == pytest.approx([np.pi, 3 * np.pi])
    assert solve([9.0, 3.0]).x == pytest.approx([3 * np.pi, np.pi])
    with pytest.raises(SolveError, match="waves: no variable 'beta' to start; known are: a, b"):
        solve({"beta": 9.0})
    for text in ("9", {"b": "9"}, ["9", "3"]):
        with pytest.raises(SolveError, match="not made of numbers; give 2 .* as {'a': 3}"):
            solve(text)
    assert solve({"a": 3}).x == pytest.approx([np.pi, np.pi])


def test_a_solution_names_its_variables():
    nlp = Nlp()
    gain, delay = nlp.variable("gain", 2.0, lower=0.0), nlp.variable("delay", 1.0)
    nlp.minimize((gain + 2) ** 2 + delay**2)
    nlp.equality(delay, 1.0)
    solution = nlp.solve()
    with pytest.raises(KeyError, match="'delya' is no variable; .* nearest first: delay, gain"):
        solution["delya"]
    assert solution["delay"] == pytest.approx(1.0)
    assert repr(solution) == "<Solution of 2 variables, converged: value 5, ipopt Solve_Succeeded>"
    assert solution.active == {"gain": "lower"}
    text = str(solution).splitlines()
    assert text[0].startswith("Converged: ipopt, Solve_Succeeded after ")
    assert text[1].startswith("  gain  = ")
    assert text[1].endswith("  at its lower bound")
    assert text[2] == "  delay = 1"
    assert text[3].startswith("  value 5, scaled gradient ")
    assert text[4].startswith("  1 constraint, largest violation ")
    short = nlp.solve(Solver(max_iterations=0), throw=False)
    assert "not converged" in repr(short)
    assert str(short).splitlines()[-1] == f"  remedy: {short.remedy}"


@SOLVERS
def test_a_start_outside_the_bounds_is_refused_and_rounding_is_not(solver):
    """Solving from the nearest point instead would silently answer another question."""
    nlp = Nlp()
    a = nlp.variable("a", 1.0, lower=0.0, upper=2.0)
    nlp.minimize((a - 1.5) ** 2)
    with pytest.raises(SolveError, match=r"start a = 7 lies outside its bounds \[0, 2\]; move"):
        nlp.solve(solver, start=[7.0])
    assert nlp.solve(solver, start=[2.0 + 1e-9])["a"] == pytest.approx(1.5, abs=1e-7)


@SOLVERS
def test_a_column_of_constraints_is_as_many_constraints(solver):
    H, c, A, b, expected = quadratic_program()
    nlp = Nlp()
    x = ca.vertcat(*[nlp.variable(f"x{i}", 1.0) for i in range(4)])
    nlp.minimize(0.5 * ca.bilin(ca.DM(H), x, x) - ca.dot(ca.DM(c), x))
    nlp.equality(ca.mtimes(ca.DM(A), x), b, "affine")
    assert nlp.solve(solver).x == pytest.approx(expected, abs=1e-8)


class Plateau:
    """1 + (a - 1)^2 + (b - 100)^2 / 2e12: next to flat in b, and no number from b = 500 on."""

    n_constraints = 0

    def evaluate(self, x):
        a, b = x
        value = 1 + (a - 1) ** 2 + 5e-13 * (b - 100) ** 2 if b < 500 else np.nan
        slope = np.array([2 * (a - 1), 1e-12 * (b - 100)])
        return Evaluation(value, slope, np.diag([2.0, 1e-12]))


@pytest.mark.parametrize("lower", [0.0, 1.0, 99.0, -np.inf])
def test_a_search_begins_where_it_was_told_to_whatever_the_size_of_a_variable(lower):
    """Ipopt moves a start that lies nearer to a bound than a hundredth of the variable's size.

    By the curvature the size of b is over 1e5, and the start would be moved from 100 to 1000.
    """
    nlp = Nlp("plateau")
    nlp.variable("a", 3.0)
    nlp.variable("b", 100.0, lower=lower)
    nlp.minimize(Plateau())
    solution = nlp.solve(throw=False, natural_scales=True)
    assert solution.value == pytest.approx(1.0, abs=1e-6)


def flat(slope: float) -> Evaluation:
    """A criterion of one variable that hardly depends on it, without constraints."""
    none = np.zeros(0), np.zeros((0, 1))
    return Evaluation(100.0, np.array([slope]), np.array([[1e-6]]), *none)


@pytest.mark.parametrize("gap", [1e-7, 1e-5, 5e-4])
def test_a_bound_holds_what_would_gain_nothing_on_the_way_to_it(gap: float):
    """A time constant that matters little: next to its bound of 30, Ipopt stops inside."""
    x, at = np.array([30.0 - gap]), flat(-1e-4)
    box = np.array([0.0]), np.array([30.0]), np.zeros(0), np.zeros(0)
    found = judged(("tau",), x, at, np.ones(1), box, ("Solve_Succeeded", 5, 5), "ipopt")
    assert found.is_converged
    assert found.at_upper == ("tau",)


def test_no_bound_holds_what_gains_on_the_way_to_it_or_is_pulled_inside():
    box = np.array([0.0]), np.array([30.0]), np.zeros(0), np.zeros(0)
    for slope, gap in ((-1.0, 1e-4), (-1e-8, 5.0), (1.0, 1e-4)):
        x, at = np.array([30.0 - gap]), flat(slope)
        found = judged(("tau",), x, at, np.ones(1), box, ("Solve_Succeeded", 5, 5), "ipopt")
        assert found.at_upper == ()
