"""Least squares and instrumental variables for physical parameters: joint and in stages.

The estimators of Linder (2017), chapters 5 and 7, for any model whose unknown inputs have been
eliminated: the records become moment equations (`moment_equations`), the parameters the
solution of a small program (`moment_nlp`), refined over instruments and noise models
(`stage`), with the noise of every record followed to every parameter (`propagation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from casid.arrays import TINY, Array
from casid.data.problem import Problem
from casid.data.record import Experiment
from casid.errors import ModelError
from casid.estimation.estimate import (
    Estimate,
    Estimated,
    Identifiability,
    Origin,
    SolverEvidence,
    Uncertainty,
)
from casid.estimation.estimate_builder import EstimateBuilder, bound_of
from casid.estimation.local_rank import LocalRank, describe_null, local_rank
from casid.estimation.moments.instruments import Instruments, Loop
from casid.estimation.moments.moment_estimate import MomentEstimate
from casid.estimation.moments.moment_settings import MomentSettings
from casid.estimation.moments.parts import Part, parts_of
from casid.estimation.moments.prior import Prior
from casid.estimation.moments.propagation import Propagated, free_slope, propagate
from casid.estimation.moments.stage import Stage, StageFit
from casid.estimation.moments.stage_plan import StageSpec
from casid.estimation.noise import white_floor
from casid.identifiability.requirement import require_identifiable
from casid.model.model import Model
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
    "error makes them too large or too small, by a factor that the sums cannot tell",
    "independent": "equation errors of zero mean and finite memory, independent of the external "
    "reference; the discretisation's own bias is not in it",
    "scores": "autocorrelation-robust (Newey-West): equation errors of zero mean, not correlated "
    "with the regressors; noise on the regressors biases least squares and is not in it",
}


def least_squares(
    problem: Problem | Model,
    experiments: Sequence[Experiment] | Experiment,
    *,
    free: Sequence[str] | None = None,
    settings: MomentSettings | None = None,
) -> MomentEstimate:
    """Least squares on the difference equations, (2.39) with the physics as constraints.

    Fast and of small variance, but biased where outputs or inputs carry noise, or a loop is closed:
    a start for the others, and a measure of what instruments are worth. Parameters and errors as
    `instrumental_variables`; where the records are not excited, which instruments refuse, the
    estimate has a warning.
    """
    return _estimate(problem, experiments, [StageSpec(free or ())], None, None, settings, {})


def instrumental_variables(
    problem: Problem | Model,
    experiments: Sequence[Experiment] | Experiment,
    instruments: Instruments,
    *,
    free: Sequence[str] | None = None,
    prior: Prior | None = None,
    settings: MomentSettings | None = None,
) -> MomentEstimate:
    """All records at once: joint (extended, refined) instrumental variables, Approach 5.2.

    Parameters
    ----------
    problem : whose model has no unknown inputs left (`Model.eliminate`).
    experiments : each with its load case; sample times may differ.
    instruments : the external reference, and the lags.
    free : parameters to estimate; default those that the model declares unknown.
    prior : known values with their uncertainty, which is propagated.

    Returns
    -------
    MomentEstimate

    Raises
    ------
    IdentifiabilityError
        If the parameters cannot be told apart, or the instruments do not see a direction.
    DataError, ModelError, SolveError
        For unusable records, models and programs without an optimum.

    Notes
    -----
    Consistent for any noise that is independent of the reference, in closed loop and with noise on
    the measured inputs (Linder 2017, (2.44)). The covariance is the sandwich of (2.57)-(2.59).
    """
    return _estimate(
        problem, experiments, [StageSpec(free or ())], instruments, prior, settings, {}
    )


def multistage(
    problem: Problem | Model,
    experiments: Sequence[Experiment] | Experiment,
    stages: Sequence[StageSpec],
    instruments: Instruments | None = None,
    *,
    prior: Prior | None = None,
    settings: MomentSettings | None = None,
) -> MomentEstimate:
    """One stage after the other, each given the ones before (Approaches 5.1 and 7.1).

    Parameters
    ----------
    stages : in order; by default each is solved in the linear form.
    instruments : None: least squares.

    Returns
    -------
    MomentEstimate
        Its covariance propagates the earlier stages, which Linder (2017) takes as exact;
        `std_error(name, propagated=False)` gives the errors without.

    Raises
    ------
    ModelError
        If two stages estimate one parameter; else as `instrumental_variables`.
    """
    if not stages:
        raise ModelError("multistage: no stage given; name one with StageSpec(free=[...])")
    names = [n for s in stages for n in s.free]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise ModelError(
            f"multistage: {twice[0]} is estimated in two stages; leave it to the first of them, "
            "or estimate jointly with instrumental_variables"
        )
    chosen = settings or MomentSettings(form="linear")
    return _estimate(problem, experiments, stages, instruments, prior, chosen, {})


def _estimate(
    problem: Problem | Model,
    experiments: Sequence[Experiment] | Experiment,
    stages: Sequence[StageSpec],
    instruments: Instruments | None,
    prior: Prior | None,
    settings: MomentSettings | None,
    cache: dict[Any, Any],
) -> MomentEstimate:
    model = problem.model if isinstance(problem, Problem) else problem
    settings = settings or MomentSettings()
    if isinstance(experiments, Experiment):
        experiments = [experiments]
    if model.stages:
        stage = model.stages[0]
        raise ModelError(
            f"{model.name}: channel {stage.channel} has a {stage.kind}, which a difference "
            "equation cannot show; leave that effect out, or use casid.identify"
        )
    if instruments is not None and not isinstance(instruments, Instruments):
        raise ModelError(
            f"instruments = {instruments!r}; give casid.Instruments('reference'), named after the "
            "channel that no disturbance reaches"
        )
    if prior is not None:
        for name in prior.values:
            model.parameter_named(name)
        model = model.with_known(**{k: float(v) for k, v in prior.values.items()})
    declared = tuple(p.name for p in model.parameters.values() if not p.is_known)
    specs = [replace(s, free=tuple(s.free) or declared) for s in stages]
    for s in specs:
        for f in s.free:
            model.parameter_named(f)
            if prior is not None and f in prior.values:
                raise ModelError(
                    f"{f} is estimated and has a prior value; take it out of one of the two"
                )
    equations = cache.setdefault("equations", {})
    loops: dict[float, Loop] = cache.setdefault("loops", {})
    fits: list[StageFit] = []
    told: list[str] = []
    found: dict[str, float] = {}
    by_name = {e.name: e for e in experiments}
    read: list[tuple[MomentSettings, list[Part]]] = []
    for i, s in enumerate(specs):  # all stages are asked about before one is estimated
        own = s.settings or settings
        chosen = list(experiments)
        if s.records is not None:
            unknown = [r for r in s.records if r not in by_name]
            if unknown:
                raise ModelError(
                    f"stage {i + 1}: no record {unknown[0]!r}; there are {', '.join(by_name)}"
                )
            chosen = [by_name[r] for r in s.records]
        parts = parts_of(model, chosen, method=own.method, outputs=own.outputs, equations=equations)
        before = {f for earlier in specs[:i] for f in earlier.free}
        _refuse_undetermined(specs, i, parts, {*declared} - before - {*s.free})
        asked = ("structure", i, tuple((e.name, tuple(e.known.items())) for e in chosen))
        if asked not in cache:
            cache[asked] = require_identifiable(model, chosen, free=s.free)
        told.append(cache[asked])
        read.append((own, parts))
    for i, (s, (own, parts)) in enumerate(zip(specs, read, strict=True)):
        key = ("stage", i, tuple((p.name, p.Ts, p.known) for p in parts))
        if key not in cache:
            cache[key] = Stage(
                model, parts, s.free, own, instruments, loops=loops, name=f"stage {i + 1}"
            )
        values = [
            {**p.values, **{k: v for k, v in found.items() if k not in p.known}} for p in parts
        ]
        fit = cache[key].fit(parts, values)
        fits.append(fit)
        found |= dict(zip(fit.free, fit.theta_p.tolist(), strict=True))
    how = settings.covariance
    propagated = propagate(
        fits,
        tuple(prior.values) if prior else (),
        prior.matrix() if prior else None,
        how=how,
    )
    name = problem.name
    provenance = [f"{e.name}: {line}" for e in experiments for line in e.record.provenance]
    estimate = as_estimate(name, model, provenance, fits, propagated, settings)
    structural = "; ".join(dict.fromkeys(told))
    estimate = replace(
        estimate, identifiability=replace(estimate.identifiability, structural=structural)
    )
    return MomentEstimate(model, estimate, propagated, tuple(fits), prior)


def _refuse_undetermined(
    specs: Sequence[StageSpec], i: int, parts: Sequence[Part], undetermined: set[str]
) -> None:
    """What a stage's records feel has to be known there, or estimated by now."""
    later = {f for s in specs[i + 1 :] for f in s.free}
    for p in parts:
        slope = np.asarray(p.equation.jacobian([p.values[q] for q in p.equation.parameters])[1])
        felt = {
            q
            for q, column in zip(p.equation.parameters, slope.T, strict=True)
            if np.any(np.abs(column) > 1e-12)  # where no load is on, its height has no effect
        }
        missing = sorted(((undetermined | later) - p.known) & felt)
        waiting = [q for q in missing if q in later]
        if waiting:
            raise ModelError(
                f"stage {i + 1}, record {p.record}: {', '.join(waiting)} is estimated only in a "
                f"later stage and not known here; give its value in the record's load case "
                f"(Experiment(record, {{{waiting[0]!r}: ...}})), or reorder the stages"
            )
        if missing:
            raise ModelError(
                f"record {p.record}: {', '.join(missing)} is neither known nor estimated; give it "
                "a value (prior=, a load case, model.with_known), or free it in a stage"
            )


def as_estimate(
    name: str,
    model: Model,
    provenance: Sequence[str],
    fits: Sequence[StageFit],
    propagated: Propagated,
    settings: MomentSettings,
) -> Estimate:
    """The estimate that the fits of all stages make."""
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
            f"{propagated.degrees} degrees of freedom, p = {propagated.p_value:.1g}): a known "
            "value, a load case or the model is wrong (a prefilter that lifts high frequencies "
            "lifts the discretisation's error), or the reference is not independent of the noise"
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
    )


def _std_errors(covariance: Array) -> list[float]:
    errors: list[float] = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
    return errors


def _undetermined(st: StageFit, rank: LocalRank) -> list[str]:
    """A warning where least squares has no unique minimum; instruments would have refused.

    A zero at its bound has no relative size.
    """
    bound = {*st.solution.at_lower, *st.solution.at_upper}
    free = {f for f in st.free if f not in bound}
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
        builder.add_whiteness(
            part.name,
            error,
            "filtered equation error",
            "autocorrelated; the error bars allow for it",
        )


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

White noise has all its power in its floor, and a signal of steps a third, so this tells them apart.
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
    """What the moments say of themselves, and what the instruments see of each part."""
    out = {
        "surplus": (
            f"{p.degrees} moments more than parameters, chi2 {p.statistic:.3g}, p = {p.p_value:.2g}"
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


@dataclass(frozen=True, slots=True, eq=False)
class Reusable:
    """A multistage or joint estimator whose programs are built once, for many data sets.

    Example
    -------
    ``estimator = Reusable(problem, stages, instruments); estimator(experiments)`` gives what
    `multistage` gives, at the cost of the data alone from the second call on.
    """

    problem: Problem | Model
    stages: Sequence[StageSpec]
    instruments: Instruments | None = None
    prior: Prior | None = None
    settings: MomentSettings | None = None
    _cache: dict[Any, Any] = field(default_factory=dict)

    def __call__(self, experiments: Sequence[Experiment] | Experiment) -> MomentEstimate:
        """The estimate from records of the same names, load cases and sample times."""
        return _estimate(
            self.problem,
            experiments,
            self.stages,
            self.instruments,
            self.prior,
            self.settings,
            self._cache,
        )
