"""One output of one record as a regression: its difference equation, its signals, what is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.errors import DataError, ModelError
from casid.estimation.simulation.records.input_gaps import recorded_inputs
from casid.estimation.simulation.records.signals import Signals, signals_of
from casid.linear.sampled.difference_equation import DifferenceEquation, difference_equation
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One output of one record: its difference equation, its signals, what is known of it."""

    record: str
    equation: DifferenceEquation
    values: Mapping[str, float]  # every parameter of the model; free ones at their start
    known: frozenset[str]  # known for this record whatever is estimated: its load case
    signals: Mapping[str, Array]  # channels of the equation, (N,), SI
    channels: Mapping[str, Array]  # everything recorded, (N,)
    Ts: float
    # Sums of the signals' own products, and their means: write nothing over the samples while the
    # part lives.
    kept: dict[int, Array] = field(default_factory=dict, init=False, repr=False)
    kept_means: dict[int, Array] = field(default_factory=dict, init=False, repr=False)

    @property
    def name(self) -> str:
        """Record and output."""
        return f"{self.record}/{self.equation.output}"


def parts_of(
    model: Model,
    experiments: Sequence[Experiment],
    *,
    method: str = "bilinear",
    outputs: Sequence[str] | None = None,
    equations: dict[tuple[str, float], DifferenceEquation] | None = None,
) -> list[Part]:
    """Every output of every record as a regression, each with its own sample time.

    Parameters
    ----------
    outputs : of the model that are used; default all.
    equations : those derived before, by output and sample time, for use again.

    Raises
    ------
    DataError
        If a channel is missing or has missing samples, or a load case names no parameter.
    ModelError
        If the model cannot be linearised.
    """
    chosen = tuple(model.outputs) if outputs is None else tuple(outputs)
    _refuse_names(model, experiments, chosen)
    found = {} if equations is None else equations
    parts = []
    for e in experiments:
        for name in e.known:
            model.parameter_named(name)
        d = signals_of(model, e)
        _refuse_gaps(model, e, d)
        signals = {n: d.u[:, j] for j, n in enumerate(model.inputs)}
        signals |= {n: d.y[:, i] for i, n in enumerate(model.outputs)}
        values = model.nominal_values
        values.update(d.known)
        for output in chosen:
            key = (output, d.Ts)
            if key not in found:
                found[key] = difference_equation(model, output, d.Ts, method=method)
            equation = found[key]
            used = {c for col in (equation.left, *equation.columns) for c, _, _ in col.taps}
            parts.append(
                Part(
                    e.name,
                    equation,
                    values,
                    frozenset(d.known),
                    {n: np.ascontiguousarray(signals[n]) for n in used},
                    {n: np.asarray(e.record[n]) for n in e.record.names},
                    d.Ts,
                )
            )
    return parts


def _refuse_gaps(model: Model, experiment: Experiment, d: Signals) -> None:
    """A difference equation takes samples that follow one another, of outputs and inputs alike."""
    gone = ~d.used.all(axis=1)
    for name in recorded_inputs(model, experiment.record):
        gone |= experiment.record.missing[name]
    if gone.any():
        raise DataError(
            f"{experiment.name}: samples are missing, the first at t = {d.t[np.argmax(gone)]:g} s, "
            "and a difference equation needs all of them; cut the record there (record.between), "
            "fit the simulation error, which takes records with gaps (--method simulation), or "
            "interpolate: an uneven clock with --resample, samples that are lost with record.filled"
        )


def _refuse_names(model: Model, experiments: Sequence[Experiment], outputs: Sequence[str]) -> None:
    """Refuse no records, records of one name, and outputs that the model does not have."""
    if not experiments:
        raise DataError("no record given; name at least one")
    names = [e.name for e in experiments]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise DataError(
            f"two records are called {twice[0]!r}; give the experiments names of their own"
        )
    for output in outputs:
        if output not in model.outputs:
            raise ModelError(
                f"{model.name} has no output {output!r}; it has {', '.join(model.outputs)}"
            )
