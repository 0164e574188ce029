"""Steps of held inputs that came between two rows, at instants that the record does not have.

A dose that begins between two rows is recorded from the later one on. If it came the share a_k of
an interval before that row, the outputs moved as if the sample before it had been higher by a_k of
the step:

    r = J dtheta + sum_k a_k s_k + e                                                           (1)

with r the residual, J its sensitivities, and s_k what the outputs do where step k comes one whole
interval before its row. A delay, a dead time or another hold has one a_k for all steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.recording_faults.steps_in_gaps import is_busy
from casid.diagnosis.thresholds import STEPS_BETWEEN_ROWS
from casid.estimation.simulation.known_simulation import outputs_by
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import Signals


@dataclass(frozen=True, slots=True, eq=False)
class StepsBetweenRows:
    """Steps of one input that came before their rows, each at an instant of its own.

    Attributes
    ----------
    shares : (K,) of an interval by which each step came before its row.
    explained : share of the sum of squares of the residual.
    """

    channel: str
    shares: Array
    explained: float

    @property
    def note(self) -> str:
        """A note on the steps between the rows, and on how to record them."""
        low, high = np.quantile(np.clip(self.shares, 0.0, 1.0), [0.05, 0.95])
        return (
            f"the steps of {self.channel} came between its rows, {low:.2f} to {high:.2f} of an "
            f"interval before those that show them, each at an instant of its own: this explains "
            f"{100 * self.explained:.0f} % of the misfit, and causes named here may stand for it. "
            "Record the instants, as rows of their own (a clock may be uneven), or take rows more "
            f"often; else give {self.channel} as what flowed in each interval, its mean"
        )


def steps_between_rows(fit: Fit, alpha: float) -> StepsBetweenRows | None:
    """The held input whose steps explain most of the residual by (1), None where none does.

    Its shares of an interval differ between steps by more than their errors, at level `alpha`, and
    lie from 0 to 1 within them. A model that prepares its input columns is left alone.
    """
    model = fit.criterion.model
    if any(stage.is_of_input for stage in model.stages):
        return None
    found = [_of_input(fit, i, name, alpha) for i, name in enumerate(model.inputs)]
    return max((f for f in found if f is not None), key=lambda f: f.explained, default=None)


def _of_input(fit: Fit, i: int, name: str, alpha: float) -> StepsBetweenRows | None:
    criterion = fit.criterion
    if criterion.model.acting_hold(name) != "zoh" or criterion.model.inputs[name].signal:
        return None
    residuals, tangents, signatures = [], [], []
    for e, d in enumerate(criterion.data):
        at = criterion.simulated(fit.x, e)
        if not np.all(np.isfinite(at.residual)) or not np.all(np.isfinite(at.jacobian)):
            return None
        rows = _steps_of(d, i, name)
        used = d.used
        residuals.append((at.residual * criterion.weights)[used])
        tangents.append((at.jacobian * criterion.weights[:, None])[used])
        signatures.append([(s * criterion.weights)[used] for s in _signatures(fit, e, d, i, rows)])
    count = sum(map(len, signatures))
    if count < STEPS_BETWEEN_ROWS.fewest:
        return None
    r, tangent = np.concatenate(residuals), np.concatenate(tangents)
    steps, place, n = np.zeros((len(r), count)), 0, 0
    for part, of_part in zip(residuals, signatures, strict=True):
        for s in of_part:
            steps[n : n + len(part), place] = s
            place += 1
        n += len(part)
    return _judged(name, r, tangent, steps, alpha)


def _judged(
    name: str, r: Array, tangent: Array, steps: Array, alpha: float
) -> StepsBetweenRows | None:
    """Whether steps (M, K) explain a residual (M,) beside the parameters' tangents (M, n)."""
    basis, _ = np.linalg.qr(tangent / np.maximum(np.linalg.norm(tangent, axis=0), TINY))
    r, steps = (x - basis @ (basis.T @ x) for x in (r, steps))
    seen = np.linalg.norm(steps, axis=0)
    steps = steps[:, seen > STEPS_BETWEEN_ROWS.seen * seen.max(initial=0.0)]
    free = len(r) - steps.shape[1] - tangent.shape[1]
    if steps.shape[1] < STEPS_BETWEEN_ROWS.fewest or free < steps.shape[1]:
        return None
    shares, *_ = np.linalg.lstsq(steps, r, rcond=None)
    left = float(np.sum((r - steps @ shares) ** 2))
    explained = 1.0 - left / max(float(r @ r), TINY)
    if explained < STEPS_BETWEEN_ROWS.explained:
        return None
    covariance = np.linalg.pinv(steps.T @ steps) * left / free
    errors = np.sqrt(np.maximum(np.diag(covariance), TINY))
    mean = float(np.sum(shares / errors**2) / np.sum(errors**-2.0))
    spread = float(np.sum(((shares - mean) / errors) ** 2))
    margin = STEPS_BETWEEN_ROWS.errors * errors
    inside = (shares > -margin) & (shares < 1.0 + margin)
    if chi2.sf(spread, len(shares) - 1) >= alpha or inside.mean() < STEPS_BETWEEN_ROWS.inside:
        return None
    return StepsBetweenRows(name, shares, explained)


def _steps_of(d: Signals, i: int, name: str) -> Array:
    """Rows from which on an input has another level; none of one that changes at most samples."""
    gone = d.filled.get(name, np.zeros(len(d.u), dtype=bool))
    if d.instants is not None or is_busy(d.u[:, i], gone):
        return np.zeros(0, dtype=int)
    changed = (np.diff(d.u[:, i]) != 0.0) & ~(gone[1:] | gone[:-1])
    return np.flatnonzero(changed) + 1


def _signatures(fit: Fit, e: int, d: Signals, i: int, rows: Array) -> list[Array]:
    """Change of the outputs (N, ny) if a step comes one interval before its row, for each step."""
    outputs, x = outputs_by(fit, d, e), fit.criterion.simulated(fit.x, e).x
    out = []
    for k in rows.tolist():
        end = min(k + STEPS_BETWEEN_ROWS.samples, d.N)
        part = d.u[k - 1 : end].copy()
        base = outputs(part, x[k - 1])
        part[0, i] = part[1, i]
        change = outputs(part, x[k - 1]) - base
        change[0] = 0.0  # of the row before, which had its own level
        whole = np.zeros(d.y.shape)
        whole[k - 1 : end] = np.where(np.isfinite(change), change, 0.0)
        out.append(whole)
    return out
