"""The `Estimate` of all stages: values, uncertainty, tests and warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.estimate import (
    Estimate,
    Estimated,
    Identifiability,
    Origin,
    SolverEvidence,
    Uncertainty,
)
from casid.estimation.estimate_builder import EstimateBuilder, bound_of
from casid.estimation.fitted.from_fit import unsimulated_model
from casid.estimation.local_rank import LocalRank, describe_null, local_rank
from casid.estimation.moments.equations.moment_covariance import Covariance
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.prior import Prior
from casid.estimation.moments.stages.propagation import Propagated, free_slope, propagate
from casid.estimation.moments.stages.stage import StageFit
from casid.estimation.noise.noise_floor import white_floor
from casid.model.model import Model
from casid.model.quantities import p_statement
from casid.versions import versions

SOURCES = (
    "J. Linder, Indirect System Identification for Unknown Input Problems, 2017, ch. 2, 5 and 7",
    "T. Soderstrom, P. Stoica, Instrumental Variable Methods for System Identification, 1983",
    "D. N. Politis, Adaptive bandwidth choice, J. Nonparametric Statistics 15 (2003) 517-533",
    "L. P. Hansen, Econometrica 50 (1982) 1029-1054: overidentification test",
)
"""Where the methods come from."""


ASSUMES = {
    "white": "white equation errors of zero mean, independent of the instruments: a coloured "
    "error makes them too large or too small, by a factor that the sums do not determine",
    "independent": "equation errors of zero mean and finite memory, independent of the external "
    "reference; the discretisation's own bias is not in it",
    "scores": "autocorrelation-robust (Newey-West): equation errors of zero mean, not correlated "
    "with the regressors; noise on the regressors biases least squares and is not in it",
}


def moment_estimate(
    model: Model,
    fits: Sequence[StageFit],
    settings: MomentSettings,
    prior: Prior | None,
    *,
    how: Covariance | None,
    origin: tuple[str, Sequence[str]],
    structural: str = "",
) -> MomentEstimate:
    """The estimate that the fits of all stages make.

    Parameters
    ----------
    prior : known values whose uncertainty is propagated.
    how : see `moment_covariance`.
    origin : name of the problem, and the provenance of its data.
    structural : the identifiability of the parameters, in words.
    """
    names = tuple(prior.values) if prior else ()
    certain = prior.in_si(model).matrix() if prior else None
    propagated = propagate(fits, names, certain, how=how)
    estimate = _as_estimate(model, fits, propagated, settings, origin)
    if structural:
        estimate = replace(
            estimate, identifiability=replace(estimate.identifiability, structural=structural)
        )
    if not model.takes_si:
        estimate = estimate.in_units(model.declared_units)
    return MomentEstimate(model, estimate, propagated, tuple(fits), prior)


def _as_estimate(
    model: Model,
    fits: Sequence[StageFit],
    propagated: Propagated,
    settings: MomentSettings,
    origin: tuple[str, Sequence[str]],
) -> Estimate:
    name, provenance = origin
    builder = EstimateBuilder(name, model)
    errors = dict(zip(propagated.names, _std_errors(propagated.covariance), strict=True))
    ranks = [_rank(st) for st in fits]
    for st, rank in zip(fits, ranks, strict=True):
        for f, value in zip(st.free, st.theta_p.tolist(), strict=True):
            p = model.parameters[f]
            row = Estimated(f, value, p.unit, False, errors[f], p.start)
            builder.add(row, bound_of(st.solution, f))
        builder.warnings += [*_undetermined(st, rank), *st.remarks, *_mostly_noise(st)]
        builder.warn_unless_converged(st.solution)
    builder.identifiability = Identifiability(
        sum(r.rank for r in ranks),
        sum(r.unknowns for r in ranks),
        min((r.smallest for r in ranks), default=np.inf),
        "; ".join(describe_null(r) for r in ranks if not r.is_full),
    )
    if propagated.p_value < 0.01:
        builder.warnings.append(
            f"the moments contradict one another (chi2 {propagated.statistic:.3g} with "
            f"{propagated.degrees} degrees of freedom, {p_statement(propagated.p_value, '.1g')}): "
            "a known value, a load case or the model is wrong (a prefilter that lifts high "
            "frequencies lifts the discretisation's error), or the reference is not independent of "
            "the noise"
        )
    for st in fits:
        _add_fits(builder, st)
    has_samples = all(e.signals for st in fits for e in st.equations)
    own = all(e.is_least_squares for st in fits for e in st.equations)
    how = settings.covariance or ("scores" if own else "independent")
    assumes = ASSUMES[how if has_samples else "white"]
    return builder.build(
        _method(fits, settings, "least squares" if own else "instrumental variables"),
        Uncertainty(propagated.names, propagated.covariance, assumes),
        SolverEvidence(
            fits[-1].solution.status,
            all(st.solution.is_converged for st in fits),
            sum(st.iterations for st in fits),
            max(st.solution.scaled_gradient for st in fits),
        ),
        Origin(tuple(provenance), versions(), SOURCES),
        measured_by="One step of the difference equation (to simulate it: casid.validate)",
        evidence=_evidence(fits, propagated),
        model=unsimulated_model(
            name,
            model,
            dict(p for st in fits for p in zip(st.free, st.theta_p.tolist(), strict=True)),
            _records(fits),
            (propagated.names, propagated.covariance),
        ),
    )


def _records(fits: Sequence[StageFit]) -> list[tuple[str, float, dict[str, float]]]:
    """Name, sample time and known values of every record."""
    found = {
        part.record: (part.Ts, {n: part.values[n] for n in part.known})
        for st in fits
        for part in st.parts
    }
    return [(name, Ts, known) for name, (Ts, known) in found.items()]


def _std_errors(covariance: Array) -> list[float]:
    errors: list[float] = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
    return errors


def _undetermined(st: StageFit, rank: LocalRank) -> list[str]:
    """A warning where least squares has no unique minimum; instruments would have refused.

    A zero at its bound has no relative size.
    """
    held = st.solution.active
    free = {f for f in st.free if f not in held}
    lost = any(free & set(direction) for direction in rank.null)
    return [describe_null(rank)] if lost and all(e.is_least_squares for e in st.equations) else []


def _add_fits(builder: EstimateBuilder, st: StageFit) -> None:
    """RMS and whiteness of the equation errors of one stage."""
    for part, e, theta in zip(st.parts, st.equations, st.thetas, strict=True):
        output = part.equation.output
        if not e.signals:  # sums alone: no samples to look at
            power, total = e.error_power(theta), float(e.second[0, 0])
            nrmse = 100 * (1 - (power / total) ** 0.5)
            builder.add_fit(part.record, output, power**0.5, nrmse)
            continue
        error = e.error(theta)
        left = e.equation.left.samples(e.signals, e.start)
        nrmse = float(100 * (1 - np.linalg.norm(error) / max(float(np.linalg.norm(left)), TINY)))
        builder.add_fit(part.record, output, float(np.sqrt(np.mean(error**2))), nrmse)
        builder.add_whiteness(part.name, error, "filtered equation error", "allowed for")


def _method(fits: Sequence[StageFit], settings: MomentSettings, kind: str) -> str:
    """The method in words."""
    stages = f"{len(fits)} stages" if len(fits) > 1 else "joint"
    noise = "1" if settings.noise_model is None else f"from ARMA{settings.noise_model}"
    return (
        f"{kind}, {stages}, {settings.form} form, {settings.method}, "
        f"weighting {settings.weighting}, prefilter {noise}"
    )


NOISY = 0.5
"""Share of noise in a regressor from which least squares warns.

White noise has all its power in its floor, and a signal of steps a third: this distinguishes them.
"""


def _mostly_noise(st: StageFit) -> list[str]:
    """Regressors that are no louder than the quietest spectrum of their channels.

    Least squares draws their coefficients towards zero, whatever the length of the record.
    """
    worst: dict[str, tuple[float, str]] = {}
    for e in st.equations:
        if not (e.is_least_squares and e.signals):
            continue
        for i, column in enumerate(e.equation.columns, start=1):
            channels = {channel for channel, _, _ in column.taps}
            floors = {c: white_floor([np.asarray(e.signals[c])]) for c in channels}
            noise = sum((weight * floors[channel]) ** 2 for channel, _, weight in column.taps)
            mean = column.samples(e.signals, e.start).mean()
            share = noise / max(float(e.second[i, i]) - mean**2, TINY)
            if noise > 0 and share > worst.get(column.name, (NOISY, ""))[0]:
                worst[column.name] = (min(share, 1.0), e.name)
    return [
        f"{name} is {100 * share:.0f} % noise in {record}, its channel's quietest frequencies say, "
        "and least squares takes it for a signal: use casid.instrumental_variables, or a record in "
        "which the system is excited more"
        for name, (share, record) in worst.items()
    ]


def _evidence(fits: Sequence[StageFit], p: Propagated) -> dict[str, str]:
    """The overidentification test, and the relevance of the instruments of each part."""
    out = {
        "surplus": (
            f"{p.degrees} moments more than parameters, chi2 {p.statistic:.3g}, "
            f"{p_statement(p.p_value)}"
            + (" (the moments contradict one another)" if p.p_value < 0.01 else "")
            if p.degrees
            else "none: as many moments as parameters, nothing to test"
        )
    }
    for st in fits:
        for part, c in zip(st.parts, st.correlations, strict=False):
            weak = ", ".join(f"{k} {v:+.2g}" for k, v in c.weakest.items() if abs(v) > 0.05)
            out[f"instruments of {part.name}"] = (
                f"rank of Phi {c.rank} of {len(c.canonical)}, canonical correlations "
                f"{', '.join(f'{v:.3g}' for v in c.canonical)}; weakest along {weak}"
            )
    return out


def _rank(st: StageFit) -> LocalRank:
    """Local rank of the weighted moments in the stage's free parameters."""
    parts = enumerate(zip(st.equations, st.roots, strict=True))
    J = np.vstack([root @ e.Phi @ free_slope(st, k, st.free) for k, (e, root) in parts])
    return local_rank(J.T @ J, st.theta_p, st.free, np.maximum(np.abs(st.theta_p), 1e-12))
