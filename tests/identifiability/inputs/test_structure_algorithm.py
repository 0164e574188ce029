"""Eliminating arbitrary unknown inputs changes no verdict, whichever outputs it is done with."""

from __future__ import annotations

import json
from fractions import Fraction

import casadi as ca
import numpy as np
import pytest

from casid.algebra.vanishing import vanishing
from casid.errors import IdentifiabilityError, ModelError
from casid.identifiability.equations.equation_text import parse_system, parse_systems
from casid.identifiability.equations.system import System
from casid.identifiability.inputs import structure_algorithm
from casid.identifiability.inputs.elimination import eliminate_unknown_inputs
from casid.identifiability.inputs.experiments import merge, replicas, systems_by_class
from casid.identifiability.inputs.input_derivatives import observability_by_counting
from casid.identifiability.rank.observability import observability, rank_at
from problems import pendulum
from tests.support.formula_systems import system_of
from tests.support.shared import shared

P = 2_147_483_647


def identifiable(systems):
    return {p for p, told in observability(systems).identifiable.items() if told}


def information(system, values):
    """What the outputs tell of the parameters, at a point, as a reduced echelon form.

    It is a function of the parameters alone (Ljung & Glad 1994: identifiable functions are
    coefficients of input-output equations), so it can be compared entry by entry.
    """
    return rank_at(system, P, values=values, rng=np.random.default_rng(3)).information


def point(system, seed=1):
    names = (*system.parameters, *system.constants)
    numbers = np.random.default_rng(seed).integers(1, P, len(names)).tolist()
    return dict(zip(names, numbers, strict=True))


def assert_same_information(first, second):
    values = point(first)
    assert first.parameters == second.parameters
    assert np.array_equal(information(first, values), information(second, values))


# -- published verdicts and proofs by hand ---------------------------------------------------------


@pytest.mark.parametrize("model", ["c2m_w_b", "dof2_F2", "hiv_eta_unknown"])
def test_arbitrary_unknown_inputs_give_the_published_verdicts(model):
    """Verdicts of STRIKE-GOLDD's models, by hand elimination where its authors assume more."""
    fields = json.loads(shared(f"identifiability/{model}.json").read_text())
    expected = fields["expected"]
    result = observability(eliminate_unknown_inputs(parse_system(fields)).system)
    assert identifiable(result.systems) == set(expected["locally_identifiable"])
    assert {x for x, told in result.observable[0].items() if told} == set(
        expected["observable_states"]
    )
    assert result.deficiency == expected["parameter_deficiency"]
    assert result.is_certified
    assert result.error_bound <= 1e-12


def mass_damper(added="0"):
    """m v' = -d v + w, velocity and acceleration measured, with a known added mass."""
    acceleration = f"(w - d*v)/(m + {added})"
    constants = [] if added == "0" else [added]
    return system_of(
        {"v": acceleration},
        {"y1": "v", "y2": acceleration},
        params=["m", "d"],
        unknown=["w"],
        constants=constants,
    )


def test_own_forces_hide_mass_and_damping_and_a_shared_force_shows_them():
    """y2 = dy1/dt whatever m and d are, so an own force w = m y2 + d y1 absorbs both.

    One force on two masses: m y2 + d y1 = (m + dm) y2' + d y1', linear in m and d with
    regressors y2 - y2' and y1 - y1' that are independent.
    """
    experiments = (mass_damper(), mass_damper("dm"))
    own = [eliminate_unknown_inputs(s).system for s in experiments]
    assert identifiable(own) == set()
    together = eliminate_unknown_inputs(merge(experiments, shared=["w"]))
    assert identifiable(together.system) == {"m", "d"}
    assert together.used == {"w": ("y2", 0)}


def test_the_shared_file_of_related_data_sets_says_the_same():
    fields = json.loads(shared("identifiability/related_massdamper.json").read_text())
    experiments = parse_systems(fields)
    assert identifiable(systems_by_class(experiments)["arbitrary"]) == set()
    assert identifiable(systems_by_class(experiments, shared=["w"])["arbitrary"]) == {"m", "d"}


def test_replicas_with_own_unknown_inputs_tell_nothing_new():
    """Each replica's force absorbs the parameters again."""
    assert identifiable(systems_by_class(replicas(mass_damper(), 3))["arbitrary"]) == set()


def test_elimination_and_counting_derivatives_agree_on_random_systems():
    """Two certificates that have the engine in common and nothing else (`input_derivatives`)."""
    rng = np.random.default_rng(20)
    terms = "x1 x2 x3 x1*x2 k1*x1 k2*x2 k1*x3 w1 x1*w1 w2 k1*w1 k2*w2 w1^2 u u*x2 w1*w2 k2".split()
    seen = "x1 x2 x3 x1+x2 k1*x1 x1*x2 x1+w1 x2+k2*w1 x1+w1+w2".split()
    prolonged = derivatives = 0
    for _ in range(60):
        equations = {
            x: " + ".join(rng.choice(terms, rng.integers(1, 4), replace=False))
            for x in ("x1", "x2", "x3")
        }
        outputs = {f"y{i}": str(rng.choice(seen)) for i in range(rng.integers(1, 4))}
        system = system_of(
            equations, outputs, params=["k1", "k2"], unknown=["w1", "w2"], known=["u"]
        )
        elimination = eliminate_unknown_inputs(system)
        certified = observability(elimination.system)
        counted = observability_by_counting(system)
        where = f"{equations}, {outputs}"
        assert dict(certified.identifiable) == dict(counted.identifiable), where
        for x in system.states:
            assert certified.observable[0][x] == counted.observable[0][x], where
        if not elimination.prolonged:  # else w(0) is a state, which counting leaves out
            assert (certified.rank, certified.unknowns) == (counted.rank, counted.unknowns), where
        prolonged += bool(elimination.prolonged)
        derivatives += bool(elimination.system.input_derivatives)
    assert prolonged >= 5  # the sample has such cases
    assert derivatives >= 5


def test_counting_derivatives_says_how_sure_it_is():
    result = observability_by_counting(mass_damper())
    assert (result.rank, result.unknowns) == (1, 3)
    assert 0.0 < result.error_bound <= 1e-12
    assert result.is_certified
    assert not result.is_partial
    assert list(result.observable[0]) == ["v"]
    assert repr(result) == "<Observability: rank 1 of 3>"


def test_counting_derivatives_of_own_and_of_shared_forces():
    experiments = (mass_damper(), mass_damper("dm"))
    assert not any(observability_by_counting(experiments).identifiable.values())
    assert all(observability_by_counting(merge(experiments, shared=["w"])).identifiable.values())


def test_counting_derivatives_reaches_where_they_are_too_large_to_write_down():
    """A chain of n states with the force at its far end: relative degree n, all of it hidden.

    d^k y/dt^k for k < n tells as many combinations of initial states, and d^n y/dt^n is the force.
    """
    n = 14
    equations = {f"x{i}": f"-k{i}*x{i}^2/(1 + x{i}) + x{i + 1}*x{i}" for i in range(1, n)}
    equations[f"x{n}"] = f"-k{n}*x{n}^2 + w + x1"
    params = [f"k{i}" for i in range(1, n + 1)]
    system = system_of(equations, {"y": "x1"}, params=params, unknown=["w"])
    with pytest.raises(IdentifiabilityError, match="observability_by_counting"):
        eliminate_unknown_inputs(system)
    result = observability_by_counting(system)
    assert (result.rank, result.unknowns) == (n, 2 * n)
    assert [x for x, told in result.observable[0].items() if told] == ["x1"]


def test_counting_that_runs_out_of_time_says_so():
    result = observability_by_counting(mass_damper(), time_limit=0.0)
    assert result.is_partial
    assert np.isnan(result.error_bound)


# -- the choice of outputs, and of the order ------------------------------------------------------


def pendulum_system(kind="linear", params=("k", "d", "I_x")):
    """The direct model of the pendulum as a system; other constants are known, but generic."""
    model = {"linear": pendulum.linear_model, "nonlinear": pendulum.nonlinear_model}[kind]()
    e = model.explicit()
    symbols = {s.name(): s for v in (e.x, e.u, e.p) for s in ca.vertsplit(v)}
    return System(
        name=kind,
        states=e.states,
        parameters=tuple(params),
        outputs=e.outputs,
        symbols=symbols,
        f=e.f,
        h=e.h,
        constants=tuple(n for n in e.parameters if n not in params),
        unknown_inputs=e.inputs,
    )


@pytest.mark.parametrize("kind", ["linear", "nonlinear"])
def test_the_accelerometer_gives_the_indirect_model(kind):
    """With an undifferentiated output, elimination is `Model.eliminate`: Linder (2017), (7.24)."""
    model = {"linear": pendulum.linear_model, "nonlinear": pendulum.nonlinear_model}[kind]()
    indirect = model.eliminate("a_y", using="accel").explicit()
    elimination = eliminate_unknown_inputs(pendulum_system(kind))
    assert elimination.used == {"a_y": ("accel", 0)}
    system = elimination.system
    assert system.outputs == indirect.outputs == ("gyro",)
    assert system.inputs == indirect.inputs == ("accel",)
    theirs = [s for v in (indirect.x, indirect.u, indirect.p) for s in ca.vertsplit(v)]
    ours = [system.symbols[s.name()] for s in theirs]
    same = ca.substitute(indirect.f, ca.vertcat(*theirs), ca.vertcat(*ours))
    assert vanishing(ca.vertsplit(same - system.f)) == [True, True]


@pytest.mark.parametrize("kind", ["linear", "nonlinear"])
@pytest.mark.parametrize(
    "params", [("k", "d", "I_x"), ("M", "z_g", "k", "I_x", "d", "I_xm", "m", "z_m")]
)
def test_accelerometer_and_gyro_eliminate_the_cart_alike(kind, params):
    """The gyro feels a_y through its derivative only; what is identifiable is the same."""
    system = pendulum_system(kind, params)
    by_accel = eliminate_unknown_inputs(system, using={"a_y": "accel"})
    by_gyro = eliminate_unknown_inputs(system, using={"a_y": "gyro"})
    assert by_gyro.used == {"a_y": ("gyro", 1)}
    assert by_gyro.system.inputs == ("dgyro",)
    assert by_gyro.system.outputs == ("gyro", "accel")
    assert_same_information(by_accel.system, by_gyro.system)


def two_coupled():
    """dy1/dt and dy2/dt both feel w1 and nothing else: the decoupling matrix is singular."""
    return {
        "equations": {"x1": "w1 - a*x1", "x2": "w1 + x3 - b*x2*u", "x3": "w2 - c*x3 + a*x1"},
        "outputs": {"y1": "x1", "y2": "x2", "y3": "x3 + b*x1"},
        "params": ["a", "b", "c"],
        "known": ["u"],
    }


def test_a_singular_decoupling_matrix_is_met_by_differentiating_on():
    """y1 takes w1; then dy2/dt = dy1/dt + a x1 + x3 - b x2 u is free of it, and d2y2/dt2 has w2."""
    system = system_of(
        **{**two_coupled(), "outputs": {"y1": "x1", "y2": "x2"}}, unknown=["w1", "w2"]
    )
    elimination = eliminate_unknown_inputs(system)
    assert elimination.used == {"w1": ("y1", 1), "w2": ("y2", 2)}
    assert elimination.system.inputs == ("u", "dy1", "d2y2")
    assert dict(elimination.system.input_derivatives) == {"du": ("u", 1), "d2y1": ("dy1", 1)}
    assert "w2 eliminated with d^2 y2/dt^2" in str(elimination)
    result = observability(elimination.system)
    # y1, y2 and dy2/dt tell x1, x2 and a x1 + x3 - b x2 u: three numbers for three states.
    assert (result.rank, result.unknowns) == (3, 6)


def test_elimination_commutes_with_the_order_of_unknown_inputs():
    first = system_of(**two_coupled(), unknown=["w1", "w2"])
    second = system_of(**two_coupled(), unknown=["w2", "w1"])
    assert_same_information(
        eliminate_unknown_inputs(first).system, eliminate_unknown_inputs(second).system
    )


def test_elimination_does_not_depend_on_which_outputs_are_used():
    system = system_of(**two_coupled(), unknown=["w1", "w2"])
    made = [
        eliminate_unknown_inputs(system, using={"w1": i, "w2": j}).system
        for i, j in (("y1", "y2"), ("y1", "y3"), ("y2", "y3"))
    ]
    assert len({m.inputs for m in made}) == 3
    for other in made[1:]:
        assert_same_information(made[0], other)


# -- what enters nonlinearly, what reaches nothing, what is too much -------------------------------


@pytest.mark.parametrize("through", ["w^2", "sin(w)", "exp(w)*x", "w + w^3"])
def test_a_nonlinear_unknown_input_is_as_arbitrary_as_a_linear_one(through):
    """phi(w(t)) is arbitrary where phi is invertible, so x' = -k x + phi(w) tells what w tells."""
    outputs = {"y": "x", "z": "q"}
    rest = {"params": ["k", "l"], "unknown": ["w"]}
    curved = system_of({"x": f"-k*x + {through}", "q": "x - l*q"}, outputs, **rest)
    straight = system_of({"x": "-k*x + w", "q": "x - l*q"}, outputs, **rest)
    elimination = eliminate_unknown_inputs(curved)
    assert elimination.prolonged == ("w",)
    assert elimination.used == {"w": ("y", 2)}
    assert "w enters nonlinearly" in str(elimination)
    assert identifiable(elimination.system) == {"l"}
    assert identifiable(eliminate_unknown_inputs(straight).system) == {"l"}


def test_an_unknown_input_that_cancels_is_not_felt():
    """Tu + Ti does not feel the infection, although each of them does (HIV model)."""
    system = system_of(
        {"a": "-k*a - w*a", "b": "w*a - k*b"}, {"y": "a + b"}, params=["k"], unknown=["w"]
    )
    elimination = eliminate_unknown_inputs(system)
    assert elimination.unreached == ("w",)
    assert elimination.used == {}
    assert not elimination.system.unknown_inputs
    assert "w reaches no output" in str(elimination)
    assert identifiable(elimination.system) == {"k"}


def test_an_unknown_input_behind_the_outputs_is_left_out_with_a_note():
    system = system_of({"x": "-k*x", "hidden": "x + w"}, {"y": "x"}, params=["k"], unknown=["w"])
    elimination = eliminate_unknown_inputs(system)
    assert elimination.unreached == ("w",)
    result = observability(elimination.system)
    assert dict(result.identifiable) == {"k": True}
    assert dict(result.observable[0]) == {"x": True, "hidden": False}


def test_fewer_outputs_than_unknown_inputs_leave_what_only_their_sum_shows():
    """One output takes one unknown input; the rest reaches nothing beyond it, and is zero."""
    system = system_of(
        {"x": "-k*x + w1 + w2", "q": "w2 - l*q"},
        {"y": "x"},
        params=["k", "l"],
        unknown=["w1", "w2"],
    )
    elimination = eliminate_unknown_inputs(system)
    assert list(elimination.used.values()) == [("y", 1)]
    assert len(elimination.unreached) == 1
    assert "beyond what eliminates the others" in str(elimination)
    assert identifiable(elimination.system) == set()


def test_an_output_that_is_nothing_but_the_unknown_input_tells_nothing():
    system = system_of({"x": "-k*x"}, {"y": "x + w"}, params=["k"], unknown=["w"])
    elimination = eliminate_unknown_inputs(system)
    assert elimination.used == {"w": ("y", 0)}
    result = observability(elimination.system)
    assert result.rank == 0
    assert dict(result.identifiable) == {"k": False}


def test_the_solution_for_the_unknown_input_satisfies_the_equations():
    """Put back, it makes the derivative of the output the new input."""
    system = system_of({"x": "-k*x + x*w"}, {"y": "x"}, params=["k"], unknown=["w"])
    elimination = eliminate_unknown_inputs(system)
    before = ca.substitute(system.f, system.symbols["w"], elimination.solutions["w"])
    assert vanishing([before[0] - elimination.system.symbols["dy"]]) == [True]
    assert ca.is_equal(elimination.system.f[0], elimination.system.symbols["dy"])


def test_a_system_without_unknown_inputs_stays_as_it_is():
    system = system_of({"x": "-k*x"}, {"y": "x"}, params=["k"])
    elimination = eliminate_unknown_inputs(system)
    assert elimination.system is system
    assert "no unknown inputs" in str(elimination)


# -- refusals ------------------------------------------------------------------------------------


def at_rest(outputs):
    """The unknown input enters through s, which is zero at the start and then not."""
    system = system_of({"x": "s*w - k*x", "s": "1 - s"}, outputs, params=["k"], unknown=["w"])
    return system.where(initial_values={"s": Fraction(0)})


def test_elimination_is_refused_where_it_divides_by_zero_at_the_start():
    with pytest.raises(IdentifiabilityError, match=r"s\(0\) = 0") as refusal:
        eliminate_unknown_inputs(at_rest({"y": "x"}))
    assert "as_polynomial" in str(refusal.value)
    assert "known_initial" in str(refusal.value)


def test_an_output_that_is_regular_at_the_start_is_preferred():
    elimination = eliminate_unknown_inputs(at_rest({"y1": "x + s*w", "y2": "(1 + s)*w"}))
    assert elimination.used == {"w": ("y2", 0)}


def test_names_in_using_are_checked():
    system = mass_damper()
    with pytest.raises(ModelError, match="did you mean 'y2'"):
        eliminate_unknown_inputs(system, using={"w": "Y2"})
    with pytest.raises(ModelError, match="known are: w"):
        eliminate_unknown_inputs(system, using={"force": "y2"})


def test_one_output_cannot_eliminate_two_unknown_inputs():
    system = system_of(**two_coupled(), unknown=["w1", "w2"])
    with pytest.raises(ModelError, match="name another output"):
        eliminate_unknown_inputs(system, using={"w1": "y1", "w2": "y1"})


def test_an_output_that_never_feels_the_input_is_refused():
    system = system_of(
        {"x": "-k*x + w", "q": "-q"}, {"y": "x", "z": "q"}, params=["k"], unknown=["w"]
    )
    with pytest.raises(IdentifiabilityError, match="leave the choice open"):
        eliminate_unknown_inputs(system, using={"w": "z"})


def test_an_output_that_feels_another_unknown_input_first_is_refused():
    """z is w1, and so is all its derivatives tell; w2 can only be had from y."""
    system = system_of({"q": "w2"}, {"y": "q", "z": "w1"}, unknown=["w1", "w2"], params=[])
    with pytest.raises(IdentifiabilityError, match="another unknown input does first"):
        eliminate_unknown_inputs(system, using={"w2": "z"})


def test_a_chosen_output_may_feel_another_unknown_input_that_is_gone_in_time():
    """z = x + w1 becomes x + dy/dt - w2 once w1 has gone."""
    system = system_of({"x": "w1 + w2"}, {"y": "x", "z": "x + w1"}, unknown=["w1", "w2"], params=[])
    elimination = eliminate_unknown_inputs(system, using={"w2": "z"})
    assert elimination.used == {"w1": ("y", 1), "w2": ("z", 0)}


def test_derivatives_that_grow_beyond_bounds_are_refused(monkeypatch):
    monkeypatch.setattr(structure_algorithm, "MAX_NODES", 5)
    system = system_of(
        {"x": "-k*x^2 + q", "q": "w - k*q*x"}, {"y": "x"}, params=["k"], unknown=["w"]
    )
    with pytest.raises(IdentifiabilityError, match="use observability_by_counting"):
        eliminate_unknown_inputs(system)
