"""The rig: its pendulum obeys mechanics, its clocks are found, its records are what they claim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import casid
from casid.errors import DataError
from casid.model.dimensions import check_units
from problems import pendulum_rig as rig
from problems.pendulum_rig import NOISELESS, G, Pendulum
from tests.support.shared import ROOT

V = rig.TABLES_7_3_AND_7_4
LOADED = Pendulum(m=V["m"])


# -- its mechanics -----------------------------------------------------------------------------


def test_the_load_raises_the_gain_from_cart_to_angle_as_published():
    """Table 7.4: S/I_1 from -3.647 to -4.372; beta1 of (7.29) from 6.334 to 8.893.

    The published numbers leave out the load's own inertia I_xm, 0.06 % of I_1.
    """
    for plant, direct, indirect in ((Pendulum(), 3.647, 6.334), (LOADED, 4.372, 8.893)):
        I_1 = plant.I_1 - (V["I_xm"] if plant.m else 0.0)
        assert plant.S / I_1 == pytest.approx(-direct, abs=6e-4)
        assert -plant.S / (I_1 - V["z_s"] * plant.S) == pytest.approx(indirect, abs=6e-4)


@pytest.mark.parametrize("kappa", [0.0, 5.0])
def test_without_damping_a_free_swing_keeps_its_energy(kappa):
    """E = I_1 p^2/2 + k phi^2/2 + k kappa phi^4/4 - S g cos(phi).

    Runge-Kutta 4 shrinks an oscillation's square by (w h)^6/72 a step. Springs that stiffen raise
    w: at 0.3 rad by less than (1 + kappa phi^2)^(1/2).
    """
    plant, n = Pendulum(d=0.0, kappa=kappa), 4000
    still = np.zeros(2 * n - 1)
    phi, p, _ = plant.motion(still, still, rig.STEP, phi=0.3)
    energy = (
        plant.I_1 * p**2 / 2
        + plant.k * phi**2 / 2
        + plant.k * kappa * phi**4 / 4
        - plant.S * G * (np.cos(phi) - 1)
    )
    w = np.sqrt((plant.k * (1 + kappa * 0.3**2)) / plant.I_1)
    assert np.abs(phi).max() == pytest.approx(0.3, rel=1e-4)
    assert np.ptp(energy) / energy[0] < 2 * n * (w * rig.STEP) ** 6 / 72


@pytest.mark.parametrize("kappa", [0.0, 5.0])
def test_a_steady_acceleration_leans_the_pendulum_to_where_the_torques_balance(kappa):
    """k(phi) phi = S (a_y cos(phi) - g sin(phi)): (7.9) at rest."""
    plant, n = replace(LOADED, d=0.2, kappa=kappa), 8000
    steady = np.full(2 * n - 1, 4.0)
    phi, p, _ = plant.motion(steady, np.zeros(2 * n - 1), rig.STEP)
    lean = phi[-1]
    assert abs(p[-1]) < 1e-9
    assert abs(lean) > 0.05
    spring = plant.k * (1 + kappa * lean**2) * lean
    assert spring == pytest.approx(plant.S * (4.0 * np.cos(lean) - G * np.sin(lean)), rel=1e-9)


@pytest.mark.parametrize("kappa", [0.0, 2.0])
def test_the_linear_model_is_left_by_no_more_than_the_square_of_the_angle_allows(kappa):
    """The difference e of angle and linear angle obeys I_1 e'' + d e' + (k + S g) e = f with

        f = -k kappa phi^3 - S g (sin(phi) - phi) + S a_y (cos(phi) - 1),
        |f| <= k kappa |phi|^3 + |S| g |phi|^3/6 + |S a_y| phi^2/2,

    so |e| <= ||h||_1 max |f|, where the impulse response has ||h||_1 = coth(x/2)/(k + S g) with
    x = pi zeta/(1 - zeta^2)^(1/2): its half-waves shrink by exp(-x).
    """
    plant, n = Pendulum(d=0.03, kappa=kappa), 12_000
    t = rig.STEP / 2 * np.arange(2 * n - 1)
    a_y = rig.dragged(t, 1.0, np.random.default_rng(1))
    phi = plant.motion(a_y, np.zeros_like(a_y), rig.STEP)[0]
    spring = plant.k + plant.S * G
    system = ([plant.S], [plant.I_1, plant.d, spring])
    b, a, _ = cont2discrete(system, rig.STEP / 2, method="foh")
    linear = lfilter(b.ravel(), a, a_y)[::2]
    w, zeta = np.sqrt(spring / plant.I_1), plant.d / (2 * np.sqrt(spring * plant.I_1))
    norm = 1 / np.tanh(np.pi * zeta / np.sqrt(1 - zeta**2) / 2) / spring
    f = (plant.k * kappa + abs(plant.S) * G / 6) * np.abs(phi) ** 3 + abs(plant.S) * np.abs(
        a_y[::2]
    ) * phi**2 / 2
    difference = np.abs(phi - linear).max()
    # a_y does not begin at zero: the linear answer misses an impulse of half a sample before t = 0.
    onset = np.abs(a_y[0]) * rig.STEP / 2 * abs(plant.S) / (plant.I_1 * w)
    # Straight lines between samples: (w T)^2/8 of the signal at 3 Hz, amplified by resonance.
    lines = (2 * np.pi * 3.0 * rig.STEP / 2) ** 2 / 8 * np.abs(phi).max() / (2 * zeta)
    assert difference <= norm * f.max() + onset + lines
    assert norm * f.max() < 0.25 * np.abs(phi).max()  # the bound says something
    if kappa:
        assert difference > onset + lines  # and the springs are seen to stiffen


@pytest.mark.parametrize("kappa", [0.0, 5.0])
def test_eliminating_the_cart_is_exact_for_the_nonlinear_pendulum(kappa):
    """I_2 phi'' = -k phi - d phi' - S a_s (7.24) at every sample, less stiffening: k kappa phi^3.

    What is left is the interpolation between steps, (3 w h)^6/205 of each term at the third
    harmonic, w the frequency at the largest angle.
    """
    run = rig.record(
        replace(LOADED, kappa=kappa), duration=10.0, amplitude=2.0, sensors=NOISELESS, seed=2
    )
    plant, a_s = run.plant, run.pendulum["accel"]
    phi, p, p_dot = (run.truth[n] for n in ("phi", "p", "p_dot"))
    free = run.pendulum.t > run.released
    I_2 = plant.I_1 - V["z_s"] * plant.S
    residual = I_2 * p_dot + plant.k * phi + plant.d * p + plant.S * a_s
    stiffening = -plant.k * kappa * phi**3
    assert np.abs(phi).max() > 0.15
    w = np.sqrt(plant.k * (1 + 3 * kappa * np.max(phi**2)) / plant.I_1)
    left = (3 * w * rig.STEP) ** 6 / 205
    np.testing.assert_allclose(
        residual[free], stiffening[free], rtol=0, atol=left * np.abs(plant.k * phi).max()
    )


# -- its clocks --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_the_knocks_tell_the_offset_of_the_clocks_as_well_as_noise_allows(seed):
    """Delay between two noisy copies of a pulse train: var = 2 sigma^2 Ts / integral(a'^2 dt).

    A Gaussian pulse of height h and width s has integral h^2 pi^(1/2)/(2 s). The estimate lies
    within four of these standard deviations (5 microseconds each), and its own claim near them.
    """
    run = rig.record(duration=2.0, seed=seed)
    found = rig.aligned(run)
    heights = sum(h**2 for _, h in rig.KNOCKS)
    energy = heights * np.sqrt(np.pi) / (2 * rig.KNOCK_WIDTH)
    deviation = np.sqrt(2 * 0.01**2 * 0.01 / energy)
    assert abs(found.offset - run.offset) < 4 * deviation
    assert 0.1 * deviation < found.std_error < 10 * deviation


def test_while_the_pendulum_is_held_both_units_feel_the_same():
    run = rig.record(duration=2.0, sensors=NOISELESS, seed=3)
    held = run.pendulum.t < run.released
    np.testing.assert_array_equal(run.truth["phi"][held], 0.0)
    np.testing.assert_array_equal(run.pendulum["accel"][held], -run.truth["a_y"][held])
    assert run.truth["a_y"][held].max() == pytest.approx(22.0, rel=0.1)  # pulses fall on samples


def test_merging_puts_the_carts_acceleration_where_it_acted():
    """Without noise the offset is found to a microsecond; a_y moves by 20 m/s^3 at most."""
    run = rig.record(duration=10.0, sensors=NOISELESS, seed=4)
    both = rig.merged(run)
    late = both.t > run.released
    rows = np.rint((both.t[late] - run.pendulum.t0) / run.pendulum.Ts).astype(int)
    np.testing.assert_allclose(both["ref"][late], run.truth["a_y"][rows], atol=1e-4)


# -- its records ---------------------------------------------------------------------------------


def test_a_prepared_record_has_50_samples_a_second_and_no_mean():
    nominal, loaded = rig.experiments(duration=20.0, seed=5)
    for experiment in (nominal, loaded):
        record = experiment.record
        assert (record.N, record.Ts, set(record.names)) == (1000, 0.02, {"gyro", "accel", "ref"})
        for name in record.names:
            assert abs(record[name].mean()) < 1e-12
    assert dict(nominal.known) == {"m": 0.0, "I_xm": 0.0}
    assert dict(loaded.known) == {"I_xm": V["I_xm"]}
    known = rig.experiments(duration=2.0, load_known=True)[1].known
    assert dict(known) == {"m": V["m"], "I_xm": V["I_xm"]}


def test_asking_for_more_than_was_recorded_is_refused():
    run = rig.record(duration=2.0)
    with pytest.raises(DataError, match=r"60 s are requested.*record for longer"):
        rig.prepared(run, duration=60.0)


def test_dragging_stays_in_its_band():
    t = 0.01 * np.arange(20_000)
    a_y = rig.dragged(t, 0.5, np.random.default_rng(6))
    frequency = np.fft.rfftfreq(t.size, 0.01)
    power = np.abs(np.fft.rfft(a_y)) ** 2
    inside = (frequency >= 0.3) & (frequency <= 3.0)
    assert np.sqrt(np.mean(a_y**2)) == pytest.approx(0.5, rel=1e-12)
    assert power[~inside].sum() < 1e-20 * power.sum()


def test_the_rig_is_a_problem_whose_example_is_the_same_every_time():
    problem = casid.load_problem(ROOT / "problems" / "pendulum_rig.py")
    check_units(problem.model)
    (first,), (again,) = problem.examples(), problem.examples()
    signals = {*problem.model.inputs, *problem.model.outputs, *problem.recorded}
    assert set(first.record.names) == signals
    for name in signals:
        np.testing.assert_array_equal(first.record[name], again.record[name])


def test_the_model_of_the_rig_is_the_tangent_of_its_simulator():
    """(7.10) against central differences of phi'' in phi, phi' and a_y at rest, both loads."""
    import casadi as ca

    model = rig.direct_model()
    e = model.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f[1]])
    for plant in (Pendulum(), LOADED):
        values = {
            "k": plant.k,
            "d": plant.d,
            "I_x": V["I_x"],
            "m": plant.m,
            "I_xm": V["I_xm"] if plant.m else 0.0,
        }
        p = [values.get(n, model.parameters[n].value) for n in e.parameters]
        for direction in np.eye(3):
            ahead, behind = (plant.acceleration(*(s * 1e-4 * direction)) for s in (1.0, -1.0))
            expected = float(f(direction[:2], direction[2:], p))
            # step^2/6 of a third derivative, itself of the order of the slope
            assert (ahead - behind) / 2e-4 == pytest.approx(expected, rel=1e-7)
