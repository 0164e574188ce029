"""Validation by simulation from the external reference, on data that were not fitted.

The estimated model is driven by the reference alone, nothing measured is fed back:

    [y_O; a_s]_hat = G_direct(q, theta_hat) F_delta(q) delta,                                   (1)

(7.55) of Linder (2017) with the sign of the external signal put right: -a_y, so that the simulated
signals carry the sign of the measured ones. A one-step prediction can look perfect where this does
not; a wrong F_delta shows here, while an estimate by instrumental variables does not mind it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.errors import DataError, SolveError, UnknownNameError
from casid.estimation.moments.instruments.instruments import (
    Instruments,
    Loop,
    UnstableLoop,
    reference_signals,
    transient,
)
from casid.model.model import Model
from casid.presentation import Presented, present


@dataclass(frozen=True, slots=True, eq=False)
class ChannelValidation:
    """One channel, measured and simulated, both without their means.

    Attributes
    ----------
    fit : NRMSE fit 100 (1 - |y - yhat| / |y - mean y|), per cent.
    period, period_error : median time between measured peaks [s], and its relative error.
    peak_error, peak_spread : mean and standard deviation of the relative error of matched peaks.
    peaks : pairs of peaks matched.
    """

    record: str
    channel: str
    unit: str
    fit: float
    rmse: float
    period: float
    period_error: float
    peak_error: float
    peak_spread: float
    peaks: int


@dataclass(frozen=True, slots=True, eq=False)
class Validation(Presented):
    """How well the model simulates every channel from the external reference."""

    channels: tuple[ChannelValidation, ...]
    t: Mapping[str, Array]  # record -> (N,) s
    measured: Mapping[str, Mapping[str, Array]]  # record -> channel -> (N,)
    simulated: Mapping[str, Mapping[str, Array]]

    def __getitem__(self, key: tuple[str, str]) -> ChannelValidation:
        """The entry of (record, channel)."""
        for c in self.channels:
            if (c.record, c.channel) == key:
                return c
        raise UnknownNameError(
            f"no {key}; there are {[(c.record, c.channel) for c in self.channels]}"
        )

    def plot(self, *, seconds: float = 20.0) -> Any:
        """Measured and simulated channels over the first `seconds` of every record (Fig. 7.14)."""
        return present(self, "figure", seconds=seconds)

    def __repr__(self) -> str:
        fits = ", ".join(f"{c.record} {c.channel} {c.fit:.1f} %" for c in self.channels)
        return f"<Validation {fits}>"


@names_wrong_types()
def validate(
    model: Model,
    values: Mapping[str, float],
    experiments: Sequence[Experiment] | Experiment,
    instruments: Instruments,
    *,
    method: str = "bilinear",
) -> Validation:
    """Simulate (1) on records that were not fitted, and compare every measured channel.

    Parameters
    ----------
    model : the indirect model; `values` of all its parameters in their units, the records' load
        cases win.
    experiments : records that were not fitted, each with its load case.
    instruments : names the reference and F_delta; its lags do not matter here.
    method : ``"bilinear"`` is the loop that the estimate was made with; ``"foh"`` samples the
        continuous system exactly where the reference runs straight between samples. With few
        samples a period (50 Hz at 13 rad/s) the bilinear map alone can cost a quarter of the fit:
        compare both before blaming the model.

    Raises
    ------
    SolveError
        If the simulated loop is unstable at these values.
    DataError
        If the record lacks a channel, or is shorter than the model's transient.
    """
    if isinstance(experiments, Experiment):
        experiments = [experiments]
    loops: dict[float, Loop] = {}
    out: list[ChannelValidation] = []
    times: dict[str, Array] = {}
    measured: dict[str, dict[str, Array]] = {}
    simulated: dict[str, dict[str, Array]] = {}
    for e in experiments:
        record = e.record
        if record.Ts not in loops:
            loops[record.Ts] = Loop(model, record.Ts, method)
        loop = loops[record.Ts]
        at = model.in_si({**values, **e.known})
        drives = reference_signals(
            instruments, loop.direct, {n: record[n] for n in record.names}, record.Ts, e.name
        )
        try:
            denominator, _ = loop.coefficients(at)
            found = loop.driven(drives, at)
        except UnstableLoop as unstable:
            raise SolveError(
                f"{e.name}: the loop is unstable at these values ({unstable}), so it cannot be "
                "simulated from the reference; check the signs of the parameters, or bound them"
            ) from None
        skip = transient(np.roots(denominator))
        if skip > record.N // 2:
            raise DataError(
                f"{e.name}: {record.N} samples, and the model needs {skip} to forget its start; "
                "give a longer record"
            )
        times[e.name] = np.asarray(record.t[skip:])
        measured[e.name], simulated[e.name] = {}, {}
        for channel in loop.channels:
            if channel not in record.names:
                continue
            y, z = record[channel][skip:], found[channel][skip:]
            y, z = y - y.mean(), z - z.mean()
            measured[e.name][channel], simulated[e.name][channel] = y, z
            out.append(_compare(e.name, channel, record.units[channel], y, z, record.Ts))
    return Validation(tuple(out), times, measured, simulated)


def _compare(
    record: str, channel: str, unit: str, y: Array, z: Array, Ts: float
) -> ChannelValidation:
    from scipy.signal import find_peaks

    spread = float(np.std(y)) or 1.0
    own, _ = find_peaks(y, prominence=spread)
    other, _ = find_peaks(z, prominence=spread)
    period = float(np.median(np.diff(own))) if len(own) > 1 else float("nan")
    simulated_period = float(np.median(np.diff(other))) if len(other) > 1 else float("nan")
    errors = []
    if len(other) and np.isfinite(period):
        for k in own:
            near = other[np.argmin(np.abs(other - k))]
            if abs(int(near) - int(k)) <= period / 4 and y[k] > 0:
                errors.append(z[near] / y[k] - 1)
    return ChannelValidation(
        record=record,
        channel=channel,
        unit=unit,
        fit=float(100 * (1 - np.linalg.norm(y - z) / max(float(np.linalg.norm(y)), TINY))),
        rmse=float(np.sqrt(np.mean((y - z) ** 2))),
        period=period * Ts,
        period_error=simulated_period / period - 1,
        peak_error=float(np.mean(errors)) if errors else float("nan"),
        peak_spread=float(np.std(errors)) if errors else float("nan"),
        peaks=len(errors),
    )
