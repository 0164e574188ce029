"""The class of an input decides what is identifiable; own and shared inputs differ."""

from __future__ import annotations

import json
from fractions import Fraction

import casadi as ca
import pytest

from casid.errors import ModelError
from casid.identifiability.equations.equation_text import parse_system
from casid.identifiability.equations.system import System
from casid.identifiability.inputs.elimination import eliminate_unknown_inputs
from casid.identifiability.inputs.experiments import merge, replicas, systems_by_class
from casid.identifiability.inputs.input_classes import (
    Exosystem,
    as_exosystem,
    as_harmonic,
    as_polynomial,
    as_zero,
    with_input_class,
)
from casid.identifiability.rank.observability import observability
from tests.support.formula_systems import system_of
from tests.support.shared import shared


def identifiable(systems):
    return {p for p, told in observability(systems).identifiable.items() if told}


def numbers(systems):
    result = observability(systems)
    return result.rank, result.unknowns


# -- classes of unknown inputs ---------------------------------------------------------------------


@pytest.mark.parametrize("degree", [0, 1, 2, 4])
@pytest.mark.parametrize("model", ["c2m_w_b", "dof2_F2", "hiv_eta_unknown"])
def test_polynomial_unknown_inputs_give_the_published_ranks(model, degree):
    """The degree + 1 coefficients count among the unknowns."""
    fields = json.loads(shared(f"identifiability/{model}.json").read_text())
    expected = fields["expected"]["if_unknown_input_is_polynomial_of_degree"][str(degree)]
    result = observability(as_polynomial(parse_system(fields), degree))
    assert (result.rank, result.unknowns) == (expected["rank"], expected["unknowns"])
    told = {p for p, is_told in result.identifiable.items() if is_told}
    assert set(result.parameters) - told == set(expected["non_identifiable"])


def test_the_class_of_the_unknown_input_changes_the_verdict():
    """m v' = -d v + w with v and v' measured.

    Arbitrary: w absorbs m and d. Zero: v' = -(d/m) v. Constant: v' = -(d/m) v + w/m. Both tell
    d/m alone. A second experiment with a known added mass tells m and d unless w is arbitrary.
    """
    light, heavy = (
        system_of(
            {"v": f"(w - d*v)/({mass})"},
            {"y1": "v", "y2": f"(w - d*v)/({mass})"},
            params=["m", "d"],
            unknown=["w"],
            constants=constants,
        )
        for mass, constants in (("m", []), ("m + dm", ["dm"]))
    )
    alone = systems_by_class(light)
    assert list(alone) == [
        "arbitrary",
        "polynomial_0",
        "polynomial_1",
        "polynomial_2",
        "harmonic",
        "zero",
    ]
    assert {observability(s).deficiency for s in alone["arbitrary"]} == {2}
    assert {k for k, s in alone.items() if observability(s).deficiency == 1} == set(alone) - {
        "arbitrary"
    }
    both = {k: identifiable(s) for k, s in systems_by_class((light, heavy)).items()}
    assert both.pop("arbitrary") == set()
    assert all(told == {"m", "d"} for told in both.values())


def pendulum(outputs=("gyro", "accel")):
    """I phi'' = -(k + S g) phi - d phi' + S a_y (7.10), S, g and z_s known; Linder (2017)."""
    torque = "(-(k + S*g)*phi - d*p + S*a_y)/I"
    formulas = {"gyro": "p", "accel": f"z_s*{torque} + g*phi - a_y"}
    return system_of(
        {"phi": "p", "p": torque},
        {y: formulas[y] for y in outputs},
        params=["I", "k", "d"],
        unknown=["a_y"],
        constants=["S", "g", "z_s"],
    )


def test_pendulum_rank_is_five_with_the_cart_moving_and_four_with_it_at_rest():
    """Linder (2017), 7.2.1 and 7.3.1: rank 5 of 5, and 4 although a_s moves with the pendulum."""
    assert numbers(eliminate_unknown_inputs(pendulum()).system) == (5, 5)
    assert numbers(as_zero(pendulum())) == (4, 5)
    assert numbers(as_zero(pendulum(outputs=["gyro"]))) == (4, 5)


def test_an_input_that_is_a_function_of_the_states_carries_no_information():
    """With a_y = K phi, or K phi + L phi', gains known, two coefficients tell three parameters.

    The cart moves, and the accelerometer with it; the rank is that of a cart at rest.
    """
    for formula in ("S*phi", "S*phi + g*p"):  # any known gains
        assert numbers(as_exosystem(pendulum(), Exosystem({}, {"a_y": formula}))) == (4, 5)


def test_an_input_with_states_of_its_own_excites():
    """A sinusoid of unknown amplitude, phase and frequency: 5 unknowns and 3 more, all told."""
    result = observability(as_harmonic(pendulum()))
    assert (result.rank, result.unknowns) == (8, 8)
    assert result.parameters == ("I", "k", "d")  # the frequency is not asked about
    known = observability(as_harmonic(pendulum(), is_frequency_known=True))
    assert (known.rank, known.unknowns) == (7, 7)


def test_a_harmonic_is_the_exosystem_that_a_user_writes_down():
    system = pendulum()
    a, b, r = (ca.SX.sym(n) for n in "abr")
    text = Exosystem({"a": "b", "b": "-r^2*a", "r": "0"}, {"a_y": "a"})
    graph = Exosystem(
        {"a": b, "b": -(r**2) * a, "r": 0}, {"a_y": a}, symbols={"a": a, "b": b, "r": r}
    )
    assert numbers(as_exosystem(system, text)) == numbers(as_harmonic(system))
    assert numbers(as_exosystem(system, graph)) == numbers(as_harmonic(system))
    assert as_harmonic(system).states == ("phi", "p", "a_y_0", "a_y_1", "a_y_omega")


def test_a_polynomial_has_its_derivatives_as_states():
    system = as_polynomial(pendulum(), 2)
    assert system.states == ("phi", "p", "a_y_0", "a_y_1", "a_y_2")
    assert [str(e) for e in ca.vertsplit(system.f)[2:]] == ["a_y_1", "a_y_2", "0"]
    assert system.unknown_inputs == ()


def test_new_states_do_not_take_names_that_are_taken():
    system = system_of({"w_0": "w - w_1*w_0"}, {"y": "w_0"}, params=["w_1"], unknown=["w"])
    made = as_polynomial(system, 1)
    assert made.states == ("w_0", "w_0_2", "w_1_2")
    assert numbers(made) == (4, 4)


def test_an_exosystem_may_hold_parameters_of_the_system():
    """Waves that decay at the rate that is asked about: y' = -k y + w, w' = -k w."""
    system = system_of({"y": "-k*y + w"}, {"y": "y"}, params=["k"], unknown=["w"])
    assert identifiable(as_exosystem(system, Exosystem({"z": "-k*z"}, {"w": "z"}))) == {"k"}


# -- classes of known inputs -----------------------------------------------------------------------


def moving_average():
    """y = b0 u + b1 u' + b2 u'': as many parameters as the input's order of excitation tells."""
    system = system_of(
        {}, {"y": "b0*u + b1*u1 + b2*u2"}, params=["b0", "b1", "b2"], known=["u", "u1", "u2"]
    )
    return system.where(inputs=("u",), input_derivatives={"u1": ("u", 1), "u2": ("u", 2)})


@pytest.mark.parametrize(
    ("kind", "rank", "told"),
    [
        ("generic", 3, {"b0", "b1", "b2"}),
        ("harmonic", 2, {"b1"}),  # u'' = -omega^2 u: b0 - omega^2 b2 and b1
        ("constant", 1, {"b0"}),
        ("ramp", 2, {"b0", "b1"}),
        (("polynomial", 2), 3, {"b0", "b1", "b2"}),
        ("zero", 0, set()),
        (0.5, 1, {"b0"}),
    ],
)
def test_an_input_tells_as_many_parameters_as_it_is_exciting(kind, rank, told):
    """A sinusoid is persistently exciting of order two, a constant of order one (Ljung, ch. 13)."""
    system = with_input_class(moving_average(), {"u": kind})
    assert numbers(system) == (rank, 3)
    assert identifiable(system) == told


def test_the_class_of_a_known_input_may_be_said_before_or_after_elimination():
    """The derivative of u that elimination brings in is the derivative of its class."""
    system = system_of(
        {"x": "w - a*x", "q": "w - b*q*u"},
        {"y": "x", "z": "q", "s": "x + b*q"},
        params=["a", "b"],
        known=["u"],
        unknown=["w"],
    )
    elimination = eliminate_unknown_inputs(system, using={"w": "y"})
    for kind in ("ramp", "harmonic", "zero", 2.0):
        after = with_input_class(elimination.system, {"u": kind})
        before = eliminate_unknown_inputs(with_input_class(system, {"u": kind}))
        assert "u" not in after.inputs
        assert numbers(after) == numbers(before.system)
        assert identifiable(after) == identifiable(before.system)


def test_derivatives_of_a_known_input_follow_its_class():
    u, du = ca.SX.sym("u"), ca.SX.sym("du")
    system = System(
        "lead",
        (),
        ("b",),
        ("y",),
        {"u": u, "du": du, "b": (b := ca.SX.sym("b"))},
        ca.SX(0, 1),
        b * du,
        inputs=("u",),
        input_derivatives={"du": ("u", 1)},
    )
    ramp = with_input_class(system, {"u": "ramp"})
    assert str(ramp.h) == "(b*u_1)"
    assert ramp.known_initial == ("u_0", "u_1")
    assert with_input_class(system, {"u": "constant"}).h.is_zero()


# -- several experiments ---------------------------------------------------------------------------


def tank(name="tank"):
    return system_of(
        {"x": "-k*x + b*u + w"},
        {"level": "x", "flow": "c*x + w"},
        params=["k", "b", "c"],
        known=["u"],
        unknown=["w"],
        name=name,
    )


def test_merging_without_shared_signals_changes_nothing():
    pair = replicas(tank(), 2)
    apart = [eliminate_unknown_inputs(s).system for s in pair]
    together = eliminate_unknown_inputs(merge(pair)).system
    assert numbers(apart) == numbers(together)
    assert identifiable(apart) == identifiable(together)


def test_merged_experiments_have_recognisable_names():
    merged = merge(replicas(tank(), 3), shared=["w"])
    assert merged.states == ("x", "x_2", "x_3")
    assert merged.outputs == ("level", "flow", "level_2", "flow_2", "level_3", "flow_3")
    assert merged.inputs == ("u", "u_2", "u_3")
    assert merged.unknown_inputs == ("w",)
    assert merged.parameters == ("k", "b", "c")
    assert merge(replicas(tank(), 2), shared=["w", "u"]).inputs == ("u",)


def test_merged_experiments_do_not_take_names_that_are_taken():
    first = system_of({"x": "-k*x", "x_2": "x"}, {"y": "x_2"}, params=["k"])
    merged = merge([first, first])
    assert merged.states == ("x", "x_2", "x_2_2", "x_2_2_2")
    assert numbers(merged) == numbers([first, first])


def test_merging_keeps_what_is_known_at_the_start():
    first = tank("first").where(known_initial=("x",))
    second = tank("second").where(initial_values={"x": Fraction(1, 2)}, units={"x": "m"})
    merged = merge([first, second])
    assert merged.known_initial == ("x",)
    assert dict(merged.initial_values) == {"x_2": Fraction(1, 2)}
    assert dict(merged.units) == {"x_2": "m"}


def test_derivatives_of_a_shared_input_are_shared():
    system = moving_average()
    merged = merge([system, system], shared=["u"])
    assert dict(merged.input_derivatives) == {"u1": ("u", 1), "u2": ("u", 2)}
    own = merge([system, system])
    assert own.input_derivatives["u2_2"] == ("u_2", 2)
    assert numbers(own) == numbers(merged) == (3, 3)


def test_a_shared_unknown_input_is_measured_once_for_all():
    """Two sensors with unknown gains on one force tell the ratio of gains; own forces nothing."""
    scale = [
        system_of({}, {"y": f"{gain}*w"}, params=[gain], unknown=["w"], name=gain)
        for gain in ("a", "b")
    ]
    own = systems_by_class(scale)["arbitrary"]
    assert observability(own).deficiency == 2
    together = systems_by_class(scale, shared=["w"])["arbitrary"]
    assert observability(together).deficiency == 1


def test_replicas_are_read_once():
    assert len({id(s) for s in replicas(tank(), 4)}) == 1
    assert len({id(s) for s in systems_by_class(replicas(tank(), 4))["arbitrary"]}) == 1


# -- refusals --------------------------------------------------------------------------------------


def test_names_that_are_not_inputs_are_refused_with_the_mend():
    system = tank()
    with pytest.raises(ModelError, match="use with_input_class"):
        as_polynomial(system, 1, ["u"])
    with pytest.raises(ModelError, match="known are: w"):
        as_zero(system, ["wave"])
    with pytest.raises(ModelError, match="use as_polynomial"):
        with_input_class(system, {"w": "ramp"})
    with pytest.raises(ModelError, match="known are: u, w"):
        as_exosystem(system, Exosystem({}, {"wave": "0"}))


@pytest.mark.parametrize("degree", [-1, 1.5, True, 51])
def test_a_degree_is_a_whole_number(degree):
    with pytest.raises(ModelError, match="from 0 .a constant. to 50"):
        as_polynomial(tank(), degree)


@pytest.mark.parametrize("kind", ["saw", ("polynomial",), None])
def test_an_unknown_class_is_refused_with_a_list_of_them(kind):
    with pytest.raises(ModelError, match="'generic', 'zero', 'constant', 'ramp'"):
        with_input_class(tank(), {"u": kind})


def test_an_exosystem_that_contradicts_the_system_is_refused():
    with pytest.raises(ModelError, match="rename it"):
        as_exosystem(tank(), Exosystem({"x": "0"}, {"w": "x"}))
    with pytest.raises(ModelError, match="'w' is not declared"):
        as_exosystem(tank(), Exosystem({"z": "w"}, {"w": "z"}))
    with pytest.raises(ModelError, match="'open' is not|unknown function 'open'"):
        as_exosystem(tank(), Exosystem({"z": "open(1)"}, {"w": "z"}))
    with pytest.raises(ModelError, match="no such state"):
        Exosystem({"z": "0"}, {"w": "z"}, known_initial=("zz",))


def test_an_algebraic_loop_through_an_input_is_refused():
    """u = x and x' = w + du/dt: the derivative of u is a formula of itself."""
    system = system_of({"x": "du - x"}, {"y": "x"}, known=["u", "du"])
    system = system.where(inputs=("u",), input_derivatives={"du": ("u", 1)})
    with pytest.raises(ModelError, match="algebraic loop"):
        as_exosystem(system, Exosystem({}, {"u": "x"}))


def test_what_cannot_be_shared_is_refused():
    with pytest.raises(ModelError, match="there are w, u"):
        merge(replicas(tank(), 2), shared=["wave"])
    known = system_of({"x": "-k*x + w"}, {"y": "x"}, params=["k"], known=["w"], name="other")
    with pytest.raises(ModelError, match="declare it alike"):
        merge([tank(), known], shared=["w"])
    with pytest.raises(ModelError, match="with_known in both"):
        merge([tank("first"), tank("second").with_known("k")])
    with pytest.raises(ModelError, match="one value for all"):
        merge([tank().where(at={"k": Fraction(0)}), tank().where(at={"k": Fraction(1)})])
    with pytest.raises(ModelError, match="at least one"):
        merge([])
    with pytest.raises(ModelError, match="once or more often"):
        replicas(tank(), 0)


# -- inputs that the equations divide by -----------------------------------------------------------

RATIO = {
    "states": ["c"],
    "params": ["V", "a"],
    "known_inputs": ["q", "F"],
    "equations": {"c": "F*(a*q/F - c)/V"},
    "outputs": {"y": "c"},
}


@pytest.mark.parametrize("outputs", [{"y": "c"}, {"y": "c", "ratio": "a*q/F"}])
def test_an_input_that_the_equations_divide_by_is_not_zero(outputs):
    """Also where F stands before the quotient: 0 * (q / 0) has no value, and is not 0."""
    mixer = parse_system({**RATIO, "outputs": outputs})
    with pytest.raises(ModelError, match="with F = 0: the equations divide by F; correct"):
        with_input_class(mixer, {"F": "zero"})
    with pytest.raises(ModelError, match="with F = 0: the equations divide by F; correct"):
        with_input_class(mixer, {"F": 0.0})
    assert with_input_class(mixer, {"F": 2.0}).inputs == ("q",)
    assert with_input_class(mixer, {"q": "zero"}).inputs == ("F",)


def test_an_unknown_input_that_the_equations_divide_by_is_not_zero_either():
    system = {k: v for k, v in RATIO.items() if k != "known_inputs"}
    mixer = parse_system({**system, "known_inputs": ["q"], "unknown_inputs": ["F"]})
    with pytest.raises(ModelError, match="with F = 0: the equations divide by F; correct"):
        as_zero(mixer)
