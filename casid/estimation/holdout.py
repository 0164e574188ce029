"""Held-out data: the end of a record, or records of their own, simulated and never fitted."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.errors import DataError
from casid.estimation.covariance import bartlett_lags, long_run_covariance
from casid.estimation.estimate import RecordView
from casid.estimation.simulation.initial_state import fit_initial_state
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import (
    Signals,
    clock_inputs,
    off_the_clock,
    signals_of,
    window_cuts,
)
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model
from casid.model.quantities import growth_text, percent_text

LEAST_HELD_OUT = 0.2
"""Share of a record of which half is still worth to be held out."""


LEAST_MEASURED = 0.5
"""Of the share held out, of the measured samples, at least: fewer judge an extension too weakly."""


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Simulated and measured signals of what was held out of one record."""

    name: str
    t: Array  # (M,)
    measured: Array  # (M, ny), NaN where not used
    simulated: Array  # (M, ny)
    error: Array  # (M, ny), over the relative size of the noise, NaN where not used


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Records as fitted, and what is held out of them."""

    fitted: list[Experiment]
    whole: list[Experiment]  # the same records to their end
    held: list[Array]  # (N,) bool, held-out samples of each whole record
    apart: list[Experiment]  # records held out as a whole
    stated: frozenset[str] = frozenset()  # inputs on the clock that the problem itself has

    @property
    def is_empty(self) -> bool:
        """True if nothing is held out."""
        return not self.apart and not any(bool(m.any()) for m in self.held)

    def mask(self, channel: str, masks: Sequence[Array], apart: Sequence[Array]) -> Split:
        """Mark samples of one channel as missing, in fitted and held-out parts alike."""

        def marked(e: Experiment, mask: Array) -> Experiment:
            if not mask.any():
                return e
            return replace(e, record=e.record.mark_missing(channel, mask))

        whole = [marked(e, m) for e, m in zip(self.whole, masks, strict=True)]
        fitted = [marked(f, m[: f.record.N]) for f, m in zip(self.fitted, masks, strict=True)]
        apart_too = [marked(e, m) for e, m in zip(self.apart, apart, strict=True)]
        return replace(self, fitted=fitted, whole=whole, apart=apart_too)

    def judges(self, model: Model, experiment: Experiment) -> bool:
        """Whether a record held out as a whole shows how wrong a model is.

        One on another clock than the records fitted does not where the model has found a step, a
        drift or a phase on theirs: whether that acts there, nothing says.
        """
        found = set(clock_inputs(model)) - self.stated
        return not found or shares_clock(experiment, self.whole)

    def judging(self, model: Model) -> Split:
        """Itself with those records held out as a whole that judge a model."""
        return replace(self, apart=[e for e in self.apart if self.judges(model, e)])


def shares_clock(experiment: Experiment, others: Sequence[Experiment]) -> bool:
    """True of a record on the clock of another one: both are windows of one record or file."""
    return any(e.record.clock == experiment.record.clock for e in others)


def split_records(
    experiments: Sequence[Experiment], hold_out: float | Sequence[Experiment]
) -> Split:
    """Hold out the last share of each record, or whole records of their own.

    Raises
    ------
    DataError
        For a share that leaves too little to fit.
    """
    if not isinstance(hold_out, int | float):
        none = [np.zeros(e.record.N, dtype=bool) for e in experiments]
        return Split(list(experiments), list(experiments), none, list(hold_out))
    if not 0 <= hold_out < 0.9:
        raise DataError(
            f"a held-out share of {hold_out:g} leaves too little to fit; use 0 to 0.9, for example "
            "0.3, or hold out whole records"
        )
    sizes = [e.record.N for e in experiments]
    return _split_at(experiments, [n - int(round(hold_out * n)) for n in sizes])


def _split_at(experiments: Sequence[Experiment], kept: Sequence[int]) -> Split:
    """Hold out all but the first `kept` samples of each record."""
    fitted, masks = [], []
    for e, keep in zip(experiments, kept, strict=True):
        r = e.record
        masks.append(np.arange(r.N) >= keep)
        if keep < r.N:
            part = r.between(r.t0, r.t0 + (keep - 0.5) * r.Ts)
            fitted.append(replace(e, record=replace(part, name=r.name)))
        else:
            fitted.append(e)
    return Split(fitted, list(experiments), masks, [])


def holding_out_measured(split: Split, outputs: Sequence[str]) -> tuple[Split, str]:
    """Hold out the last share of the samples at which an output was measured.

    The end of a record in which a sensor was off, or stood still, judges nothing. Records of which
    a usual share is measured there stay as they are. The second is a note, empty where all do.
    """
    kept, notes = [], []
    for e, held in zip(split.whole, split.held, strict=True):
        measured = ~np.all([e.record.is_missing(name) for name in outputs], axis=0)
        kept.append(int((~held).sum()))
        total, share = int(measured.sum()), float(held.mean())
        if measured[held].sum() < LEAST_MEASURED * share * total:
            last = int(np.flatnonzero(measured)[-1])
            first = np.flatnonzero(measured)[total - max(int(round(share * total)), 1)]
            kept[-1] = int(first)
            notes.append(
                f"{e.name}: little is measured in its last {100 * share:.0f} %: what is held out "
                f"begins at t = {e.record.t[first]:.6g} s, and the last sample is that at "
                f"t = {e.record.t[last]:.6g} s"
            )
    if not notes:
        return split, ""
    return _split_again(split, _split_at(split.whole, kept)), "; ".join(notes)


def holding_out_less(split: Split) -> Split:
    """Half as much of the end of each record held out, or nothing where that was little.

    Records that are held out as a whole stay so.
    """
    share = max((float(np.mean(held)) for held in split.held), default=0.0)
    share = share / 2 if share > LEAST_HELD_OUT else 0.0
    return _split_again(split, split_records(split.whole, share))


def _split_again(split: Split, ends: Split) -> Split:
    """A split with other ends held out."""
    return replace(split, fitted=ends.fitted, whole=ends.whole, held=ends.held)


def whole_simulation(fit: Fit, split: Split, index: int) -> tuple[Signals, Array, Array]:
    """A fitted record simulated to its end: signals, outputs (N, ny), states (N, nx).

    The end of a record of an unstable model, fitted in segments or windows, is simulated
    `in_windows`.
    """
    d = signals_of(fit.criterion.model, split.whole[index])
    with np.errstate(all="ignore"):
        y, x, _ = fit.criterion.simulate(fit.x, index, signals=d)
    held = split.held[index]
    if fit.criterion.parts(index) > 1 and held.any():
        end = end_in_windows(fit, split.whole[index], int(np.argmax(held)))
        _, y[held], x[held] = _simulated(*end)
    return d, y, x


@functools.lru_cache(maxsize=16)
def end_in_windows(fit: Fit, whole: Experiment, first: int) -> tuple[SimulationError, Array]:
    """A fitted record from sample `first` to its end, `in_windows`.

    Kept for the last fits, each of which needs it several times: for the whole record, for the end
    simulated by itself, and for figures.
    """
    tail = replace(whole, record=_tail(whole.record, first), name="")
    return in_windows(fit, tail)


def in_windows(fit: Fit, experiment: Experiment) -> tuple[SimulationError, Array]:
    """A record that was not fitted, window by window as long as a segment of the fit.

    Each begins in a state estimated from the window alone. Over a longer time a simulation of an
    unstable model diverges from the record whatever the parameters are.

    Returns
    -------
    Its criterion, of which initial states are the variables, and their estimates.
    """
    model, windowed = fit.criterion.model, replace(experiment, window=window_length(fit))
    nowhere = dict.fromkeys(model.states, np.nan)
    return _states_apart(fit, windowed, near=nowhere)


def window_length(fit: Fit) -> int:
    """Samples of a segment or window of the fit."""
    criterion = fit.criterion
    return max(*(d.N // criterion.parts(e) for e, d in enumerate(criterion.data)), 2)


def restarts(fit: Fit, split: Split) -> list[Array]:
    """Samples at which the simulation of every record restarts; separate records come last."""
    criterion, window, out = fit.criterion, window_length(fit), []
    for e, held in enumerate(split.held):
        starts = criterion.starts_anew(e)
        if len(starts) and held.any():
            first, n = int(np.argmax(held)), int(held.sum())
            tail = first + window_cuts(n, window)[:-1]
            starts = np.concatenate([starts, tail])
        out.append(starts)
    is_cut = any(len(starts) for starts in out)
    none = np.zeros(0, dtype=int)
    apart = [window_cuts(e.record.N, window)[1:-1] if is_cut else none for e in split.apart]
    return [*out, *apart]


def simulate_apart(
    fit: Fit,
    experiment: Experiment,
    *,
    near: Mapping[str, float] | None = None,
) -> tuple[Signals, Array, Array]:
    """Simulate a record that was not fitted, `begun_apart`: signals, outputs (N, ny), states."""
    return _simulated(*begun_apart(fit, experiment, near=near))


def begun_apart(
    fit: Fit,
    experiment: Experiment,
    *,
    near: Mapping[str, float] | None = None,
) -> tuple[SimulationError, Array]:
    """The criterion of a record that was not fitted, its initial state estimated and nothing else.

    A step at an instant of the records fitted acts in it where it is on their clock, as the end of
    one of them is (`shares_clock`): in another it is zero.

    Parameters
    ----------
    near : of such an end the state that the simulation of the whole record has there. The search
        may begin at it, and what the model says of the state that records begin in says nothing.
    """
    if has_windows(fit):
        return in_windows(fit, experiment)
    return _states_apart(fit, experiment, near=near)


def has_windows(fit: Fit) -> bool:
    """True of a fit in segments or windows."""
    return any(fit.criterion.parts(e) > 1 for e in range(len(fit.criterion.data)))


def _simulated(criterion: SimulationError, point: Array) -> tuple[Signals, Array, Array]:
    """The one record of a criterion: signals, outputs (N, ny), states (N, nx)."""
    y, x, _ = criterion.simulate(point, 0)
    return criterion.data[0], y, x


def _states_apart(
    fit: Fit, experiment: Experiment, *, near: Mapping[str, float] | None
) -> tuple[SimulationError, Array]:
    old = fit.criterion
    known = {n: fit.values[n] for n in old.free if n in fit.values}
    for n in old.own:
        values = [v for k, v in fit.values.items() if k.startswith(f"{n}@")]
        known.setdefault(n, float(np.mean(values)) if values else fit.values.get(n, 0.0))
    model = old.model.with_known(**known)
    if not shares_clock(experiment, old.experiments):
        model = off_the_clock(model)
    if near is not None:
        model, near = _begun_midway(model, near)
    return fit_initial_state(
        model, experiment, weights=old.weights, substeps=old.substeps, near=near
    )


def _begun_midway(
    model: Model, state: Mapping[str, float]
) -> tuple[Model, Mapping[str, float] | None]:
    """A copy whose record begins in the midst of the motion, in no state that the model states.

    The second is `state` within the bounds of states, or None where the simulation had diverged.
    """
    new = model.copy()
    for name, entry in model.states.items():
        new.states[name] = replace(entry, initial=None)
    if not np.all(np.isfinite(list(state.values()))):
        return new, None
    entries = new.states
    return new, {n: float(np.clip(v, entries[n].lower, entries[n].upper)) for n, v in state.items()}


def validation(fit: Fit, split: Split) -> list[HeldOut]:
    """Measured and simulated signals of everything held out."""
    out = []
    for i, mask in enumerate(split.held):
        if mask.any():
            d, y, _ = whole_simulation(fit, split, i)
            out.append(_held_out(split.whole[i].name, d, y, mask))
    for e in split.apart:
        d, y, _ = simulate_apart(fit, e)
        out.append(_held_out(e.name, d, y, np.ones(d.N, dtype=bool)))
    return out


def _held_out(name: str, d: Signals, simulated: Array, mask: Array) -> HeldOut:
    measured, error = (np.where(d.used, a, np.nan) for a in (d.y, d.errors(simulated)))
    return HeldOut(name, d.t[mask], measured[mask], simulated[mask], error[mask])


def error_per_window(fit: Fit, error: Array) -> Array:
    """Errors (N, ny) of windows with what the initial state of each takes of them given back.

    It is estimated from the window alone, where n samples leave n - k parts in n of the noise's
    power to k states: of two models that with more states would predict better by that alone.
    """
    cuts = window_cuts(len(error), window_length(fit))
    out, states = error.copy(), len(fit.criterion.model.states)
    for first, last in zip(cuts[:-1], cuts[1:], strict=True):
        there = int(np.sum(np.isfinite(error[first:last])))
        if there > states:
            out[first:last] *= np.sqrt(there / (there - states))
    return out


def held_out_error(fit: Fit, split: Split, *, anew: bool = False) -> Array:
    """(M, ny) held-out errors in the criterion's weighted units, NaN where not used.

    With `anew` the held-out end of a record starts from an initial state of its own, as a record
    held out does: a simulation that runs on gathers the errors of an integrator. Errors in windows
    are as large as if their initial states were known (`error_per_window`).
    """
    weights = fit.criterion.weights
    parts = []
    for i, (e, mask) in enumerate(zip(split.whole, split.held, strict=True)):
        if anew and mask.any():
            first = int(np.argmax(mask))
            if has_windows(fit):  # each begins in a state of its own
                d, y, _ = _simulated(*end_in_windows(fit, e, first))
            else:
                there = whole_simulation(fit, split, i)[2][first]
                near = dict(zip(fit.criterion.model.states, there.tolist(), strict=False))
                tail = replace(e, record=_tail(e.record, first))
                d, y, _ = simulate_apart(fit, tail, near=near)
            parts.append(np.where(d.used, d.errors(y), np.nan) * weights)
    if not anew:
        parts += [h.error * weights for h in validation(fit, replace(split, apart=[]))]
    parts += errors_apart(fit, split, lambda e: _error_apart(fit, e) * weights)
    if has_windows(fit):
        parts = [error_per_window(fit, error) for error in parts]
    return np.concatenate(parts) if parts else np.zeros((0, len(fit.criterion.outputs)))


def errors_apart(fit: Fit, split: Split, error_of: Callable[[Experiment], Array]) -> list[Array]:
    """(N, ny) of every record held out as a whole; NaN in one that does not judge the model."""
    model = fit.criterion.model
    return [error_of(e) if split.judges(model, e) else _no_error(fit, e) for e in split.apart]


def _error_apart(fit: Fit, experiment: Experiment) -> Array:
    """(N, ny) errors of a record simulated from the initial state that fits it best."""
    d, y, _ = simulate_apart(fit, experiment)
    return np.where(d.used, d.errors(y), np.nan)


def _no_error(fit: Fit, experiment: Experiment) -> Array:
    """(N, ny) NaN: no sample of the record counts."""
    used = signals_of(fit.criterion.model, experiment).used
    return np.full(used.shape, np.nan)


def counted_by_all(*errors: Array) -> list[Array]:
    """Errors (M, ny) of several models, NaN wherever those of one are."""
    counts = np.all([~np.isnan(e) for e in errors], axis=0)
    return [np.where(counts, e, np.nan) for e in errors]


def _tail(record: Record, first: int) -> Record:
    start = record.t0 + (first - 0.5) * record.Ts
    return record.between(start, np.inf)


def why_no_better(before: Array, after: Array) -> str:
    """Why an extension is refused by what was held out, or an empty text.

    The fall of the squared error must not be chance: Diebold and Mariano's (1995) test at 20 %,
    unless it is larger than a tenth.
    """
    before, after = counted_by_all(before, after)
    if np.all(np.isnan(before)):
        return ""
    difference = np.nansum(before**2 - after**2, axis=1)
    if not np.all(np.isfinite(difference)):
        return "its simulation diverges on the held-out data"
    old, new = float(np.nansum(before**2)), float(np.nansum(after**2))
    if new >= old:
        return "it does not improve the held-out error"
    lags = bartlett_lags(difference[:, None])
    sd = float(np.sqrt(long_run_covariance(difference[:, None], lags)[0, 0]))
    p = 0.5 * math.erfc((old - new) / sd / math.sqrt(2.0)) if sd > 0 else 0.0
    if p > 0.2 and new > 0.9 * old:
        better = 100 * (1 - np.sqrt(new / old))
        return f"its held-out improvement of {percent_text(better)} may be chance"
    return ""


def degrees_of_freedom(error: Array) -> float:
    """Degrees of freedom of a sum of squares of correlated errors (M, ny): two per spectral line.

    (sum P)^2 / sum P^2 lines P of the periodogram (Blackman and Tukey 1958, section 23); for white
    errors, by the scatter of P, half of what there are.
    """
    power = np.abs(np.fft.rfft(np.nan_to_num(error), axis=0)) ** 2
    square = float(np.sum(power**2))
    return max(2 * float(power.sum()) ** 2 / square, 1.0) if square > 0 else math.inf


def why_worse(before: Array, after: Array) -> str:
    """Why an extension is refused by what was held out, or an empty text: it makes it worse."""
    before, after = counted_by_all(before, after)
    if np.all(np.isnan(before)):
        return ""
    old, new = float(np.nansum(before**2)), float(np.nansum(after**2))
    if not np.isfinite(new):
        return "its simulation diverges on the held-out data"
    if new > old:
        return f"it makes the held-out error worse, {growth_text(float(np.sqrt(new / old)))}"
    return ""


def measured_readings(signals: Signals, experiment: Experiment, outputs: Sequence[str]) -> Array:
    """(N, ny) readings, those that do not count as they were recorded; NaN where there is none."""
    record, joined = experiment.record, experiment.joined
    if record.N != signals.N or any(name not in record.names for name in outputs):
        return np.where(signals.used, signals.y, np.nan)
    recorded = [np.where(joined.get(n, False), np.nan, record[n]) for n in outputs]
    return np.where(signals.used, signals.y, np.column_stack(recorded))


def record_views(base: Fit, extended: Fit | None, split: Split) -> tuple[RecordView, ...]:
    """Measured and simulated signals of every record, fitted ones first, for figures."""
    best = extended or base
    model = base.criterion.model
    out = []
    for e in range(len(split.whole) + len(split.apart)):
        apart = e >= len(split.whole)
        experiment = split.apart[e - len(split.whole)] if apart else split.whole[e]
        before = simulate_apart(base, experiment) if apart else whole_simulation(base, split, e)
        after = before
        if extended is not None:
            after = (
                simulate_apart(extended, experiment)
                if apart
                else whole_simulation(extended, split, e)
            )
        d, y, _ = before
        out.append(
            RecordView(
                name=experiment.name,
                t=d.t,
                outputs=base.criterion.outputs,
                output_units=tuple(unit for _, unit in model.outputs.values()),
                measured=measured_readings(d, experiment, base.criterion.outputs),
                used=d.used,
                fitted=np.zeros(d.N, dtype=bool) if apart else ~split.held[e],
                baseline=y,
                extended=after[1] if extended is not None else None,
                inputs=tuple(model.inputs),
                input_units=tuple(u.unit for u in model.inputs.values()),
                u=d.u,
                states=tuple(model.states),
                state_units=tuple(s.unit for s in model.states.values()),
                x=after[2][:, : len(best.criterion.model.states)],
            )
        )
    return tuple(out)
