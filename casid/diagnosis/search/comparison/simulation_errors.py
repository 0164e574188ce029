"""Whether an extension lowers the simulation error, in the units of every output.

A likelihood can rise because the weights have changed while the errors grow. Extensions are
therefore judged by their errors as well: of the fitted part, and of what was held out, once with
the simulation running on and once from an initial state of its own. Every output counts in units of
the error that the baseline leaves of it. All models are fitted and compared in these units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as f_distribution

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.diagnosis.search.refusals import ACCEPTED, Refusal
from casid.diagnosis.thresholds import FORESIGHT, GROWTH, ROUNDS
from casid.errors import SolveError
from casid.estimation.holdout import (
    Split,
    begun_apart,
    counted_by_all,
    degrees_of_freedom,
    end_in_windows,
    error_per_window,
    errors_apart,
    has_windows,
    held_out_error,
    in_windows,
    whole_simulation,
    why_no_better,
    why_worse,
)
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.varying_response import along_record, less_states
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError


@dataclass(frozen=True, slots=True, eq=False)
class SimulationErrors:
    """Errors of one model, (M, ny) each, in units of the baseline's noise; NaN where not used.

    Attributes
    ----------
    fitted : of the part that was fitted.
    continued : of what was held out, the simulation running on; records of their own among it, NaN
        in one that does not judge the model (`Split.judges`).
    restarted : of the held-out ends, each from an initial state of its own; empty where whole
        records were held out, which are simulated so anyway.
    """

    fitted: Array
    continued: Array
    restarted: Array

    @property
    def square(self) -> float:
        """Sum of squares of the fitted part."""
        return float(np.nansum(self.fitted**2))

    @property
    def held_out_square(self) -> float:
        """Sum of squares of what was held out, both ways."""
        return float(np.nansum(self.continued**2) + np.nansum(self.restarted**2))


def on_common_samples(*errors: SimulationErrors) -> list[SimulationErrors]:
    """Errors of several models on the samples that all of them count.

    A late channel counts fewer than another, which would flatter it.
    """
    fitted, continued, restarted = (
        counted_by_all(*(getattr(e, part) for e in errors))
        for part in ("fitted", "continued", "restarted")
    )
    return [SimulationErrors(*parts) for parts in zip(fitted, continued, restarted, strict=True)]


def simulation_errors(
    fit: Fit, split: Split, units: Array, noise: NoiseModel | None = None
) -> SimulationErrors:
    """The errors of a fit.

    Parameters
    ----------
    noise : the errors are whitened by it, each record from end to end: what a disturbance moves is
        no error of the model. A simulation that starts anew shows nothing more then.
    units : (ny,) weights of the baseline, one over the RMS error that it leaves of each output.

    Raises
    ------
    SolveError
        If an initial state of what was held out cannot be fitted.
    """
    if noise is not None and has_windows(fit):
        return _errors_in_windows(fit, split, units, noise)
    whole = _whole_errors(fit, split, units, _along_whole(noise, fit, split))
    inside = [error[~held] for error, held in zip(whole, split.held, strict=True)]
    ends = [error[held] for error, held in zip(whole, split.held, strict=True)]
    ends += errors_apart(fit, split, lambda e: _error_apart(fit, e, units, noise))
    restarted = np.zeros((0, len(units)))
    if noise is None and any(bool(held.any()) for held in split.held):
        again = held_out_error(fit, replace(split, apart=[]), anew=True)
        restarted = again / fit.criterion.weights * units
    return SimulationErrors(np.concatenate(inside), np.concatenate(ends), restarted)


def _error_apart(fit: Fit, experiment: Experiment, units: Array, noise: NoiseModel | None) -> Array:
    """(N, ny) of a record held out as a whole."""
    apart, x = begun_apart(fit, experiment)
    its = along_record(noise, apart, x) if noise is not None else None
    return _errors(apart.data[0], apart.simulate(x, 0)[0], units, its, 0)


def _along_whole(noise: NoiseModel | None, fit: Fit, split: Split) -> NoiseModel | None:
    """The noise for the fitted records to their ends, where a response that varies goes on to."""
    if noise is None or not noise.varying:
        return noise
    return along_record(noise, fit.criterion.of_records(split.whole, start=fit.values), fit.x)


def _errors_in_windows(fit: Fit, split: Split, units: Array, noise: NoiseModel) -> SimulationErrors:
    """Errors of an unstable model, whitened: every window in the state that the noise makes likely.

    What a state that is fitted without the noise leaves where a window begins, the noise has not.
    """
    inside = []
    for e, d in enumerate(fit.criterion.data):
        residual = fit.criterion.simulated(fit.x, e).residual
        white = noise.whiten((np.where(d.used, residual, 0.0) * units)[:, :, None], e)
        inside.append(np.where(d.used, white[:, :, 0], np.nan))
    ends = []
    for whole, held in zip(split.whole, split.held, strict=True):
        if held.any():
            ends.append(end_in_windows(fit, whole, int(np.argmax(held))))
    outside = [_whitened_end(*end, noise) for end in ends]
    outside += errors_apart(fit, split, lambda e: _whitened_end(*in_windows(fit, e), noise))
    none = np.zeros((0, len(units)))
    held = np.concatenate([error_per_window(fit, e) for e in outside]) if outside else none
    return SimulationErrors(np.concatenate(inside), held, none)


def _whitened_end(criterion: SimulationError, x: Array, noise: NoiseModel) -> Array:
    """(N, ny) the whitened error of a record of which the initial states are the variables."""
    used, found = criterion.data[0].used, criterion.simulated(x, 0)
    residual = np.where(used, found.residual, 0.0)
    there = along_record(noise, criterion, x)
    left = less_states(there, [residual], [np.where(used[:, :, None], found.jacobian, 0.0)])[0]
    white = there.whiten((left * noise.weights)[:, :, None], 0)[:, :, 0]
    white = np.where(np.isfinite(white), white, np.inf)  # a simulation that breaks down errs
    return np.where(used, white, np.nan)


def _whole_errors(
    fit: Fit, split: Split, units: Array, noise: NoiseModel | None = None
) -> list[Array]:
    """(N, ny) of every fitted record to its end, but of samples that the fit itself leaves out.

    Of a late channel the first ones show what was before the record: an initial state that only
    they would contradict is free.
    """
    out = []
    for e, held in enumerate(split.held):
        d, y, _ = whole_simulation(fit, split, e)
        used = d.used.copy()
        used[~held] &= fit.criterion.data[e].used
        out.append(_errors(replace(d, used=used), y, units, noise, e))
    return out


def _errors(d: Signals, y: Array, units: Array, noise: NoiseModel | None, experiment: int) -> Array:
    error = d.errors(y) * units
    if noise is not None:
        error = noise.whiten(error[:, :, None], experiment, d.used)[:, :, 0]
    error = np.where(np.isfinite(error), error, np.inf)  # a simulation that breaks down errs
    return np.where(d.used, error, np.nan)


def why_not_adopted(
    before: SimulationErrors,
    after: SimulationErrors,
    *,
    is_alarm: bool = False,
) -> Refusal:
    """Why an extension is refused by its errors, if it is.

    The error of the fitted part has to fall, and so have those of what was held out together: one
    that grows is made up for by the other, should that fall by the larger factor. A simulation that
    runs on gathers the errors of an integrator, which a right cause may change for the worse.

    An effect that is fitted to noise loses on every sample held out what it gained on one fitted.
    A held-out error that rises by less than `ROUNDS.overfit` of that gain counts as the same: in a
    motion that has all but died away it is next to nothing, whatever its ratio.

    Parameters
    ----------
    is_alarm : significant by itself at the rate that the user set; one of the held-out errors may
        then fall by chance. Any other has to show that its gain there is more.
    """
    shared = np.isfinite(before.fitted) & ~np.isnan(after.fitted)
    old, new = (float(np.sum(e.fitted[shared] ** 2)) for e in (before, after))
    if not np.isfinite(new):
        return Refusal("its simulation diverges on the fitted data", "fitted")
    if new >= old:
        return Refusal("it does not lower the error of the fitted part", "fitted")
    tolerance = ROUNDS.overfit * (old - new) / max(int(shared.sum()), 1)
    return why_held_out(before, after, is_alarm=is_alarm, tolerance=tolerance)


def is_as_good_held_out(before: SimulationErrors, after: SimulationErrors) -> bool:
    """True of a held-out error that rises by less than `ROUNDS.overfit` of what one fitted falls.

    Whitened by a disturbance, what was held out may be too short to tell: see `why_not_adopted`.
    """
    before, after = on_common_samples(before, after)
    falls = _mean_square(before.fitted) - _mean_square(after.fitted)
    rises = _mean_square(after.continued) - _mean_square(before.continued)
    return rises < ROUNDS.overfit * falls


class Soundness:
    """Whether a model simulates all that was measured, no worse than the model as it is.

    Every step of the search takes care of that by itself; after the last one it is made sure. The
    error of the fitted part may grow as under a disturbance (`growth_by_disturbance`).
    """

    def __init__(self, base: Fit, split: Split) -> None:
        self._split, self._units = split, base.criterion.weights
        self._base = self._errors(base)

    def _errors(self, fit: Fit) -> SimulationErrors:
        return simulation_errors(fit, self._split, self._units)

    def __call__(self, fit: Fit) -> bool:
        """False also of a simulation that diverges."""
        try:
            errors = self._errors(fit)
        except SolveError:
            return False
        old, new = on_common_samples(self._base, errors)
        most = growth_by_disturbance(old.fitted, fit) * old.square
        return bool(np.isfinite(new.held_out_square) and new.square <= most)


def growth_by_disturbance(errors: Array, fit: Fit) -> float:
    """The factor by which a fit under a disturbance may leave more squares than least squares.

    What least squares fits of a disturbance, its parameters have no part in: those that are right
    lie in its confidence region, which reaches up to

        S / S_LS = 1 + p / (n - p) F(p, n - p)                                                (1)

    (Beale, J. R. Stat. Soc. B 22 (1960) 41-88), with n degrees of freedom of the errors that least
    squares leaves; but no further than `GROWTH.by_least_squares`, and `GROWTH.by_chance` in
    any case.

    Parameters
    ----------
    errors : (M, ny) those of least squares.
    fit : under the disturbance, with p unknowns.
    """
    unknowns = len(fit.x)
    freedom = max(degrees_of_freedom(errors) - unknowns, 1.0)
    chance = float(f_distribution.isf(FORESIGHT.p, unknowns, freedom))
    reach = 1 + unknowns / freedom * chance
    least, most = ((1 + share) ** 2 for share in (GROWTH.by_chance, GROWTH.by_least_squares))
    return min(max(reach, least), most)


def is_predicted(before: SimulationErrors, after: SimulationErrors) -> bool:
    """True if an extension takes most of every held-out error away, by more than chance.

    A random disturbance is another one in what was held out: an effect fitted to it in the fitted
    part predicts nothing there. The sums of squares have the degrees of freedom that their
    spectra leave; that both errors share a disturbance makes the F-test err on its side.
    """
    ways = _held_out_ways(before, after)
    return bool(ways) and all(_is_far_less(new, old) for old, new in ways)


def is_all_but_predicted(before: SimulationErrors, after: SimulationErrors) -> bool:
    """True if an extension leaves next to nothing of every held-out error, by chance or not."""
    ways = _held_out_ways(before, after)
    return bool(ways) and all(_square(new) <= FORESIGHT.all_but * _square(old) for old, new in ways)


def _held_out_ways(before: SimulationErrors, after: SimulationErrors) -> list[tuple[Array, Array]]:
    """Errors of what was held out, of runs that continue and of those that begin there."""
    before, after = on_common_samples(before, after)
    ways = [(before.continued, after.continued), (before.restarted, after.restarted)]
    return [(old, new) for old, new in ways if not np.all(np.isnan(old))]


def _square(e: Array) -> float:
    return float(np.nansum(e**2))


def _mean_square(e: Array) -> float:
    """Of the samples that count; zero where none does."""
    return _square(e) / max(int(np.sum(~np.isnan(e))), 1)


def _is_far_less(new: Array, old: Array) -> bool:
    sums = [_square(e) for e in (new, old)]
    freedom = [degrees_of_freedom(e) for e in (new, old)]
    if not sums[0] <= FORESIGHT.left * sums[1]:
        return False
    ratio = sums[1] / max(sums[0], TINY)
    return float(f_distribution.sf(ratio, freedom[1], freedom[0])) < FORESIGHT.p


def why_much_worse(before: Fit, after: Fit, split: Split) -> Refusal:
    """Why an extension that was found under a disturbance is refused, if it is.

    The disturbance is most of the error of a simulation, with the effect or without: it may grow by
    chance, that of the fitted part by `growth_by_disturbance`, and that of what was held out by
    `GROWTH.by_chance`. Where a disturbance slower than the model counts for nothing, the simulation
    may leave what was measured.
    """
    units = before.criterion.weights
    fitted = [fitted_error(f, split, units) for f in (before, after)]
    counts = ~np.isnan(fitted[0]) & ~np.isnan(fitted[1])
    held_out = counted_by_all(*(_held_out(f, split, units) for f in (before, after)))
    most = growth_by_disturbance(fitted[0], after)
    if _grows([e[counts] for e in fitted], most):
        return Refusal("it makes the fitted error much worse", "fitted")
    if _grows(held_out, (1 + GROWTH.by_chance) ** 2):
        return Refusal("it makes the held-out error much worse", "held-out")
    return ACCEPTED


def _grows(errors: Sequence[Array], most: float) -> bool:
    """True if the sum of squares of the second errors is more than `most` times the first's."""
    old, new = map(_square, errors)
    return not new <= most * old


def fitted_error(fit: Fit, split: Split, units: Array) -> Array:
    """(M, ny) of the part that was fitted, in `units`."""
    whole = _whole_errors(fit, split, units)
    return np.concatenate([error[~held] for error, held in zip(whole, split.held, strict=True)])


def _held_out(fit: Fit, split: Split, units: Array) -> Array:
    """(M, ny) of what was held out, in `units`."""
    return np.asarray(held_out_error(fit, split) / fit.criterion.weights * units)


def why_held_out(
    before: SimulationErrors,
    after: SimulationErrors,
    *,
    is_alarm: bool = False,
    tolerance: float = 0.0,
) -> Refusal:
    """Why an extension is refused by its held-out error alone, if it is.

    Parameters
    ----------
    tolerance : by which the square of a sample's error may rise and count as the same.
    """
    before, after = on_common_samples(before, after)
    ways = [
        (before.continued, after.continued, ""),
        (before.restarted, after.restarted, " from an initial state of its own"),
    ]
    factor, grown = 1.0, ""
    for old, new, how in ways:
        worse = why_worse(old, new)
        first, last = float(np.nansum(old**2)), float(np.nansum(new**2))
        if not np.isfinite(last):
            return Refusal(worse + how, "held-out")
        if not 0.0 < last - first <= tolerance * np.isfinite(old).sum():
            factor *= last / max(first, TINY) if len(old) else 1.0
            grown = grown or (worse + how if worse else "")
    if grown and factor >= 1.0:
        return Refusal(grown, "held-out")
    # One of the two ways must show a gain that is not chance: the errors that an integrator has
    # gathered hide it in the one, an initial state that absorbs it in the other.
    whys = [why_no_better(old, new) for old, new, _ in ways]
    return ACCEPTED if is_alarm or not all(whys) else Refusal(whys[0], "held-out")
