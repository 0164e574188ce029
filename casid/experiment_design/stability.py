"""Whether an open-loop input can keep a system within its limits.

Near an unstable equilibrium what the input cannot correct (the last digit of the initial state, a
draught) grows by exp(lambda t), and what is recorded is not what a design predicts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import exp, inf, log

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import ModelError, SolveError
from casid.experiment_design.designed_experiment import time_text
from casid.experiment_design.hypotheses import Hypothesis
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.setup import Setup
from casid.experiment_design.thresholds import STABILITY

Motion = tuple[Array, Array]
"""Designed inputs (N, nu) and displacements (nr,)."""


def require_holdable(setup: Setup, base: Hypothesis, usual: Callable[[], Sequence[Motion]]) -> None:
    """Refuse a system in which small deviations grow too much, whatever is done within the limits.

    `usual` gives some inputs that keep the limits; it is called where deviations grow at rest.

    Raises
    ------
    ModelError
        If deviations grow under every one of them.
    """
    rate = rate_at_start(setup, base)
    if not _is_lost(rate, setup):
        return
    prediction = Prediction(setup, [base], [])
    if any(not _is_lost(growth_rate(prediction, *motion), setup) for motion in _kept(usual)):
        return  # it leaves the equilibrium, and stays bounded: a limit cycle
    grown = rate * setup.duration
    times = f"{exp(grown):.2g}" if grown < log(STABILITY.shown) else "over a million"
    raise ModelError(
        f"{setup.nominal.name} is unstable where the experiment starts: a small deviation grows by "
        f"a factor of e every {time_text(1 / rate)}, {times} times in a record of "
        f"{time_text(setup.duration)}, and no input that is planned in advance keeps it within the "
        "limits. State its controller in the model, so that what the controller commands is a "
        "function of the states and the reference is the input, and give the limit of the "
        f"reference; or record for {time_text(log(STABILITY.growth) / rate)} at most"
    )


def _is_lost(rate: float, setup: Setup) -> bool:
    """True if deviations grow by more than a plan can bear within the record."""
    return rate * setup.duration > log(STABILITY.growth)


def _kept(usual: Callable[[], Sequence[Motion]]) -> Sequence[Motion]:
    try:
        return usual()
    except SolveError:  # no input keeps the limits
        return ()


def rate_at_start(setup: Setup, base: Hypothesis) -> float:
    """Largest real part [1/s] of the eigenvalues of the model linearised at start and rest."""
    u, release = setup.begun_at
    e = base.acting.explicit()
    slope = ca.Function("slope", [e.x, e.u, e.p], [ca.jacobian(e.f, e.x)])
    column = setup.columns(base.acting, u[:1], setup.Ts)[0]
    found = np.array(slope(setup.initial(base.acting, release), column, base.vector))
    if not found.size or not np.all(np.isfinite(found)):
        return 0.0
    return float(np.max(np.linalg.eigvals(found).real))


def growth_rate(prediction: Prediction, u: Array, release: Array) -> float:
    """Rate [1/s] at which outputs' sensitivities to the initial state grow; inf: they diverge.

    Taken between the largest of the first half of the record and the largest of the second one.
    """
    setup, h = prediction.setup, prediction.hypotheses[0]
    simulator = prediction.simulator(0, setup.Ts, acting=True)
    x0 = setup.initial(h.model, release)
    with np.errstate(all="ignore"):
        run = simulator.sensitivities(setup.columns(h.acting, u, setup.Ts), h.vector, x0)
    assert run.dy is not None
    if not np.all(np.isfinite(run.dy)):
        return inf
    sizes = np.abs(run.dy).reshape(len(run.dy), -1)
    half = len(sizes) // 2
    first, second = sizes[:half].max(axis=0), sizes[half:].max(axis=0)
    grown = float(np.max(second[first > 0] / first[first > 0], initial=1.0))
    return log(grown) / (0.5 * setup.duration)
