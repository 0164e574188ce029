"""Which columns and channels a diagnosis reads: the model's own and those recorded beside it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.sampling import own_rate
from casid.diagnosis.thresholds import SUFFICIENCY
from casid.errors import DataError


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
                "merge it from a file of its own (casid.align), to have it tested"
            )
    return _without_recorded(problem, set(gone)), tuple(gone.values())


def rate_of(empty: Array) -> int | None:
    """k, where a value is given in every k-th row alone (give or take one); None otherwise."""
    return own_rate(empty, least=SUFFICIENCY.clock_gaps, share=SUFFICIENCY.clock_share)


def _without_recorded(problem: Problem, names: Collection[str]) -> Problem:
    kept = {n: unit for n, unit in problem.recorded.items() if n not in names}
    channels = {n: c for n, c in problem.channels.items() if n not in names}
    return replace(problem, recorded=kept, channels=channels)


def channels_held_out_too(
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
            f"{name} was not tested as a cause: {where} it; record it there, or hold out a share "
            "of the fitted records (--hold-out 0.3)"
        )
    return kept, tuple(notes)


def with_unused_columns(problem: Problem, experiments: Sequence[Experiment]) -> Problem:
    """The problem with the unused columns of its files among the channels recorded beside."""
    found = {
        name: (e.record.units[name], column)
        for e in experiments
        for name, column in e.unused.items()
        if name in e.record and name not in problem.recorded
    }
    if not found:
        return problem
    return replace(
        problem,
        recorded={**problem.recorded, **{name: unit for name, (unit, _) in found.items()}},
        channels={**problem.channels, **{name: column for name, (_, column) in found.items()}},
    )


def varying_channels(problem: Problem, experiments: Sequence[Experiment]) -> dict[str, str]:
    """Recorded channels outside the model that every record has, complete, and that vary.

    Left out is one with the name of a symbol of the model (an eliminated input, a state): the model
    contains that signal already.
    """
    used = {*problem.model.inputs, *problem.model.outputs}
    out = {}
    for name, unit in problem.recorded.items():
        is_own = name in used or problem.model.free_name(name) != name
        if is_own or not all(name in e.record.channels for e in experiments):
            continue
        complete = all(not np.any(e.record.is_missing(name)) for e in experiments)
        if complete and any(np.ptp(e.record[name]) > 0 for e in experiments):
            out[name] = unit
    return out
