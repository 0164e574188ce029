"""Outputs and inputs of polynomial models: one record or several, complete and finite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.errors import DataError


def one_record(y: ArrayLike, u: Any, inputs: Sequence[str] | None = None) -> tuple[Array, Any]:
    """y (N,) and u as a dict of (N,) arrays, float64, checked.

    Raises
    ------
    DataError
        If a shape does not fit, a sample is not finite, or inputs differ from `inputs`.
    """
    out = _numbers("y", y)
    if out.ndim != 1:
        raise DataError(
            f"y has shape {out.shape}; give one output as (N,), y[:, 0], and records as a list"
        )
    channels: dict[str, Array] = {}
    if isinstance(u, Mapping):
        channels = {str(k): _numbers(str(k), v) for k, v in u.items()}
    elif u is not None:
        array = _numbers("u", u)
        if array.ndim == 1:
            channels = {inputs[0] if inputs and len(inputs) == 1 else "u": array}
        elif array.ndim == 2:
            names = inputs or [f"u{i + 1}" for i in range(array.shape[1])]
            if array.shape[0] != len(out) or len(names) != array.shape[1]:
                raise DataError(
                    f"u has shape {array.shape} beside {len(out)} samples of y; give (N, number of "
                    "inputs) or a mapping from input to (N,)"
                )
            channels = dict(zip(names, array.T, strict=True))
        else:
            raise DataError(f"u has shape {array.shape}; give (N,), (N, nu) or a mapping")
    if inputs is not None and set(channels) != set(inputs):
        raise DataError(
            f"inputs are {', '.join(channels) or 'none'}, the model has "
            f"{', '.join(inputs) or 'none'}; give every input of the model by its name"
        )
    for name, values in [("y", out), *channels.items()]:
        if values.shape != out.shape:
            raise DataError(
                f"{name} has shape {values.shape}, y has {out.shape}; cut both to the same samples"
            )
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise DataError(
                f"{name} holds {bad.size} samples that are not finite, the first at k = {bad[0]}; "
                "cut the record there and give the parts as a list of records"
            )
    return out, channels


def _numbers(name: str, given: Any) -> Array:
    """An array of floats, or a refusal that says how to take it out of a record."""
    several = isinstance(given, list | tuple)
    if isinstance(given[0] if several and len(given) else given, Record | Experiment):
        raise DataError(
            f"{name} is {'a list of records' if several else 'a record'}; give its channels as "
            "arrays: y, u = casid.estimation.prediction_error.polynomial.records.stretches("
            "record, output, inputs) makes lists of both"
            + (" (one call for each record, the lists joined)" if several else "")
        )
    try:
        if given is None or isinstance(given, Mapping):
            raise TypeError
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise DataError(
            f"{name} is a {type(given).__name__} that holds what is no real number; give an array "
            "of floats (N,)"
        ) from None


def records_of(y: Any, u: Any) -> tuple[list[tuple[Array, dict[str, Array]]], tuple[str, ...]]:
    """(y, {input: u}) of each record, and the inputs' names.

    Raises
    ------
    DataError
        As `one_record`, or if y is a list of records and u is not one of as many.
    """
    several = isinstance(y, list | tuple) and len(y) > 0 and np.ndim(y[0]) > 0
    ys = list(y) if several else [y]
    if not several:
        us = [u]
    elif u is None:
        us = [None] * len(ys)
    elif isinstance(u, list | tuple) and len(u) == len(ys):
        us = list(u)
    else:
        raise DataError(
            f"y is a list of {len(ys)} records; give u as a list of {len(ys)} entries beside it"
        )
    data: list[tuple[Array, dict[str, Array]]] = []
    inputs: tuple[str, ...] | None = None
    for k, (one_y, one_u) in enumerate(zip(ys, us, strict=True)):
        try:
            data.append(one_record(one_y, one_u, inputs))
        except DataError as error:
            raise DataError(f"record {k + 1}: {error}" if several else str(error)) from None
        inputs = tuple(data[-1][1]) if inputs is None else inputs
    return data, inputs or ()


def stretches(
    record: Record, output: str, inputs: Sequence[str] = (), *, shortest: int = 2
) -> tuple[list[Array], list[dict[str, Array]]]:
    """y and u of a record as lists of stretches without missing samples, for `prediction_error`.

    Parameters
    ----------
    shortest : stretches with fewer samples are left out.

    Raises
    ------
    DataError
        If a channel is not there, or no stretch is left.
    """
    absent = [n for n in (output, *inputs) if n not in record.channels]
    if absent:
        raise DataError(
            f"{record.name}: no channel {', '.join(absent)}; it has {', '.join(record.channels)}. "
            "Name channels of the record"
        )
    bad = np.zeros(record.N, dtype=bool)
    for name in (output, *inputs):
        bad |= record.is_missing(name)
    edges = [-1, *np.flatnonzero(bad).tolist(), record.N]
    cuts = [slice(a + 1, b) for a, b in zip(edges, edges[1:], strict=False)]
    cuts = [c for c in cuts if c.stop - c.start >= shortest]
    if not cuts:
        raise DataError(
            f"{record.name}: no stretch of {shortest} samples without a missing one; lower "
            "`shortest`, or interpolate the gaps beforehand"
        )
    ys = [np.array(record[output][c]) for c in cuts]
    return ys, [{name: np.array(record[name][c]) for name in inputs} for c in cuts]
