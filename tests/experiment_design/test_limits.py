"""Limits hold between the samples as well, and what cannot be kept or done is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid import Aim

SMALL: dict[str, Any] = {"Ts": 0.1, "intervals": 20, "candidates": 4, "starts": 1}


def rig(**known: float) -> casid.Problem:
    """A torque on an inertia with spring and damper, angles in degrees."""
    m = casid.Model("roll rig")
    phi, p = m.state("phi", "deg"), m.state("p", "deg/s")
    u = m.input("u", "N m")
    d = m.parameter("d", "N m s/rad", start=0.2, lower=0.0)
    k = m.parameter("k", "N m/rad", start=6.0, lower=0.0)
    J = m.parameter("J", "kg m^2", start=1.0, lower=0.01)
    m.derivative(phi, p)
    m.balance(p, "torque", inertia=J, terms=[-d * p, -k * phi, u])
    m.output("phi", phi, "deg")
    return casid.Problem("rig", m.with_known(**known), noise={"phi": 0.1})


def test_a_limit_holds_in_a_simulation_of_its_own() -> None:
    """The angle limit is what the design meets, and an independent integrator finds it kept."""
    found = casid.design_experiment(
        rig(), Aim.estimate(), {"phi": (-6, 6), "u": (-1, 1)}, 6.0, slew={"u": 4.0}, **SMALL
    )
    u, t = found.record["u"], found.record.t
    run = solve_ivp(
        lambda s, x: [x[1], float(np.interp(s, t, u)) - 0.2 * x[1] - 6.0 * x[0]],
        (0, t[-1]),
        [0.0, 0.0],
        max_step=0.01,
        rtol=1e-9,
        atol=1e-12,
    )
    highest = np.degrees(np.max(np.abs(run.y[0])))
    assert 5.0 < highest <= 6.0
    assert np.max(np.abs(u)) <= 1.0
    assert np.max(np.abs(np.diff(u))) <= 4.0 * 0.1 * (1 + 1e-6)
    assert u[0] == pytest.approx(0.0, abs=1e-9)  # begins at rest
    assert found.gain > 1.0


def test_a_limit_is_shown_in_the_unit_that_it_was_given_in() -> None:
    found = casid.design_experiment(
        rig(), Aim.estimate(), {"phi": (-0.1, 0.1, "rad"), "u": (-1, 1)}, 6.0, **SMALL
    )
    phi = next(use for use in found.limits if use.name == "phi")
    assert (phi.unit, phi.lower, phi.upper) == ("rad", pytest.approx(-0.1), pytest.approx(0.1))
    assert 0.08 < phi.highest <= phi.upper


def refusal(*arguments: Any, **settings: Any) -> str:
    with pytest.raises(casid.CasidError) as caught:
        casid.design_experiment(*arguments, **{**SMALL, **settings})
    return str(caught.value)


U = {"u": (-1, 1)}


@pytest.mark.parametrize(
    ("aim", "limits", "duration", "settings", "words"),
    [
        (Aim.estimate(), {"u": (1, -1)}, 6.0, {}, ["leaves no room", "lower end"]),
        (Aim.estimate(), {"w": (-1, 1)}, 6.0, {}, ["no such input, output or state"]),
        (Aim.estimate(), {"u": (-1, None)}, 6.0, {}, ["both ends"]),
        (Aim.estimate(), {"u": (-1, 1, "kg")}, 6.0, {}, ["no unit of it"]),
        (Aim.estimate("q"), U, 6.0, {}, ["no parameter 'q'"]),
        (Aim.estimate(), U, 0.1, {}, ["less than two samples"]),
        (Aim.estimate(), U, -1.0, {}, ["positive number of seconds"]),
        (Aim.estimate(), None, 6.0, {}, ["nothing to choose"]),
        (Aim.estimate(), None, 6.0, {"release": {"phi": (-5, 5)}}, ["--hold u=VALUE"]),
        (Aim.estimate(), {**U, "phi": (-5, 5)}, 6.0, {"x0": {"phi": 8}}, ["starts at phi = 8"]),
        (Aim.estimate(), U, 6.0, {"hold": {"u": 3}}, ["outside the limit"]),
        (
            Aim.estimate(),
            U,
            6.0,
            {"release": {"phi": (1, 5)}, "x0": {"phi": 8}},
            ["x0 of phi: 8 deg", "1 to 5"],
        ),
        (Aim.estimate(), U, 6.0, {"slew": {"u": 2}, "shape": "constant"}, ["shape='linear'"]),
        (Aim.estimate(), U, 6.0, {"noise": {"y": 1}}, ["no such output"]),
        (Aim.estimate(), U, 6.0, {"noise": {"phi": -1}}, ["noise of phi: -1", "positive", "deg"]),
        (Aim.estimate(), U, 1e9, {}, ["1e+10 samples", "longer sample time"]),
        (Aim.estimate(), U, 6.0, {"band": (1, 2)}, ["a band belongs to a multisine"]),
        (Aim.estimate(), U, (3.0, 6.0), {}, ["Aim.identifiable"]),
        (Aim.variance_of("k*q"), U, 6.0, {}, ["the function to estimate: formula 'k*q'"]),
        (Aim.detect("coulomb"), U, 6.0, {}, ["no effect 'coulomb'", "coulomb_friction"]),
        (Aim.detect("coulomb_friction"), U, 6.0, {}, ["--size coulomb_friction="]),
        (
            Aim.separate("offset", "sensor_bias@phi"),
            U,
            6.0,
            {"sizes": {"offset": 0.1}},
            ["no input separates offset in torque from sensor_bias in phi"],
        ),
    ],
)
def test_what_cannot_be_done_is_refused_with_its_remedy(
    aim: Aim, limits: Any, duration: float, settings: dict[str, Any], words: list[str]
) -> None:
    text = refusal(rig(), aim, limits, duration, **settings)
    assert all(w in text for w in words), text


def test_a_limit_that_no_input_keeps_is_named_with_how_much_it_is_exceeded() -> None:
    """Released at 8 degrees with 0.05 N m, the angle swings back beyond -3 degrees."""
    text = refusal(
        rig(),
        Aim.estimate(),
        {"u": (-0.05, 0.05), "phi": (-3, 9)},
        6.0,
        x0={"phi": 8},
    )
    assert "relax the limit of phi by" in text
    by = float(text.split("phi by ")[1].split()[0])
    # -8 exp(-pi zeta / sqrt(1 - zeta^2)), zeta = 0.2 / (2 sqrt(6)), less what the torque adds.
    swing = 8 * np.exp(-np.pi * 0.2 / (2 * np.sqrt(6)))
    torque = np.degrees(2 * 0.05 / 6)
    assert swing - 3 - torque - 0.3 < by < swing - 3 + 0.3


def test_parameters_that_no_input_identifies_are_refused_beforehand() -> None:
    m = casid.Model("push")
    v, u = m.state("v", "m/s"), m.input("u", "1")
    F, mass = m.parameter("F", "N", start=1.0), m.parameter("M", "kg", start=2.0, lower=0.1)
    m.balance(v, "force", inertia=mass, terms=[F * u])
    m.output("v", v, "m/s")
    problem = casid.Problem("push", m, noise={"v": 0.1})
    text = refusal(problem, Aim.estimate("F"), {"u": (-1, 1)}, 2.0)
    assert "F and M are not separately identifiable, but M/F is" in text


def test_a_sensor_of_which_the_noise_is_not_known_is_refused() -> None:
    model = rig().model
    text = refusal(casid.Problem("rig", model), Aim.estimate(), U, 6.0)
    assert "noise of output phi is not known" in text
    assert "--noise phi=" in text


def room() -> casid.Problem:
    """A room that cools below its limit where nobody heats it."""
    m = casid.Model("room")
    T, P = m.state("T", "degC"), m.input("P", "kW")
    C = m.parameter("C", "MJ/K", start=6.0, lower=0.1)
    H = m.parameter("H", "W/K", start=70.0, lower=1.0)
    m.balance(T, "heat", inertia=C, terms=[P, -H * (T - 273.15)])
    m.output("T_room", T, "degC")
    return casid.Problem("room", m, noise={"T_room": 0.05})


def test_standard_inputs_vary_about_one_that_keeps_the_limits_where_rest_does_not() -> None:
    """Unheated, 18 degC falls to 18 exp(-86400 / 85714) = 6.6 degC within the day."""
    found = casid.design_experiment(
        room(),
        Aim.estimate(),
        {"P": (0, 2), "T_room": (15, 25)},
        86_400.0,
        x0={"T": 18},
        interval=3600.0,
        Ts=900.0,
        candidates=20,
        starts=1,
    )
    assert {s.kind for s in found.standards} == {"step", "doublet", "chirp", "PRBS", "multisine"}
    assert 1.0 < found.gain < 10.0
    use = found.limits[-1]
    assert 15.0 <= use.lowest < use.highest <= 25.0


def test_limits_hold_between_long_intervals_in_which_the_state_swings() -> None:
    """Three intervals a period: at their ends alone the angle would look smaller than it is."""
    found = casid.design_experiment(
        rig(), Aim.estimate("d"), {"phi": (-6, 6), "u": (-1, 1)}, 12.0, **{**SMALL, "intervals": 14}
    )
    phi = next(use for use in found.limits if use.name == "phi")
    assert -6.0 <= phi.lowest < -5.0 < 5.0 < phi.highest <= 6.0
    assert found.gain > 1.2


def levitation(gain: float = 0.0) -> casid.Problem:
    """x'' = 2000 x + 50 i: poles at +-44.7 1/s; in a loop i = gain (r - x) - 2 v."""
    m = casid.Model("levitation")
    x, v = m.state("x", "mm"), m.state("v", "mm/s")
    acting = m.input("r", "mm") if gain else m.input("i", "A")
    M = m.parameter("M", "kg", start=0.1, lower=0.01)
    k_x = m.parameter("k_x", "N/m", start=200.0, lower=0.0)
    k_i = m.constant("k_i", 5.0, "N/A")
    K_p, K_d = m.constant("K_p", gain, "A/m"), m.constant("K_d", 2.0, "A s/m")
    i = K_p * (acting - x) - K_d * v if gain else acting
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[k_x * x, k_i * i])
    m.output("gap", x, "mm")
    return casid.Problem("levitation", m, noise={"gap": 0.01})


@pytest.mark.parametrize("limits", [{"i": (-1, 1)}, {"i": (-1, 1), "gap": (-2, 2)}])
def test_an_unstable_equilibrium_is_refused_with_the_time_for_which_a_plan_holds(
    limits: dict[str, Any],
) -> None:
    """A deviation grows a thousandfold within ln(1000) / sqrt(2000) = 0.1545 s."""
    text = refusal(levitation(), Aim.estimate(), limits, 2.0, Ts=0.01)
    assert "a factor of e every 0.02236 s" in text
    assert "0.1545 s at most" in text
    assert "State its controller in the model" in text


def test_an_unstable_equilibrium_is_excited_by_the_reference_of_its_loop() -> None:
    limits = {"r": (-1, 1), "gap": (-2, 2)}
    settings = {**SMALL, "Ts": 0.01}
    found = casid.design_experiment(levitation(120.0), Aim.estimate(), limits, 1.0, **settings)
    assert all(p.is_determined for p in found.parameters)
    assert all(use.lower <= use.lowest < use.highest <= use.upper for use in found.limits)


def test_an_oscillator_is_excited_though_it_leaves_its_equilibrium() -> None:
    """Its limit cycle is bounded: what deviates at the start comes back to the cycle."""
    m = casid.Model("van der Pol")
    x, v, u = m.state("x", "1", start=0.0), m.state("v", "1/s"), m.input("u", "1/s^2")
    mu = m.parameter("mu", "1/s", start=1.0, lower=0.0)
    stiffness = m.constant("omega_0^2", 1.0, "1/s^2")
    m.derivative(x, v)
    m.derivative(v, u + mu * (1 - x**2) * v - stiffness * x)
    m.output("x", x, "1")
    problem = casid.Problem("van der Pol", m, noise={"x": 0.01})
    settings = {**SMALL, "Ts": 0.2, "starts": 0}
    found = casid.design_experiment(problem, Aim.estimate(), {"u": (-1, 1)}, 20.0, **settings)
    assert found.parameters[0].is_determined
