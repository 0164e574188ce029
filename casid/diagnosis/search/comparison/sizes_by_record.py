"""Several records: does one size of a cause explain them all?

Each cause's parameters are estimated for every record on its own, all else in common. Were they one
and the same, their differences d from the first record's would be normal about zero, so that

    W = d' V^-1 d                                                                             (1)

is chi^2 with a degree of freedom for each (Wald), V robust to autocorrelation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.thresholds import ROUNDS
from casid.estimation.covariance import sandwich
from casid.estimation.estimate import Estimated
from casid.estimation.holdout import Split, held_out_error, why_worse
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit


@dataclass(frozen=True, slots=True, eq=False)
class SizesByRecord:
    """A cause whose size differs between records."""

    key: tuple[str, str]
    p_value: float  # of one size for all
    by_record: Mapping[str, Mapping[str, Estimated]]  # record -> parameter -> value


def with_sizes_by_record(
    weighing: Weighing,
    adopted: Sequence[Adopted],
    fit: Fit,
    at: Weighted,
    split: Split,
    settings: FitSettings,
) -> tuple[tuple[SizesByRecord, ...], Fit, Weighted]:
    """Causes that no one size explains, the fit with sizes of their own, and its noise.

    Causes are tested together, and those that one size does explain keep it. A clipping or the
    frequency of a line is not tested: neither is a size. Sizes of their own that fit worse than one
    size, or predict what was held out worse, are no finding.
    """
    tested = {
        a.candidate.effect.key: a.candidate.names[:1]
        for a in adopted
        if a.candidate.effect.test == "score"
    }
    own = [n for names in tested.values() for n in names if n in fit.criterion.model.parameters]
    if not own:
        return (), fit, at
    once = replace(settings, starts=1)
    apart = _fit(fit, own, weighing, once)
    different = {key: _wald(apart, names[0]) for key, names in tested.items()}
    level = ROUNDS.record_alpha / max(len(different), 1)
    kept = {key: p for key, (p, _) in different.items() if p < level}
    if not kept:
        return (), fit, at
    own = [tested[key][0] for key in kept]
    apart = _fit(fit, own, weighing, once)
    is_worse = not apart.solution.value <= fit.solution.value
    if is_worse or why_worse(held_out_error(fit, split), held_out_error(apart, split)):
        return (), fit, at
    specific = tuple(
        SizesByRecord(key, max(p, TINY), _values(apart, tested[key][0])) for key, p in kept.items()
    )
    return specific, apart, weighing.weigh(apart.criterion.model, apart, rounds=1)


def _fit(fit: Fit, own: Sequence[str], weighing: Weighing, settings: FitSettings) -> Fit:
    c = fit.criterion
    start = dict(fit.values)
    for name in own:
        start |= {f"{name}@{d.name}": fit.values[name] for d in c.data if name in fit.values}
    both = tuple(dict.fromkeys([*c.own, *own]))
    return fit_model(
        c.model,
        weighing.experiments,
        replace(settings, own=both, substeps=c.substeps),
        start=start,
        weights=c.weights,
        check_rank=False,
        throw=False,
    )


def _estimates(fit: Fit, name: str) -> tuple[list[str], Array, Array]:
    """Records, values (R,) and their joint covariance (R, R).

    A record in which nothing moves by the parameter does not determine it, and is left out.
    """
    c = fit.criterion
    rows = [
        (d.name, c.names.index(f"{name}@{d.name}")) for d in c.data if f"{name}@{d.name}" in c.names
    ]
    free = np.ones(len(fit.x), dtype=bool)
    covariance, _ = sandwich(fit.solution.hessian, c.scores(fit.x), free)
    rows = [(record, i) for record, i in rows if covariance[i, i] > 0.0]
    index = [i for _, i in rows]
    return [r for r, _ in rows], fit.x[index], covariance[np.ix_(index, index)]


def _wald(fit: Fit, name: str) -> tuple[float, int]:
    """p of (1), and its degrees of freedom."""
    records, values, covariance = _estimates(fit, name)
    n = len(records) - 1
    if n < 1:
        return 1.0, 0
    contrast = np.hstack([-np.ones((n, 1)), np.eye(n)])
    d = contrast @ values
    w = float(d @ np.linalg.pinv(contrast @ covariance @ contrast.T) @ d)
    return float(chi2.sf(w, n)), n


def _values(fit: Fit, name: str) -> dict[str, dict[str, Estimated]]:
    records, values, covariance = _estimates(fit, name)
    unit = fit.criterion.model.parameters[name].unit
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return {
        record: {name: Estimated(name, float(v), unit, std_error=float(s))}
        for record, v, s in zip(records, values, sd, strict=True)
    }
