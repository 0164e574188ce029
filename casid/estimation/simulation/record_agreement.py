"""Whether records that share parameters agree on them, without a fit of each.

At the joint minimum record e has a gradient g_e and a matrix H_e of its own; a Gauss-Newton step

    d_e = -H_e^-1 g_e                                                                         (1)

from there is its own estimate, to first order, with the robust covariance P_e of its own scores
there.
Were a parameter the same in all records, its d_e would differ by these errors alone:
sum_e (d_e - d)^2 / P_e about their weighted mean d is chi^2 with a degree of freedom less than
records (Cochran, Biometrics 10 (1954) 101-129).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from casid.arrays import scaled_inverse
from casid.estimation.covariance import sandwich
from casid.estimation.local_rank import local_rank
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import Whitener
from casid.estimation.simulation.thresholds import RECORD_AGREEMENT


def disagreements(fit: Fit, whiten: Whitener | None = None) -> list[str]:
    """A sentence for each shared parameter on which the records disagree, the worst first.

    Parameters that a record does not determine by itself are left out there.

    Parameters
    ----------
    whiten : by the spectrum that the noise has. A residual that it makes slow has a correlation
        time too long for robust errors; None: as the fit is whitened.
    """
    if whiten is not None:
        fit = replace(fit, criterion=fit.criterion.whitened(whiten))
    c = fit.criterion
    shared = [i for i, v in enumerate(c.variables) if v.name in c.free and v.name not in c.own]
    is_free = fit.solution.is_free
    shared = [i for i in shared if is_free[i]]
    if len(c.data) < 2 or c.segments > 1 or not shared:
        return []
    apart = [_own_step(fit, e) for e in range(len(c.data))]
    found = []
    for i in shared:
        rows = [(d.name, *a[i]) for d, a in zip(c.data, apart, strict=True) if i in a]
        if len(rows) < 2:
            continue
        steps, errors = (np.array([row[k] for row in rows]) for k in (1, 2))
        weights = errors**-2.0
        mean = float(np.average(steps, weights=weights))
        q, freedom = float(np.sum(weights * (steps - mean) ** 2)), len(rows) - 1
        if q > RECORD_AGREEMENT.ratio * freedom and chi2.sf(
            q, freedom
        ) < RECORD_AGREEMENT.level / len(shared):
            found.append((q / freedom, c.names[i], rows))
    found.sort(key=lambda f: -f[0])
    return [_sentence(fit, ratio, name, rows) for ratio, name, rows in found]


def _own_step(fit: Fit, e: int) -> dict[int, tuple[float, float]]:
    """(1) of one record and its standard error, by variable; those that it determines alone.

    None of a record with few samples for each of its unknowns: it follows them nearly exactly, and
    what is left of its residual says nothing of their errors.
    """
    c = fit.criterion
    residual, jacobian = c.columns(fit.x, e)
    flat = jacobian.reshape(-1, jacobian.shape[2])
    hessian = flat.T @ flat
    if not (np.all(np.isfinite(hessian)) and np.all(np.isfinite(residual))):
        return {}
    free = (np.diag(hessian) > 0) & fit.solution.is_free
    index = np.flatnonzero(free)
    counted = int(np.any(jacobian != 0, axis=2).sum())
    if counted < RECORD_AGREEMENT.samples * len(index):
        return {}
    part = hessian[np.ix_(index, index)]
    scale = np.array([v.scale for v in c.variables])
    names = [c.names[i] for i in index]
    rank = local_rank(part, fit.x[index], names, scale[index])
    undetermined = {name for direction in rank.null for name in direction}
    step = scaled_inverse(part) @ (flat[:, index].T @ residual.ravel())
    # The residual at the record's own estimate: what the joint one misses is no noise of it.
    left = residual - jacobian[:, :, index] @ step
    covariance, _ = sandwich(hessian, np.einsum("ki,kin->kn", left, jacobian), free)
    found = {}
    for i, s in zip(index.tolist(), step.tolist(), strict=True):
        sd = float(np.sqrt(max(covariance[i, i], 0.0)))
        if c.names[i] not in undetermined and sd > 0:
            found[i] = (s, sd)
    return found


def _sentence(fit: Fit, ratio: float, name: str, rows: list[tuple[str, float, float]]) -> str:
    model = fit.criterion.model
    value, unit = fit.values[name], model.unit_of(name)
    shown = ", ".join(
        f"{model.shown(name, value + step):.4g} in {record}" for record, step, _ in rows[:4]
    )
    more = f" and {len(rows) - 4} more" if len(rows) > 4 else ""
    return (
        f"the records disagree on {name} by more than their errors (chi^2 is {ratio:.2g} times its "
        f"degrees of freedom): about {shown}{more} [{unit}]; its interval is too narrow. Estimate "
        "the records apart, or look for what differs between them (casid diagnose)"
    )
