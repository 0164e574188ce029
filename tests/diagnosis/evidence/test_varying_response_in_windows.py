"""A force on an unstable plant whose response varies is noise, in windows as in whole records."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.records.unstable_records import records_in_windows
from casid.diagnosis.evidence.residual.residual_tests import NOISE, residual_tests
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.comparison.simulation_errors import simulation_errors
from casid.estimation.fit_statistics import rms
from casid.estimation.holdout import Split, split_records
from casid.estimation.noise.varying_steps import steps_along
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.simulation_error import SimulationError

TS, N = 0.01, 2400
J, MGL, D = 0.05, 2.0, 0.02  # kg m^2, N m, N m s/rad
FORCE = 0.02  # N m, white, held over each sample
NOISE_SD = 2e-4  # rad


def leaning() -> casid.Record:
    """A pendulum that its controller leans far to either side of upright.

    J w' = m g l sin(th) - d w + u + what nobody recorded, by Runge-Kutta in steps of 1.25 ms. Its
    weight drives it away where it stands upright, and hardly moves with it where it lies.
    """
    rng = np.random.default_rng(5)
    t = TS * np.arange(N)
    wanted = 1.3 * np.sin(0.9 * t) + 0.2 * np.repeat(rng.uniform(-1, 1, N // 60), 60)
    x, before, rows = np.zeros(2), 0.0, []

    def slope(x: np.ndarray, torque: float) -> np.ndarray:
        return np.array([x[1], (MGL * np.sin(x[0]) - D * x[1] + torque) / J])

    for goal in wanted:
        th = x[0] + NOISE_SD * rng.standard_normal()
        u = -8.0 * (th - goal) - 0.5 * (th - before) / TS - MGL * np.sin(goal)
        before = th
        rows.append((u, th))
        force = FORCE * rng.standard_normal()
        for _ in range(8):
            h = TS / 8
            one = slope(x, u + force)
            two = slope(x + h / 2 * one, u + force)
            three = slope(x + h / 2 * two, u + force)
            x = x + h / 6 * (one + 2 * two + 2 * three + slope(x + h * three, u + force))
    columns = dict(zip(("u", "phi"), np.array(rows).T, strict=True))
    return casid.Record(columns, {"u": "N m", "phi": "rad"}, Ts=TS, name="leaning")


def model() -> casid.Model:
    m = casid.Model("leaning pendulum")
    th, w = m.state("th", "rad"), m.state("w", "rad/s")
    u = m.input("u", "N m", hold="zoh", known=True)
    inertia = m.parameter("J", "kg m^2", start=0.045, lower=1e-3, upper=1.0)
    weight = m.parameter("mgl", "N m", start=1.8, lower=0.0, upper=20.0)
    d = m.parameter("d", "N m s/rad", start=0.01, lower=0.0)
    m.derivative(th, w)
    m.balance(w, "torque", inertia=inertia, terms=[weight * ca.sin(th), -d * w, u])
    m.output("phi", th, "rad")
    return m


@lru_cache(maxsize=1)
def under_disturbance() -> tuple[Weighted, Split]:
    whole = split_records([casid.Experiment(leaning())], 0.3)
    settings = FitSettings(starts=1)
    windows = records_in_windows(model(), whole, settings, lambda _: None)
    fit = fit_model(model(), windows.split.fitted, settings, start=windows.start)
    weighing = Weighing(windows.split.fitted).with_disturbances()
    return weighing.weigh(fit.criterion.model, fit), windows.split


def test_what_a_force_moves_ends_with_its_window():
    """Every window begins in a state of its own, whatever was before it."""
    c = SimulationError(model(), [casid.Experiment(leaning(), window=600)])
    steps, column = steps_along(c, c.start, 0), 0
    before = c.starts_anew(0) - 1
    assert before.tolist() == [599, 1199, 1799]
    moved, x = np.zeros((N, 1)), np.zeros(2)
    for k in range(N):
        moved[k] = steps.c[k] @ x
        x = steps.a[k] @ x + (k == 500) * steps.b0[k, :, column]
    assert np.all(moved[501:600] != 0.0)
    assert not moved[600:].any()


def test_the_residual_in_windows_is_white_under_a_response_that_varies():
    """The force and the sensor have the noise that they were given; by a spectrum they have others.

    Over a window what the force moves grows 150-fold, and m g l cos(th) is from 2 N m to nearly
    nothing. Ten in a hundred are three standard errors of the force, and its course in a sample.
    """
    at, split = under_disturbance()
    assert at.criterion.is_cut(0)
    assert at.noise.varying
    assert at.noise.source_sd["torque"] == pytest.approx(FORCE, rel=0.1)
    assert at.noise.output_sd[0] == pytest.approx(NOISE_SD, rel=0.1)
    assert residual_tests(at, split.fitted, alpha=0.01).verdict == NOISE
    found = (at.unbiased or at.fit).values
    for name, true in (("J", J), ("mgl", MGL)):
        assert found[name] == pytest.approx(true, rel=0.03)


def test_windows_held_out_are_predicted_as_well_as_those_that_were_fitted():
    """Innovations of unit size in both: their mean square over n has a deviation of sqrt(2 / n).

    Four of these; a state by least squares alone leaves errors many times as large as the noise
    where every window begins.
    """
    at, split = under_disturbance()
    found = simulation_errors(at.fit, split, at.criterion.weights, at.noise)
    for part in (found.fitted, found.continued):
        assert rms(part)[0] ** 2 == pytest.approx(1.0, abs=4 * np.sqrt(2 / len(part)))
