"""The fitted model of a simulation-error fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from casid.arrays import Array
from casid.data.problem import Problem
from casid.data.reading.columns import ColumnSpec
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.fitted.parts import (
    Channels,
    FittedRecord,
    SimulationSettings,
    fingerprint,
    operating_point,
)
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model


def fitted_model(
    problem: Problem,
    fit: Fit,
    covariance: Array,
) -> FittedModel:
    """The model of a fit with its values known, and how it was simulated.

    Parameters
    ----------
    covariance : (n, n) of the variables of the criterion.
    """
    criterion = fit.criterion
    kept = [i for i, v in enumerate(criterion.variables) if not v.is_inner]
    return FittedModel(
        name=problem.name,
        model=known_model(fit),
        records=tuple(_record(criterion, fit.x, e) for e in range(len(criterion.data))),
        covariance_names=tuple(criterion.names[i] for i in kept),
        covariance=np.asarray(covariance)[np.ix_(kept, kept)],
        settings=SimulationSettings(criterion.substeps, criterion.segments, criterion.weights),
        channels=channels_of(problem),
    )


def unsimulated_model(
    name: str,
    model: Model,
    values: Mapping[str, float],
    records: Sequence[tuple[str, float, Mapping[str, float]]],
    covariance: tuple[tuple[str, ...], Array],
) -> FittedModel | None:
    """The model of an estimate that simulated nothing, from its declared initial state.

    Parameters
    ----------
    values : of the estimated parameters, SI.
    records : name, sample time [s] and known values of each.
    covariance : names, and (n, n).

    None where a parameter has no value, an input is unknown, or there is nothing to simulate.
    """
    known = {n: v for _, _, own in records for n, v in own.items()} | dict(values)
    lacking = [p for p in model.parameters.values() if not p.is_known and p.name not in known]
    unknown = [n for n, entry in model.inputs.items() if entry.kind == "unknown"]
    if lacking or unknown or not model.states or not records:
        return None
    start = [s.nominal for s in model.states.values()]
    nodes = np.array([start], dtype=float)
    own = [{n: v for n, v in case.items() if n in model.parameters} for _, _, case in records]
    return FittedModel(
        name=name,
        model=model.with_si_values({**own[0], **values}).taking_si(False),
        records=tuple(
            FittedRecord(record, Ts, 0.0, 0, case, nodes)
            for (record, Ts, _), case in zip(records, own, strict=True)
        ),
        covariance_names=covariance[0],
        covariance=covariance[1],
    )


def known_model(fit: Fit) -> Model:
    """The model of a fit, every parameter known.

    One that each record has for itself gets the mean; one known for each record alone, its value in
    the first.
    """
    criterion = fit.criterion
    model, records = criterion.model, range(len(criterion.data))
    values: dict[str, float] = {}
    for name in model.parameters:
        own = [criterion.value_of(name, fit.x, e) for e in records]
        values[name] = float(np.mean(own)) if name in criterion.own else own[0]
        if name in criterion.free and name not in criterion.own:
            # A record may know what the others estimate.
            estimated = [v for e, v in enumerate(own) if name not in criterion.data[e].known]
            values[name] = (estimated or own)[0]
    return model.with_si_values(values).taking_si(False)


def _record(criterion: SimulationError, x: Array, e: int) -> FittedRecord:
    d = criterion.data[e]
    known = dict(d.known)
    known |= {name: criterion.value_of(name, x, e) for name in criterion.own}
    nodes = [criterion.parameter_vector(x, e, i)[1] for i in range(criterion.parts(e))]
    record = criterion.experiments[e].record
    signals: dict[str, Array] = {}
    if e == 0:  # the record by which a model is linearised
        signals = dict(zip(criterion.model.inputs, d.u.T, strict=True))
        signals |= dict(zip(criterion.model.states, criterion.simulated(x, e).x.T, strict=True))
    return FittedRecord(
        d.name,
        d.Ts,
        float(d.t[0]),
        d.N,
        known,
        np.array(nodes),
        fingerprint(criterion.model, record),
        record.clock,
        operating_point(signals),
    )


def channels_of(problem: Problem) -> Channels:
    """Where a problem finds its signals."""
    time = problem.time.column if isinstance(problem.time, ColumnSpec) else problem.time
    derived = {name: entry.how or "computed" for name, entry in problem.derived.items()}
    return Channels(
        dict(problem.channels), dict(problem.recorded), derived, time or "", problem.form
    )
