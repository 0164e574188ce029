"""A channel with the wrong sign, found by the simulation error with the channel negated.

A sign flip is a scale of -1 of one channel. Equations whose coefficients may have either sign fit
both; physical parameters with bounds, and those that several load cases share, fit one. So where a
fit is poor, every channel is negated in turn and the parameters are estimated anew. A flip is
suspected if the simulation then misses by less than half the power, and by no chance: the squared
errors of the two fits are compared by Diebold and Mariano's (1995) test, with a correction for the
number of channels (Bonferroni). Half the power is a heuristic: a channel that matters, taken the
wrong way round, costs far more.

A sign that is wrong explains the misfit: with it corrected the model has to miss less than the
outputs' means do, and less than with a turned input at rest, and not hold all of its parameters at
their bounds. A flip that only makes a hopeless fit less bad is none. An absolute temperature cannot
have a wrong sign at all. Quick fits only choose the channel: it is judged by a fit with its sign
turned, as many steps as the simulation needs, against the fit that is reported.

Where noise makes most of what the simulation misses, either sign misses by as much. Then an input
that no noise reaches distinguishes them, by the moments of instruments made of it
(`signs_from_moments`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import TINY, Array
from casid.data.arguments import problem_of
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.record import Record
from casid.deprecation import renamed
from casid.errors import CasidError, OutOfTimeError
from casid.estimation.covariance import bartlett_lags, long_run_covariance, whiteness
from casid.estimation.fit_statistics import nrmse_fit, rms
from casid.estimation.holdout import Split
from casid.estimation.nlp.solver import Solver
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.identification.channel_signs import negated, sign_correction
from casid.identification.signs_from_moments import sign_flips
from casid.model.model import Model
from casid.model.quantities import p_statement
from casid.time_limit import require_time

POOR = 80.0
"""Fit in per cent below which signs are doubted, where the residual is no white noise."""

CLEARLY = 0.5
"""Share of the misfit's power that may be left for a flip to be suspected."""


@dataclass(frozen=True, slots=True, eq=False)
class WrongSign:
    """A channel that was probably recorded with the wrong sign.

    Attributes
    ----------
    channel : of the model; the first of those that are indistinguishable, outputs before inputs.
    unit : its SI unit.
    p_value : that it fits better by chance, corrected for the number of channels tried.
    before, after : rms simulation error by output, as recorded (NaN without any fit) and negated.
    rivals : channel -> p-value against the named one, of those that negated fit as well; 1 where
        instruments do not distinguish them.
    start : values of the fit with the channel negated.
    reference : input whose instruments found it, where the simulation errors did not.
    left : share of the moments' J that is left with the channel negated, with a reference.
    """

    channel: str
    unit: str
    p_value: float
    before: dict[str, float]
    after: dict[str, float]
    rivals: dict[str, float]
    start: dict[str, float]
    reference: str = ""
    left: float = float("nan")

    @property
    def remedy(self) -> str:
        """What to do about it."""
        c = self.channel
        return (
            f"{sign_correction(c)}; in the problem file derived={{{c!r}: casid.Derived("
            f"{self.unit!r}, {{'{c}_recorded': {self.unit!r}}}, "
            f"lambda record: -record['{c}_recorded'])}}, the file's column mapped to {c}_recorded"
        )

    mend = renamed("mend", "remedy")

    def __str__(self) -> str:
        gains = ", ".join(
            f"{output} from {self.before[output]:.3g} to {after:.3g}"
            for output, after in self.after.items()
        )
        if self.reference:
            gains += (
                f", and Hansen's J of instruments from {self.reference}, which rejects the signs "
                f"as recorded ({p_statement(self.p_value, '.1g')}), to {100 * self.left:.2g} %"
            )
        others = f" (or {', '.join(self.rivals)}, which fits as well)" if self.rivals else ""
        return (
            f"the channel {self.channel} probably has the wrong sign, a scale of -1{others}: "
            f"negating it lowers the rms error of {gains}. {self.remedy}"
        )


def is_poor(fit: Fit) -> bool:
    """True if signs should be doubted: no optimum, or much is missed that is no white noise."""
    if not fit.solution.is_converged:
        return True
    at_bound = any(
        v.name in fit.solution.active
        for v in fit.criterion.variables
        if v.source in fit.criterion.model.parameters
    )
    for e, d in enumerate(fit.criterion.data):
        residual = fit.criterion.simulated(fit.x, e).residual
        fits = nrmse_fit(np.where(d.used, d.y, np.nan), np.where(d.used, residual, np.nan))
        for i, per_cent in enumerate(fits.tolist()):
            used = d.used[:, i]
            if (at_bound or per_cent < POOR) and used.sum() > 40:
                if whiteness(residual[used, i]) > 3:
                    return True
    return False


def wrong_sign(
    problem: Problem | Model,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    *,
    reported: Fit | None = None,
    alpha: float = 0.05,
) -> WrongSign | None:
    """The channel to be suspected, if any: negated in turn, where the fit as recorded is poor.

    Uses the most excited window of each record alone, 2000 samples, from one start: where nothing
    is wrong that is one quick fit. Nothing is suspected where an input rests in all records, or
    where the simulation does not rise above what it misses.

    Parameters
    ----------
    problem : its inputs declared free of noise are references for instruments; without any, those
        of unknown noise that past outputs do not predict.
    experiments : as recorded, with their load cases.
    reported : the fit to them that the user sees, if there is one: a flip has to be better than it.
    alpha : of the test, for all channels together.
    """
    problem = problem_of(problem)
    model = problem.model
    inputs = [n for n, u in model.inputs.items() if u.kind == "measured"]
    if any(all(_rests(e.record, n) for e in experiments) for n in inputs):
        return None
    channels = [n for n in (*model.outputs, *inputs) if _may_be_turned(experiments, n)]
    short = [most_excited(e, tuple(model.outputs)) for e in experiments]
    quick = quick_settings(settings)
    recorded = _as_recorded(model, experiments, short, quick, reported)
    if recorded is not None and not is_poor(recorded):
        return None
    found = {c: _fitted(model, negated(short, c), quick) for c in channels}
    squares = {c: squared_errors(f) for c, f in found.items() if f is not None}
    if not squares:
        return None
    # Of those that fit alike the first is named: outputs before inputs.
    best = min(squares, key=lambda c: float(squares[c].sum()) * (1 + 1e-4 * channels.index(c)))
    error = squares[best]
    # Where nothing fits as recorded, a flip has to be better than some other.
    others = [s for s in squares.values() if error.sum() < CLEARLY * s.sum()]
    least = min(others, key=_sum, default=error)
    reference = squared_errors(recorded) if recorded is not None else least
    # The best of the quick fits once more, to its end: the steps of those may be too long.
    if error.sum() < reference.sum() and (full := _to_its_end(found[best], settings)) is not None:
        found[best] = full
    fit = found[best]
    assert fit is not None
    left = squared_errors(fit)
    p = min(1.0, len(channels) * better_by_chance(reference - left))
    missing = dict.fromkeys(model.outputs, float("nan"))
    before = missing if recorded is None else _rms(recorded)
    if left.sum() >= CLEARLY * reference.sum() or p >= alpha:
        is_worse = {c for c, s in squares.items() if _sum(s) >= _sum(reference)}
        worse = set() if recorded is None else is_worse
        return _by_reference(problem, experiments, found, before, worse, alpha)
    if not (_rises(fit) and _is_good(fit, best)):
        return None
    # The fit as recorded may have stopped on the way: from where the turned one ended, too.
    instead = _near(model, short, replace(settings, starts=1), fit)
    if instead is not None and left.sum() >= CLEARLY * squared_errors(instead).sum():
        return None
    better = {c: s for c, s in squares.items() if s.sum() < CLEARLY * reference.sum()}
    same = {c: min(1.0, 2.0 * better_by_chance(s - error)) for c, s in better.items() if c != best}
    return WrongSign(
        channel=best,
        unit=_unit(model, best),
        p_value=p,
        before=before,
        after=_rms(fit),
        rivals={c: p_same for c, p_same in same.items() if p_same > alpha},
        start=fit.values,
    )


def _as_recorded(
    model: Model,
    experiments: Sequence[Experiment],
    short: Sequence[Experiment],
    quick: FitSettings,
    reported: Fit | None,
) -> Fit | None:
    """The fit with the signs as recorded: the one that is reported, or one that begins there."""
    if reported is None:
        return _fitted(model, short, quick)
    if all(a is b for a, b in zip(experiments, short, strict=True)):
        return reported if np.isfinite(reported.solution.value) else None
    steps = replace(quick, substeps=reported.criterion.substeps)
    found = [_fitted(model, short, quick), _near(model, short, steps, reported)]
    return min(
        (f for f in found if f is not None), key=lambda f: _sum(squared_errors(f)), default=None
    )


def _near(
    model: Model, experiments: Sequence[Experiment], settings: FitSettings, other: Fit
) -> Fit | None:
    """The fit from the parameters of another, its initial states as declared."""
    start = {name: value for name, value in other.values.items() if name in model.parameters}
    return _fitted(model, experiments, settings, start=start)


def _to_its_end(fit: Fit | None, settings: FitSettings) -> Fit | None:
    """The fit from where a quick one ended, with as many steps as it needs."""
    if fit is None:
        return None
    once = replace(settings, starts=1)
    return _fitted(fit.criterion.model, fit.criterion.experiments, once, start=fit.values)


def _by_reference(
    problem: Problem,
    experiments: Sequence[Experiment],
    fits: Mapping[str, Fit | None],
    before: dict[str, float],
    worse: Collection[str],
    alpha: float,
) -> WrongSign | None:
    """The channel that instruments from a reference suspect, where the simulation is no worse."""
    long = [most_excited(e, tuple(problem.model.outputs), 10_000) for e in experiments]
    for reference in _references(problem, long):
        try:
            flips = sign_flips(problem, long, reference=reference)
        except CasidError:
            continue
        named = next((f for f in flips if f.is_suspected), None)
        if named is None or named.p_value is None or named.p_value >= alpha:
            return None
        fit = fits.get(named.channel)
        if named.ratio**2 >= CLEARLY or named.channel in worse or fit is None:
            return None
        if not _is_good(fit, named.channel):
            return None
        return WrongSign(
            channel=named.channel,
            unit=_unit(problem.model, named.channel),
            p_value=named.p_value,
            before=before,
            after=_rms(fit),
            rivals={f.channel: 1.0 for f in flips if f.is_rival},
            start=fit.values,
            reference=reference,
            left=named.ratio**2,
        )
    return None


def _references(problem: Problem, experiments: Sequence[Experiment]) -> list[str]:
    """Inputs that no noise reaches: declared so, or neither noisy nor predicted by outputs."""
    inputs = [
        n
        for n, u in problem.model.inputs.items()
        if u.kind == "measured" and all(n in e.record for e in experiments)
    ]
    quiet = [n for n in inputs if problem.noise.get(n) == 0.0]
    if quiet:
        return quiet
    outputs = list(problem.model.outputs)
    return [
        n
        for n in inputs
        if n not in problem.noise and not any(_depends(e.record, n, outputs) for e in experiments)
    ]


def _depends(record: Record, reference: str, outputs: Sequence[str]) -> bool:
    from casid.estimation.moments.instruments.exogeneity import reference_depends_on

    try:
        return reference_depends_on(record, reference, outputs, draws=199).depends
    except CasidError:
        return True


def _rests(record: Record, channel: str) -> bool:
    return channel in record and float(np.ptp(record[channel])) == 0.0


def _may_be_turned(experiments: Sequence[Experiment], channel: str) -> bool:
    """Whether every record has a channel, and it may have the wrong sign."""
    return all(channel in e.record and not _is_absolute(e.record, channel) for e in experiments)


def _is_absolute(record: Record, channel: str) -> bool:
    """Whether a channel is a temperature above absolute zero, not the difference of two."""
    if record.units[channel] != "K":
        return False
    kept = record.filled(channel)[~record.is_missing(channel)]
    return bool(kept.size and kept.min() > np.ptp(kept))


def is_better_than_the_mean(fit: Fit) -> bool:
    """True if the weighted squared errors are less than those of each output's mean."""
    c = fit.criterion
    total = 0.0
    for d in c.data:
        for i in range(len(c.outputs)):
            y = d.y[d.used[:, i], i]
            weights = np.broadcast_to(c.weights, d.y.shape)[d.used[:, i], i]
            total += float(np.sum((weights * (y - y.mean())) ** 2)) if y.size else 0.0
    return _sum(squared_errors(fit)) < total


def _is_good(fit: Fit, channel: str) -> bool:
    """True if a flip makes a model of it: of the outputs, by what it says of the channel."""
    model, free = fit.criterion.model, fit.criterion.variables
    bounded = [v.name in fit.solution.active for v in free if v.source in model.parameters]
    if len(bounded) > 1 and all(bounded):
        return False
    return is_better_than_the_mean(fit) and not _is_better_at_rest(fit, channel)


def _is_better_at_rest(fit: Fit, channel: str) -> bool:
    """True if an input that stays at its mean explains as much: the outputs go against it then."""
    c = fit.criterion
    if channel not in c.model.inputs:
        return False
    column, moving, resting = list(c.model.inputs).index(channel), 0.0, 0.0
    for e, d in enumerate(c.data):
        u = d.u.copy()
        u[:, column] = u[:, column].mean()
        with np.errstate(all="ignore"):
            y, _, _ = c.simulate(fit.x, e, signals=replace(d, u=u))
            resting += _sum((np.where(d.used, d.y - y, 0.0) * c.weights) ** 2)
        moving += _sum((c.simulated(fit.x, e).residual * c.weights) ** 2)
    return resting <= moving


def _rises(fit: Fit) -> bool:
    """True if some simulated output moves by as much as is missed of it."""
    for e, d in enumerate(fit.criterion.data):
        at = fit.criterion.simulated(fit.x, e)
        for i in range(len(fit.criterion.outputs)):
            used = d.used[:, i]
            if used.any() and np.std(at.y[used, i]) >= rms(at.residual[used, i]):
                return True
    return False


def _unit(model: Model, channel: str) -> str:
    return model.outputs[channel][1] if channel in model.outputs else model.inputs[channel].unit


def _fitted(
    model: Model,
    experiments: Sequence[Experiment],
    settings: FitSettings,
    start: Mapping[str, float] | None = None,
) -> Fit | None:
    try:
        fit = fit_model(model, experiments, settings, start=start, check_rank=False, throw=False)
        if fit.not_done:
            require_time("the test of the signs of the channels")
    except OutOfTimeError:
        raise  # what was cut off is no evidence against a sign
    except CasidError:
        return None
    return fit if np.isfinite(fit.solution.value) else None


def most_excited(
    experiment: Experiment, outputs: tuple[str, ...], samples: int = 2000
) -> Experiment:
    """The stretch of a record in which its outputs move the most."""
    r = experiment.record
    if r.N <= samples:
        return experiment
    moves = sum((r[n] - r[n].mean()) ** 2 / max(float(np.var(r[n])), TINY) for n in outputs)
    total = np.concatenate([[0.0], np.cumsum(moves)])
    first = int(np.argmax(total[samples:] - total[:-samples]))
    part = r.between(float(r.t[first]), float(r.t[first + samples - 1]))
    return replace(experiment, record=replace(part, name=r.name))


def _sum(values: Array) -> float:
    return float(values.sum())


def quick_settings(settings: FitSettings) -> FitSettings:
    """One start and few iterations: enough to detect a wrong sign, not to estimate."""
    solver = settings.solver or Solver()
    return replace(
        settings,
        starts=1,
        substeps=settings.substeps or 1,
        solver=replace(solver, max_iterations=min(solver.max_iterations, 25)),
    )


def negated_split(split: Split, channel: str) -> Split:
    """What is fitted and what is held out, with one channel negated."""
    return replace(
        split,
        fitted=negated(split.fitted, channel),
        whole=negated(split.whole, channel),
        apart=negated(split.apart, channel),
    )


def squared_errors(fit: Fit) -> Array:
    """(sum of N,) squared weighted errors of all outputs, experiments stacked."""
    c = fit.criterion
    parts = [
        np.sum(np.where(d.used, c.simulated(fit.x, e).residual * c.weights, 0.0) ** 2, axis=1)
        for e, d in enumerate(c.data)
    ]
    return np.concatenate(parts)


def better_by_chance(difference: Array) -> float:
    """One-sided p-value that squared errors fell, (N,), by chance (Diebold and Mariano 1995)."""
    size = float(np.max(np.abs(difference), initial=0.0))
    if not 0.0 < size < np.inf:
        return 1.0
    difference = difference / size  # squares of a diverging simulation would overflow
    column = (difference - difference.mean())[:, None]
    variance = float(long_run_covariance(column, bartlett_lags(column))[0, 0])
    total = float(difference.sum())
    if variance <= 0:
        return 0.0 if total > 0 else 1.0
    return 0.5 * math.erfc(total / math.sqrt(2.0 * variance))


def _rms(fit: Fit) -> dict[str, float]:
    errors = [
        np.where(d.used, fit.criterion.simulated(fit.x, e).residual, np.nan)
        for e, d in enumerate(fit.criterion.data)
    ]
    return dict(zip(fit.criterion.outputs, rms(np.concatenate(errors)).tolist(), strict=True))
