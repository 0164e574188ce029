"""Whether an input follows what disturbs the system, as in a closed loop."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from scipy.stats import norm

from casid.arrays import TINY, Array
from casid.estimation.covariance import whiteness
from casid.estimation.feedback import inputs_without_feedthrough
from casid.estimation.noise.residual_autoregressions import autoregression
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.thresholds import INPUT_ANSWERS


def feedback_notes(fit: Fit, noisy: Collection[str] = ()) -> list[str]:
    """Warnings of inputs that follow a residual that is not white.

    Least squares of the simulation error take the input as given. A disturbance that comes back
    through it, by a controller or because a sensor that is used as input responds to it, is no
    noise beside the input: its effect is ascribed to the model (Ljung 1999, sections 13.4, 16.6).

    Parameters
    ----------
    noisy : inputs that are left out, since their noise counts. A residual that is made of it goes
        with what the input is next, too: nobody measured what the past of the input was.
    """
    criterion, model = fit.criterion, fit.criterion.model
    recorded = [
        n
        for n, entry in model.inputs.items()
        if entry.kind in {"measured", "known"} and n not in noisy
    ]
    out = []
    for i, output in enumerate(criterion.outputs):
        late = {
            n for n in inputs_without_feedthrough(model, output) if model.inputs[n].hold == "zoh"
        }
        for name in recorded:
            column = list(model.inputs).index(name)
            pairs = []
            for e, d in enumerate(criterion.data):
                residual = criterion.simulated(fit.x, e).residual[:, i]
                if d.used[:, i].all() and np.ptp(d.u[:, column]) > 0.0:
                    pairs.append((residual, d.u[:, column]))
            if not pairs or max(whiteness(r) for r, _ in pairs) <= INPUT_ANSWERS.coloured:
                continue
            if follows(pairs, first=0 if name in late else 1):
                out.append(
                    f"input {name} follows the residual of {output}, which is autocorrelated: in a "
                    "closed loop, or where an input has noise or responds to what disturbs the "
                    "system, that biases this estimate, and the error bars do not contain it. "
                    "Estimate the disturbance with it (--disturbance PLACE:first), or use "
                    "instruments (--method instruments --reference CHANNEL)"
                )
    return out


def follows(pairs: list[tuple[Array, Array]], *, first: int = 1) -> bool:
    """Whether a signal follows another: its innovations go with the other's earlier ones.

    Of independent signals the correlation of innovations at a lag has the variance 1 / N (Box,
    Jenkins and Reinsel 2008, section 12.1.3); the largest of some lags is compared with it.

    Parameters
    ----------
    pairs : one and the other (N,) of each record.
    first : lag that counts first; 0 where the same sample of the first cannot show the second.
    """
    lags = np.arange(first, INPUT_ANSWERS.lags + 1)
    one, other = (_innovations([p[k] for p in pairs]) for k in (0, 1))
    total = sum(len(e) for e in one)
    power = sum(float(e @ e) for e in one) * sum(float(v @ v) for v in other)
    if total <= INPUT_ANSWERS.lags**2 or power <= TINY:
        return False
    products = [
        sum(float(e[: len(e) - lag] @ v[lag:]) for e, v in zip(one, other, strict=True))
        for lag in lags.tolist()
    ]
    z = np.abs(products) * np.sqrt(total / power)
    return bool(z.max() > norm.isf(0.5 * INPUT_ANSWERS.level / len(lags)))


def _innovations(signals: list[Array]) -> list[Array]:
    """What the past of signals (N,) does not predict, by one autoregression of all.

    Steps, as of a reference, count no more than some standard deviations of the rest, whose past is
    taken out of them once more: between its steps a level shows in every sample.
    """
    white = _whitened(signals)
    size = INPUT_ANSWERS.steps * float(np.median(np.abs(np.concatenate(white)))) / norm.isf(0.25)
    return _whitened([np.clip(e, -size, size) for e in white]) if size > 0.0 else white


def _whitened(signals: list[Array]) -> list[Array]:
    centred = [s - s.mean() for s in signals]
    model = autoregression(centred)
    return [model.whiten(s[:, None])[:, 0] for s in centred]
