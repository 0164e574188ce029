"""What follows from a held command acts after the sample at which it was given, not before.

A controller makes the command of a sample of what was measured there, noise included. Joined by
straight lines, the command would act half a sample early, and go with that noise.
"""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.residual.candidate_functions import regressions
from casid.diagnosis.evidence.residual.residual_tests import NOISE, residual_tests
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.estimation.simulation.fit import fit_model

TS, INERTIA, DAMPING, NOISE_SD = 0.01, 160.0, 12.0, 4e-3


def drive() -> casid.Model:
    """J dw/dt = K u - b w."""
    m = casid.Model("drive")
    w, u = m.state("w", "rad/s"), m.input("u", "N m", hold="zoh", known=True)
    b = m.parameter("b", "N m s/rad", start=10.0, lower=0.0, upper=500.0)
    K = m.parameter("K", "1", start=1.1, lower=0.1, upper=10.0)
    m.balance(w, "torque", inertia=m.constant("J", INERTIA, "kg m^2"), terms=[K * u, -b * w])
    m.output("speed", w, "rad/s")
    return m


def controlled(seed: int, N: int = 3000) -> casid.Record:
    """The speed follows steps of a reference; exact over each sample."""
    rng = np.random.default_rng(seed)
    goal = np.repeat(rng.uniform(-0.03, 0.03, N // 250), 250)
    decay = np.exp(-DAMPING / INERTIA * TS)
    w, total, rows = 0.0, 0.0, []
    for reference in goal:
        y = w + NOISE_SD * rng.standard_normal()
        total += TS * 2000.0 * (reference - y)
        u = 6000.0 * (reference - y) + total
        rows.append((u, y))
        w = u / DAMPING + (w - u / DAMPING) * decay
    u, y = np.array(rows).T
    return casid.Record({"u": u, "speed": y}, {"u": "N m", "speed": "rad/s"}, Ts=TS)


def fitted(seed: int) -> tuple[Weighted, list[casid.Experiment]]:
    made, model = [casid.Experiment(controlled(seed))], drive()
    fit = fit_model(model, made, casid.FitSettings(starts=1))
    return Weighing(made).weigh(model, fit), made


def test_a_force_like_the_command_does_what_more_of_the_command_does():
    at, made = fitted(1)
    ((named, found),) = [(n, r) for place, n, r in regressions(at, made) if place == "torque"]
    like_command = found.psi[:, named.index("u")]
    of_gain = found.tangent[:, at.criterion.names.index("K")]
    assert like_command == pytest.approx(of_gain, rel=1e-9, abs=1e-9 * np.abs(of_gain).max())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_that_a_controller_feeds_back_is_no_force_of_its_command(seed: int):
    at, made = fitted(seed)
    found = residual_tests(at, made)
    assert found.verdict == NOISE
    assert found.p_dependence > 0.05
