"""What a record cannot support: settings that contradict, and data that hold no answer.

What a user can mend in the call is refused with an error. A record that is read without fault and
yet says nothing (no excitation, noise alone, too few samples) is no error: its verdict is
"undecided", with the reason in words.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import correlate
from scipy.stats import norm

from casid.arrays import TINY, Array
from casid.data.problem import Problem
from casid.data.record import Experiment
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.errors import DataError
from casid.estimation.covariance import whiteness
from casid.estimation.fit_statistics import rms
from casid.estimation.holdout import Split
from casid.estimation.nlp.nlp import Solver
from casid.estimation.noise import NoiseModel, Response
from casid.estimation.simulation.minimization import Fit, minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.effect import KINDS
from casid.model.effects.user_effects import user_effects
from casid.model.model import Model

PER_UNKNOWN = 10
"""Samples that every unknown must have at least (a heuristic)."""

_MAD = 1.4826  # median absolute deviation of normal noise -> its standard deviation


# -- the call -------------------------------------------------------------------------------------


def require_settings(
    problem: Problem, false_alarm_rate: float, max_causes: int, without: Collection[str]
) -> None:
    """Refuse settings of a diagnosis that mean nothing.

    Raises
    ------
    DataError
        For a rate outside (0, 1), fewer causes than one, or a kind that there is none of.
    """
    if not 0.0 < false_alarm_rate < 1.0:
        raise DataError(
            f"false_alarm_rate = {false_alarm_rate:g} is no rate between 0 and 1; give the share "
            "of adequate models that may be called deficient, for example 0.05 "
            "(--false-alarm-rate 0.05)"
        )
    if max_causes < 1:
        raise DataError(
            f"max_causes = {max_causes}: the search looks for one cause at least; give 1 or more "
            "(--max-causes 4)"
        )
    if isinstance(without, str):
        raise DataError(
            f"without = {without!r} is one text; give kinds in a list, without=[{without!r}]"
        )
    kinds = sorted(KINDS | {e.kind for e in user_effects(problem.model, problem.effects)})
    for kind in without:
        if kind not in kinds:
            near = difflib.get_close_matches(kind, kinds, 1)
            raise DataError(
                f"without {kind!r}: there is no such kind"
                + (f"; did you mean {near[0]!r}?" if near else "")
                + f" There are {', '.join(kinds)}"
            )


def refuse_shared_columns(
    problem: Problem, mapping: Mapping[str, str], columns: Sequence[str], time: str | None
) -> Problem:
    """Refuse channels that a file's columns cannot all be; the problem that is left to read.

    A channel recorded beside the model's whose own column is mapped to another channel is left out:
    it would be the same signal once more.

    Parameters
    ----------
    mapping : what the user maps, signal -> column.
    columns : of the file.
    time : its column of time stamps.

    Raises
    ------
    DataError
        Two channels of one column, a channel read from the time stamps, or a derived channel
        mapped beside what it is derived from.
    """
    specs = problem.columns(mapping)
    for signal in mapping:
        for name, entry in problem.derived.items():
            if signal in entry.sources and name in mapping:
                raise DataError(
                    f"--map {name} and --map {signal} contradict: {name} is computed from "
                    f"{', '.join(entry.sources)} unless it is mapped itself; keep one of them"
                )
    needed = {*problem.model.inputs, *problem.model.outputs, *mapping}
    for entry in problem.derived.values():
        needed |= set(entry.sources)
    owner: dict[str, str] = {}
    for signal, spec in specs.items():
        if signal not in needed or spec.column not in columns:
            continue  # what is not there is refused as it is read
        if spec.column == time:
            raise DataError(
                f"channel {signal} and the time stamps would both be column {spec.column!r}; map "
                f"{signal} to the column that measures it, --map {signal}=COLUMN, or name the "
                "time stamps, --map t=COLUMN"
            )
        other = owner.setdefault(spec.column, signal)
        if other != signal:
            raise DataError(
                f"channels {other} and {signal} would both be column {spec.column!r}, one signal "
                f"twice; map one of them to another column (the file holds {', '.join(columns)}), "
                f"as in --map {signal}=COLUMN"
            )
    again = {
        n for n in problem.recorded if n not in needed and n in specs and specs[n].column in owner
    }
    return _without_recorded(problem, again) if again else problem


def left_out_by_clock(
    problem: Problem, mapping: Mapping[str, str], holes: Mapping[str, Array]
) -> tuple[Problem, tuple[str, ...]]:
    """The problem without the channels beside the model's that have holes, and why they go.

    Parameters
    ----------
    holes : column -> (N,) bool, rows in which it has no value; columns without any may be absent.

    Raises
    ------
    DataError
        If a channel of the model was sampled at another rate than the record.
    """
    specs = problem.columns(mapping)
    gone: dict[str, str] = {}
    for signal, spec in specs.items():
        empty = holes.get(spec.column)
        if empty is None or not empty.any():
            continue
        step = rate_of(empty)
        at = (
            f"has a value in one row of {step} alone, so it was sampled on another clock"
            if step
            else f"is empty in {int(empty.sum())} of {empty.size} rows"
        )
        if signal in problem.recorded and signal not in mapping:
            gone[signal] = (
                f"channel {signal} was left out: column {spec.column!r} {at}; fill its rows, or "
                "merge it from a file of its own (casid.align), to have it asked"
            )
        elif step:
            raise DataError(
                f"channel {signal}: column {spec.column!r} {at}. Write it to a file of its own and "
                "merge the two (record.align(other, using=...).apply), interpolate it onto every "
                f"row, or keep the rows that have it (one in {step})"
            )
    return _without_recorded(problem, set(gone)), tuple(gone.values())


def rate_of(empty: Array) -> int | None:
    """k, where a value stands in every k-th row alone (give or take one); None otherwise."""
    steps = np.diff(np.flatnonzero(~empty))
    if steps.size < 3:
        return None
    k = int(np.median(steps))
    return k if k >= 2 and float(np.mean(np.abs(steps - k) <= 1)) > 0.95 else None


def _without_recorded(problem: Problem, names: Collection[str]) -> Problem:
    kept = {n: unit for n, unit in problem.recorded.items() if n not in names}
    channels = {n: c for n, c in problem.channels.items() if n not in names}
    return replace(problem, recorded=kept, channels=channels)


def usable_beside(
    recorded: Mapping[str, str], apart: Sequence[Experiment]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Channels beside the model's that the held-out records have as well, and why others go.

    A cause that brings a channel is judged on what is held out, which must have it, too.
    """
    kept, notes = {}, []
    for name, unit in recorded.items():
        lacking = [e.name for e in apart if name not in e.record]
        holes = [e.name for e in apart if name in e.record and e.record.is_missing(name).any()]
        if not lacking and not holes:
            kept[name] = unit
            continue
        where = f"{', '.join(lacking or holes)}, held out, {'lacks' if lacking else 'has gaps in'}"
        notes.append(
            f"{name} was not asked as a cause: {where} it; record it there, or hold out a share "
            "of the fitted records (--hold-out 0.3)"
        )
    return kept, tuple(notes)


# -- the record -----------------------------------------------------------------------------------


def why_silent(model: Model, split: Split) -> str:
    """Why the fitted part says nothing of the system, or an empty text.

    Asked before the fit, which has nothing to go by: every output stands still, or is white noise
    that no measured input has a part in. White and independent of an input, an output has
    correlations with it of variance 1/N at every lag, whatever the input's colour; a system that
    the samples resolve colours what it passes on, and its decay too.
    """
    outputs = _moving(split.fitted, model.outputs)
    if any(n not in e.record for e in split.fitted for n in (*model.outputs, *_measured(model))):
        return ""  # refused with its mend as it is fitted
    inputs = _measured(model)
    if not outputs:
        values = [float(e.record[n][0]) for e in split.fitted for n in model.outputs]
        what = "zero" if not any(values) else "constant"
        verb = "is" if len(model.outputs) == 1 else "are"
        text = f"{' and '.join(model.outputs)} {verb} {what} in every sample that is fitted"
        if _moving([*split.whole, *split.apart], model.outputs):
            return f"{text}, and {_ELSEWHERE}"
        return f"{text}: check the sensor, its cable and the mapping"
    for e in split.fitted:
        for name in model.outputs:
            if not _is_noise(e, name, inputs, len(split.fitted) * len(model.outputs)):
                return ""
    still = [n for n in inputs if not _moving(split.fitted, [n])]
    text = f"{' and '.join(outputs)}, as far as fitted, {'is' if len(outputs) == 1 else 'are'}"
    text += " noise alone: white" + (f", and without a part of {', '.join(inputs)}" * bool(inputs))
    if any(
        np.std(e.record[n][held]) > 3 * np.std(e.record[n][~held])
        for e, held in zip(split.whole, split.held, strict=True)
        if held.any()
        for n in outputs
    ):
        return f"{text}; {_ELSEWHERE}"
    return text + _check(still)


_ELSEWHERE = (
    "what moves lies in the held-out part: fit the part that moves (--window, or --hold-out 0)"
)


def _measured(model: Model) -> list[str]:
    return [n for n, u in model.inputs.items() if u.kind == "measured"]


def _moving(experiments: Sequence[Experiment], names: Iterable[str]) -> list[str]:
    """Channels that move in any of the records."""
    return [
        n
        for n in names
        if any(
            values.size > 1 and np.ptp(values) > 0.0
            for e in experiments
            if n in e.record
            for values in (e.record[n][~e.record.is_missing(n)],)
        )
    ]


def _is_noise(e: Experiment, output: str, inputs: Sequence[str], tests: int) -> bool:
    """True if an output is white and uncorrelated with every input, or stands still."""
    y = e.record[output]
    y = np.where(e.record.is_missing(output), np.nan, y - np.nanmedian(y))
    # A few outliers must neither make noise of a motion nor a motion of noise.
    y = np.clip(y, *(4 * _MAD * float(np.nanmedian(np.abs(y))) * np.array([-1.0, 1.0])))
    y = np.nan_to_num(y - np.nanmean(y))
    if y.size < 40:
        return False
    if not np.any(y):
        return True
    if whiteness(y) > 4:  # of 20 lags: P(5 or more) = 0.3 %
        return False
    lags = min(y.size // 4, 400)
    bound = float(norm.isf(0.005 / (lags * max(len(inputs), 1) * tests)))
    for name in inputs:
        u = e.record[name] - e.record[name].mean()
        if not np.any(u):
            continue
        r = correlate(y, u, mode="full", method="fft")[y.size - 1 : y.size - 1 + lags]
        size = math.sqrt(float(y @ y) * float(u @ u) / y.size)
        if float(np.max(np.abs(r))) > bound * size:
            return False
    return True


def _still_inputs(c: SimulationError) -> str:
    return _check([n for n in _measured(c.model) if not _moving(c.experiments, [n])])


def _check(still: Sequence[str]) -> str:
    return f"; {' and '.join(still)} never moves: check its cable and mapping" if still else ""


def why_undecided(fit: Fit, at: Weighted, std_error: Callable[[str], float]) -> str:
    """Why the record cannot support an answer, or an empty text.

    Parameters
    ----------
    fit, at : the model as it is, and under its noise.
    std_error : of a variable by name, robust (`refitting.std_error`).
    """
    c = fit.criterion
    few = why_too_few(c)
    if few:
        return few
    loudest = 0.0
    for e, d in enumerate(c.data):
        y = c.simulated(fit.x, e).y
        for i in range(len(c.outputs)):
            noise = float(at.noise.output_sd[i])
            loudest = max(loudest, float(np.std(y[d.used[:, i], i])) / max(noise, TINY))
    if loudest < 1.0:
        return (
            f"the simulated outputs move by {loudest:.2g} of the noise only: nothing excites the "
            f"system enough to show what the model lacks{_still_inputs(c)}"
        )
    relative = _relative_errors(at, std_error)
    if relative and min(relative.values()) > 1.0:
        return (
            f"no parameter is known to better than its own size from this record{_still_inputs(c)}"
        )
    return ""


def why_too_few(criterion: SimulationError) -> str:
    """Why the samples cannot pay for the unknowns, or an empty text."""
    n, unknowns = criterion.n_samples, len(criterion.variables)
    if n >= PER_UNKNOWN * unknowns:
        return ""
    return (
        f"{n} samples are too few to judge a model with {unknowns} unknowns; "
        f"{PER_UNKNOWN * unknowns} are the least"
    )


def weak_parameters(at: Weighted, std_error: Callable[[str], float]) -> tuple[str, ...]:
    """A note on parameters that the record does not know to better than their own size.

    The model may still be judged: what such a parameter does cannot be seen, and so cannot be
    missed either. But neither can an effect that acts as it does.
    """
    weak = [n for n, r in _relative_errors(at, std_error).items() if not r <= 1.0]
    if not weak:
        return ()
    names = " and ".join(weak)
    return (
        f"this record does not know {names} to better than {'its' if len(weak) == 1 else 'their'} "
        "own size: what is missing and acts alike cannot be seen in it either",
    )


def _relative_errors(at: Weighted, std_error: Callable[[str], float]) -> dict[str, float]:
    """Standard error over the larger of estimate and start, of every parameter."""
    c = at.fit.criterion
    out = {}
    for v, value in zip(c.variables, at.fit.x.tolist(), strict=True):
        if v.source in c.model.parameters:
            error = std_error(v.name) / max(abs(value), v.scale)
            out[v.name] = error if math.isfinite(error) else math.inf
    return out


# -- a baseline all the same ----------------------------------------------------------------------


def fit_in_vain(model: Model, experiments: Sequence[Experiment]) -> Fit:
    """A baseline for the report where nothing can be estimated: a few steps from the start."""
    criterion = SimulationError(model, experiments)
    return minimize_simulation_error(
        criterion, solver=Solver(max_iterations=3), check_rank=False, throw=False
    )


def unweighed(fit: Fit) -> Weighted:
    """The same as a `Weighted`, its residual taken for white noise."""
    c = fit.criterion
    parts = [np.where(d.used, c.simulated(fit.x, e).residual, np.nan) for e, d in enumerate(c.data)]
    sd = np.nan_to_num(rms(np.concatenate(parts)), nan=0.0, posinf=0.0)
    sources = tuple(n for n, u in c.model.inputs.items() if u.kind == "measured")
    flat = Response(np.array([0.0, math.pi]), np.zeros((2, len(sd), len(sources))), sources)
    noise = NoiseModel(
        output_sd=np.maximum(sd, TINY),
        source_sd=dict.fromkeys(sources, 0.0),
        responses=[flat] * len(c.data),
        weights=c.weights,
    )
    return Weighted(c.model, fit, noise, noise, dict.fromkeys(sources, 0.0), False)
