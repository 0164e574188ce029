"""A simulation has its integrator's order, holds inputs as told, and knows its own gradient."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.signal import cont2discrete

import casid
from casid.estimation.simulation.integration import simulator
from casid.estimation.simulation.integration.simulator import Simulator
from casid.estimation.simulation.thresholds import STEPS

M, D, K, TS = 2.0, 1.5, 50.0, 0.05


def oscillator(hold: str = "foh") -> casid.Model:
    m = casid.Model("oscillator")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("force", "N", hold=hold)
    mass = m.parameter("m", "kg", start=M)
    d = m.parameter("d", "N s/m", start=D)
    k = m.parameter("k", "N/m", start=K)
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[-k * x - 40.0 * x**3, -d * v, force])
    m.output("position", x, "m")
    m.output("acceleration", m.der(v), "m/s^2")
    return m


def linear(hold: str) -> casid.Model:
    m = casid.Model("linear")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("force", "N", hold=hold)
    k = m.parameter("k", "N/m", start=K)
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[-k * x, -D * v, force])
    m.output("position", x, "m")
    return m


def test_halving_the_step_divides_the_error_of_the_fourth_order_method_by_sixteen():
    """Global error C h^4 of classical Runge-Kutta (Hairer, Norsett, Wanner 1993, II.1)."""
    u = np.sin(np.arange(41) * TS)[:, None]
    p, x0 = np.array([M, D, K]), np.array([0.4, 0.0])
    end = {
        n: Simulator(oscillator(), TS, substeps=n).simulate(u, p, x0).x[-2] for n in (2, 4, 8, 64)
    }
    error = [float(np.linalg.norm(end[n] - end[64])) for n in (2, 4, 8)]
    # The next term is of relative size w h = 0.06 at the coarser pair.
    assert error[0] / error[1] == pytest.approx(16, rel=0.25)
    assert error[1] / error[2] == pytest.approx(16, rel=0.15)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_inputs_are_held_or_joined_by_straight_lines_as_declared(hold):
    """The sampled system is scipy's exact discretisation under the same hold."""
    u = np.random.default_rng(3).normal(size=(60, 1))
    A, B = np.array([[0.0, 1.0], [-K / M, -D / M]]), np.array([[0.0], [1 / M]])
    C, Z = np.array([[1.0, 0.0]]), np.zeros((1, 1))
    a, b, c, d, _ = cont2discrete((A, B, C, Z), TS, method=hold)
    # scipy's first-order hold shifts the state: x_s = x - b_1 u with the direct term d.
    y = np.zeros(60)
    x = np.zeros(2) if hold == "zoh" else -_feed(A, B) @ u[0]
    for k in range(60):
        y[k] = (c @ x + d @ u[k])[0]
        x = a @ x + b @ u[k]
    run = Simulator(linear(hold), TS, substeps=20).simulate(u, np.array([K]), np.zeros(2))
    assert run.y[:, 0] == pytest.approx(y, abs=1e-9)  # (w h)^5 with h = 2.5 ms: 2e-10


def test_a_band_limited_input_is_what_it_was_before_it_was_sampled():
    """The steady state under sines up to 0.8 of half the sampling rate, in closed form.

    Joined by straight lines, a sine of frequency w loses sinc^2(w Ts / 2 pi) of its amplitude.
    """
    t = TS * np.arange(1200)
    y, u, x0 = 0.0 * t, 0.0 * t, np.zeros(2)
    for share, phase in ((0.1, 0.3), (0.45, 1.0), (0.8, 2.0)):
        w = share * np.pi / TS
        response = 1 / (K - M * w**2 + 1j * w * D)
        wave = w**2 * np.exp(1j * (w * t + phase))
        u, y = u + wave.real, y + (response * wave).real
        x0 = x0 + np.array([(response * wave[0]).real, (1j * w * response * wave[0]).real])
    # Beyond its ends the record lacks samples; what that starts dies out in 2 M / D = 2.7 s.
    inside = slice(700, -100)
    error = {}
    for hold in ("bandlimited", "foh"):
        run = Simulator(linear(hold), TS, substeps=4).simulate(u[:, None], np.array([K]), x0)
        error[hold] = float(np.std((run.y[:, 0] - y)[inside]) / np.std(y))
    assert error["bandlimited"] < 2e-3
    assert error["foh"] > 0.1


@pytest.fixture(params=["one step", "known motion"])
def of_any_width(request, monkeypatch):
    """Sensitivities as one step with the states, and along a motion that is known."""
    monkeypatch.setattr(simulator, "WIDE", 0 if request.param == "known motion" else np.inf)


@pytest.mark.usefixtures("of_any_width")
@pytest.mark.parametrize("substeps", [1, 3])
def test_a_part_of_a_record_is_driven_as_in_the_whole(substeps):
    """The course of a band-limited input is that of the record, not of the part."""
    u = np.random.default_rng(4).normal(size=(80, 1))
    s = Simulator(linear("bandlimited"), TS, ["k"], substeps=substeps)
    p, x0 = np.array([K]), np.zeros(2)
    whole = s.sensitivities(u, p, x0)
    wide = s.with_courses(u)
    first = s.sensitivities(wide[:30], p, x0, after=u[30])
    rest = s.simulate(wide[30:], p, first.x[-1])
    assert np.concatenate([first.y, rest.y]) == pytest.approx(whole.y, abs=1e-14)


def _feed(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """The direct term of the state under a first-order hold: scipy's d with C = I."""
    return cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), TS, method="foh")[3]


@pytest.mark.usefixtures("of_any_width")
def test_sensitivities_are_the_derivatives_of_the_simulation_as_computed():
    rng = np.random.default_rng(3)
    u, p, x0 = rng.normal(size=(50, 1)), np.array([M, D, K]), np.array([0.3, -0.2])
    s = Simulator(oscillator(), TS, ["m", "d", "k"], substeps=2)
    run = s.sensitivities(u, p, x0, after=np.array([0.7]))
    v = np.r_[p, x0]
    extended = np.vstack([u, [[0.7]]])
    for i in range(5):
        h = 1e-6 * max(abs(v[i]), 0.1)
        up, down = v.copy(), v.copy()
        up[i] += h
        down[i] -= h
        a, b = (s.simulate(extended, w[:3], w[3:]) for w in (up, down))
        # Central differences: truncation h^2 and rounding eps / h, both below 1e-8 of the size.
        slope = (a.y - b.y)[:50] / (2 * h)
        assert run.dy[:, :, i] == pytest.approx(slope, abs=1e-6 * np.abs(slope).max())
        slope = (a.x - b.x)[50] / (2 * h)
        assert run.dx_end[:, i] == pytest.approx(slope, abs=1e-6 * np.abs(slope).max())


def test_simulation_with_and_without_sensitivities_is_the_same():
    u, p, x0 = np.ones((30, 1)), np.array([M, D, K]), np.array([0.1, 0.0])
    s = Simulator(oscillator(), TS, ["k"])
    assert s.sensitivities(u, p, x0).y == pytest.approx(s.simulate(u, p, x0).y, abs=1e-15)


def test_a_diverging_simulation_returns_values_that_are_not_finite():
    m = casid.Model("explosion")
    x = m.state("x", "m")
    m.parameter("a", "1/(m s)", start=1.0)
    m.derivative(x, m.symbol("a") * x**2)
    m.output("y", x, "m")
    run = Simulator(m, 0.1).simulate(np.zeros((60, 0)), np.array([1.0]), np.array([1.0]))
    assert not np.all(np.isfinite(run.y))
    assert np.all(np.isfinite(run.y[:9]))  # x = 1 / (1 - t) until its pole


def dragged() -> casid.Model:
    """A mass with dry friction that reverses within 1 mm/s of rest."""
    m = casid.Model("dragged")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    force = m.input("force", "N", hold="foh")
    F_c = m.parameter("F_c", "N", start=10.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[force, -K * x, -D * v, -F_c * ca.tanh(v / V_0)])
    m.output("position", x, "m")
    m.output("speed", v, "m/s")
    return m


V_0 = 1e-3
STICK_SLIP = np.array([[25.0]]) * np.sin(0.9 * np.arange(1500) * 0.005)[:, None]


def test_fine_steps_where_friction_reverses_are_as_good_as_fine_steps_everywhere(monkeypatch):
    """Two steps and one agree to e where the two err by e / 15 (Richardson), of every sample."""
    chosen = Simulator(dragged(), 0.005, ["F_c"], substeps=32)
    run = chosen.sensitivities(STICK_SLIP, np.array([10.0]), np.zeros(2))
    monkeypatch.setattr(simulator, "STEPS", replace(STEPS, many=1000))
    everywhere = Simulator(dragged(), 0.005, ["F_c"], substeps=32)
    fine = everywhere.sensitivities(STICK_SLIP, np.array([10.0]), np.zeros(2))
    resting = np.abs(fine.x[:-1, 1]) < V_0
    assert 0.05 < resting.mean() < 0.5  # it sticks, and it slides
    for one, other in ((run.y, fine.y), (run.dy, fine.dy)):
        error = np.abs(one - other).max(axis=0) / np.abs(other).max(axis=0)
        assert np.all(error < STEPS.easy * len(STICK_SLIP) / 15)


def test_a_smooth_motion_takes_two_steps_a_sample_however_many_it_may(monkeypatch):
    u = np.sin(np.arange(300) * 0.001)[:, None]
    p, x0 = np.array([M, D, K]), np.array([0.4, 0.3])
    two, many = (Simulator(oscillator(), 0.001, substeps=n).simulate(u, p, x0) for n in (2, 32))
    np.testing.assert_allclose(many.x, two.x, rtol=1e-14)
