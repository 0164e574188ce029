"""The fitted model of a prediction-error fit, with its noise model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.data.record import Record
from casid.errors import SolveError
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.fitted.parts import (
    FittedRecord,
    NoiseModel,
    SimulationSettings,
    fingerprint,
    operating_point,
)
from casid.estimation.prediction_error.extended_likelihood import ExtendedPredictionError
from casid.estimation.prediction_error.likelihood import PredictionError
from casid.linear.filtering.noisy_model import White

STEP = 0.1
"""Largest Runge-Kutta step over the fastest mode: the error, (w h)^4 / 120, is below 1e-6."""


def predicting_model(
    criterion: PredictionError | ExtendedPredictionError, x: Array, covariance: Array
) -> FittedModel:
    """The model at `x` (n,) with its noise, of which every size is known.

    Parameters
    ----------
    covariance : (n, n) of the variables of the criterion.

    A parameter that each record has for itself, or knows for itself, gets the value in the first.
    """
    model = criterion.model
    every = range(len(criterion.data))
    values = [criterion.parameters(x, e) for e in every]
    at = dict(zip(criterion.names, x.tolist(), strict=True))
    sources = []
    for w in criterion.noise:
        variance = at.get(criterion.places.noise_name(w), w.sd**2)
        sources.append(replace(w, sd=float(np.sqrt(max(variance, 0.0))), is_known=True))
    records = []
    for e, d in enumerate(criterion.data):
        own = {n: values[e][n] for n in values[e] if values[e][n] != values[0][n] or n in d.known}
        nodes = criterion.initial_state(x, e)[None, :]
        record = criterion.experiments[e].record
        known_by = fingerprint(criterion.places.driven, record)
        records.append(
            FittedRecord(d.name, d.Ts, float(d.t[0]), d.N, own, nodes, known_by, record.clock)
        )
    spread = np.std(np.concatenate([d.y for d in criterion.data]), axis=0)
    found = FittedModel(
        name=model.name,
        model=model.with_si_values(values[0]).taking_si(False),
        records=tuple(records),
        covariance_names=criterion.names,
        covariance=covariance,
        settings=SimulationSettings(
            _substeps(criterion, x), 1, 1 / np.where(spread > 0, spread, 1.0)
        ),
        noise=_noise_model(criterion, x, tuple(sources)),
    )
    works_at = _operating_point(found, criterion.experiments[0].record)
    first = replace(records[0], operating_point=works_at)
    return replace(found, records=(first, *records[1:]))


def _operating_point(fitted: FittedModel, record: Record) -> dict[str, float]:
    """Where the model works in a record, simulated; its inputs alone where that diverges."""
    model = fitted.model
    inputs = {n: record[n] for n in model.inputs if n in record.channels}
    try:
        run = fitted.simulate(record)
    except SolveError:
        return operating_point(inputs)
    states = {n: run[n if n not in inputs else f"{n} (state)"] for n in model.states}
    return operating_point(inputs | states)


def _noise_model(
    criterion: PredictionError | ExtendedPredictionError, x: Array, sources: tuple[White, ...]
) -> NoiseModel:
    """The noise of the first record, in numbers."""
    if isinstance(criterion, ExtendedPredictionError):
        return NoiseModel(sources, {}, criterion.initial_spread(x, 0), is_extended=True)
    rest = _numbers(criterion.noisy.rest, criterion.parameters(x, 0))
    return NoiseModel(sources, rest, criterion.initial)


def _substeps(criterion: PredictionError | ExtendedPredictionError, x: Array) -> int:
    """Runge-Kutta steps a sample: of the filter, or to make up for the exact sampling."""
    if isinstance(criterion, ExtendedPredictionError):
        return criterion.substeps
    system = criterion.sampled(x, 0).system
    if not system.nx:
        return 1
    poles = np.linalg.eigvals(system.A)
    fastest = float(np.max(np.abs(np.log(poles.astype(complex) + 1e-300))))
    return int(np.clip(np.ceil(fastest / STEP), 1, 64))


def _numbers(rest: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, float]:
    """A rest that is given in expressions of the parameters, in numbers."""
    numbers = {}
    for name, expression in rest.items():
        e = ca.SX(expression)
        symbols = ca.symvar(e)
        at = ca.Function("rest", symbols, [e])(*[values[s.name()] for s in symbols])
        numbers[name] = float(at if symbols else ca.evalf(e))
    return numbers
