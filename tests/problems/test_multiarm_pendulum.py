"""A free swing: its equation, what it can tell, its simulator, and the measured records."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.special import ellipk

import casid
from casid.errors import IdentifiabilityError
from casid.model.dimensions import check_units
from casid.model.effects.balances.balance_effects import coulomb_friction, quadratic_damping
from problems import multiarm_pendulum as swing
from tests.support.shared import ROOT, shared

FOLDER = "data/multiarm_single_pendulum"
ONCE = casid.FitSettings(starts=1)

PUBLISHED = {
    "a1_m": 0.147754901,
    "m1_kg": 0.147584572,
    "I1_kgm2": 0.000109118505,
    "k1": 0.000223940125,
    "g": 9.8100131,
}
"""EstimatedParameters_SinglePendulum.mat of Kaheman et al. (2022, arXiv 2205.06231)."""

COMBINED = {"w_2": 64.219, "d": 0.06723}
"""The two combinations of them, as the sidecar has them."""


def test_the_problem_file_loads_by_path_and_its_units_agree():
    check_units(casid.load_problem(ROOT / "problems" / "multiarm_pendulum.py").model)


def test_the_balance_is_the_equation_and_hanging_is_its_stable_rest():
    e = swing.swing_model().explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    p = [{"w_2": 2.0, "d": 3.0}[n] for n in e.parameters]
    np.testing.assert_allclose(
        np.array(f([0.4, 0.5], [], p)).ravel(), [0.5, 2 * math.sin(0.4) - 3 * 0.5]
    )
    stiffness = ca.Function("k", [e.x, e.u, e.p], [ca.jacobian(e.f[1], e.x[0])])
    assert float(stiffness([math.pi, 0.0], [], p)) == pytest.approx(-2.0)


def test_published_parameters_combine_to_the_two_that_a_swing_tells():
    a, m, inertia, k, g = PUBLISHED.values()
    total = m * a**2 + inertia
    assert a * m * g / total == pytest.approx(COMBINED["w_2"], rel=1e-4)
    assert k / total == pytest.approx(COMBINED["d"], rel=1e-3)


def test_a_swing_does_not_tell_mass_length_inertia_and_friction_apart():
    """theta'' = (a m g sin(theta) - k theta') / (m a^2 + I): four unknowns, two combinations."""
    m = casid.Model("single arm")
    theta, rate = m.state("theta", "rad", start=math.pi), m.state("rate", "rad/s")
    a = m.parameter("a_1", "m", start=0.15, lower=0.01, upper=1.0)
    mass = m.parameter("m_1", "kg", start=0.15, lower=0.01, upper=1.0)
    inertia = m.parameter("I_1", "kg m^2", start=1e-4, lower=1e-6, upper=1.0)
    k = m.parameter("k_1", "N m s/rad", start=2e-4, lower=0.0, upper=1.0)
    g = m.constant("g", 9.81, "m/s^2")
    m.derivative(theta, rate)
    terms = [a * mass * g * ca.sin(theta), -k * rate]
    m.balance(rate, "torque", inertia=mass * a**2 + inertia, terms=terms)
    m.output("theta", theta, "rad")
    with pytest.raises(IdentifiabilityError, match="m_1"):
        casid.identify(m, swing.simulate(duration=5.0, d_2=0.0))


def test_without_damping_the_period_is_the_elliptic_integral():
    """T = 4 K(sin^2(alpha / 2)) / sqrt(w_2) at the amplitude alpha (Runge-Kutta: h = 2.5 ms)."""
    alpha = 1.2
    record = swing.simulate(theta_start=math.pi + alpha, d=0.0, d_2=0.0, noise=0.0)
    phi = record["theta"] - math.pi
    i = np.flatnonzero((phi[:-1] < 0) & (phi[1:] >= 0))
    crossings = record.Ts * (i - phi[i] / (phi[i + 1] - phi[i]))
    wanted = 4 * ellipk(math.sin(alpha / 2) ** 2) / math.sqrt(64.1)
    assert np.mean(np.diff(crossings)) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.slow
def test_noise_free_records_return_the_coefficients():
    record = swing.simulate(duration=10.0, d_2=0.0, noise=0.0)
    settings = casid.FitSettings(starts=1, substeps=4)  # as the simulator
    fit = casid.identify(swing.problem, record, settings=settings)
    assert fit["w_2"] == pytest.approx(64.1, rel=1e-6)
    assert fit["d"] == pytest.approx(0.05, rel=1e-4)


def test_drag_and_dry_friction_of_the_simulator_are_those_of_the_effects():
    """With d known, as over a few swings three kinds of damping hardly differ: else F_c is 4 % off.

    The simulator sees the rate change its sign up to a step late, h = 2.5 ms of half a swing of
    0.4 s: 0.6 %. Four Runge-Kutta steps a sample, as it has: across the jump of dry friction
    halving them never ceases to matter.
    """
    record = swing.simulate(duration=8.0, d=0.01, d_2=0.005, F_c=0.15, noise=0.0)
    m = swing.swing_model()
    m = m.extend(quadratic_damping(m, "torque"))
    m = m.extend(coulomb_friction(m, "torque", 0.1)).with_known(d=0.01)
    settings = casid.FitSettings(starts=1, substeps=4)
    fit = casid.identify(m, record, settings=settings, start={"d_2": 0.004, "F_c": 0.1})
    assert fit["d_2"] == pytest.approx(0.005, rel=0.006)
    assert fit["F_c"] == pytest.approx(0.15, rel=0.006)


def test_drawn_records_have_no_bias():
    """Mean of standardised errors over n draws within 4 / sqrt(n) for each coefficient."""
    n, errors = 8, []
    for seed in range(n):
        record = swing.simulate(duration=8.0, d_2=0.0, seed=seed)
        settings = casid.FitSettings(starts=1, substeps=4)
        fit = casid.identify(swing.problem, record, settings=settings)
        truth = swing.problem.truth
        errors.append([(fit[k] - v) / fit.parameter(k).std_error for k, v in truth.items()])
    assert np.all(np.abs(np.mean(errors, axis=0)) < 4 / np.sqrt(n))


# -- the measured records --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured():
    folder = shared(FOLDER)
    return [swing.problem.read(folder / f"est_{i}.csv") for i in (1, 2, 3)]


def slow(experiments):
    return [swing.problem.experiment(e.record.decimate(10)) for e in experiments]


def damped(*, drag, dry):
    m = swing.swing_model()
    if drag:
        m = m.extend(quadratic_damping(m, "torque"))
    if dry:
        m = m.extend(coulomb_friction(m, "torque", 0.2))
    return replace(swing.problem, model=m, simulate=None, truth={})


def test_the_table_is_that_of_the_sidecar():
    path = shared(f"{FOLDER}/multiarm_single_pendulum.json")
    sidecar = json.loads(path.read_text(encoding="utf-8"))
    for name, value in PUBLISHED.items():
        assert sidecar["published"][name] == value


def test_the_first_fit_with_viscous_damping_is_reproduced(measured):
    """est_1 at 1 kHz: 2.01 mrad rms, d = 0.0572 1/s, w_2 within 64.06 to 64.15 1/s^2."""
    fit = casid.identify(swing.problem, measured[0], settings=ONCE)
    assert fit.rmse["est_1"]["theta"] == pytest.approx(0.00201, rel=0.01)
    assert fit["d"] == pytest.approx(0.0572, abs=5e-4)
    assert 64.06 < fit["w_2"] < 64.15
    assert fit["w_2"] == pytest.approx(COMBINED["w_2"], rel=0.003)


def test_drag_takes_the_error_of_the_first_record_down_as_far_as_the_first_fits(measured):
    """1.21 mrad with viscous and quadratic damping; a tenth of the samples tells the same."""
    fit = casid.identify(damped(drag=True, dry=False), slow(measured[:1]), settings=ONCE)
    assert fit.rmse["est_1"]["theta"] == pytest.approx(0.00121, rel=0.02)


@pytest.mark.slow
def test_three_amplitudes_together_want_dry_friction_beside_drag(measured):
    """One set of parameters for 1.6, 1.2 and 0.9 rad: viscous damping is left with nothing.

    Each of drag and dry friction alone leaves d above 0.04 1/s; both together need none of it.
    """
    total = {}
    for drag, dry in ((False, False), (True, False), (True, True)):
        start = {"d": 0.01, "d_2": 0.004, "F_c": 0.15} if dry else None
        settings = casid.FitSettings(starts=1, substeps=2)
        problem = damped(drag=drag, dry=dry)
        fit = casid.identify(problem, slow(measured), settings=settings, start=start)
        total[drag, dry] = np.sqrt(np.mean([r["theta"] ** 2 for r in fit.rmse.values()]))
        assert (fit["d"] < 0.01) == dry
    assert total[True, False] < 0.6 * total[False, False]
    assert total[True, True] < 0.75 * total[True, False]


def test_the_pieces_of_the_swing_follow_one_another():
    """The clock runs on from one file to the next: a change in time may be one event."""
    read = [swing.problem.read(shared(FOLDER) / f"est_{i}.csv").record for i in (1, 2, 3)]
    for before, after in itertools.pairwise(read):
        assert after.t0 == pytest.approx(before.t0 + before.N * before.Ts, abs=0.5 * before.Ts)
