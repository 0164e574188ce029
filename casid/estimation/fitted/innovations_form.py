"""Predictions some samples ahead with a noise model: the Kalman predictor, and free runs from it.

    xhat[t | t-k] = A xhat[t-1 | t-k] + B u[t-1],    yhat[t | t-k] = C xhat[t | t-k] + D u[t]    (1)

from the one-step prediction xhat[t-k+1 | t-k] on; L. Ljung, System Identification, 2nd ed., 1999,
section 3.2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.estimation.fitted.parts import NoiseModel
from casid.estimation.prediction_error.disturbances import rest_of
from casid.estimation.prediction_error.extended_likelihood import ExtendedPredictionError
from casid.estimation.prediction_error.likelihood import PredictionError
from casid.linear.filtering.kalman import steady_state, time_varying
from casid.model.model import Model

NEWTON_STEPS = 8
"""Towards the initial state of a record that was not fitted; for a linear model one is enough."""


def predicted(
    model: Model,
    noise: NoiseModel,
    experiment: Experiment,
    start: Array | None,
    horizon: int,
    substeps: int = 1,
) -> Array:
    """(N, ny) outputs predicted `horizon` samples ahead by (1).

    Parameters
    ----------
    model : every parameter with its value.
    start : (nx,) initial state; None estimates it.
    substeps : Runge-Kutta steps a sample, of an extended Kalman filter.

    The first samples are predicted from the initial state: nothing was measured before.
    """
    if noise.is_extended:
        return _extended(model, noise, experiment, start, horizon, substeps)
    criterion = PredictionError(
        model,
        [experiment],
        noise.sources,
        initial=noise.initial,
        rest=_rest(model, noise),
    )
    x = _initial(criterion, start)
    at, d = criterion.sampled(x, 0), criterion.data[0]
    s = at.system
    z0 = criterion.initial_state(x, 0) - at.shift @ d.u[0] + at.lead
    # The drift of a rest away from zero is the effect of an input that is one.
    constant = replace(
        s,
        B=np.column_stack([s.B, at.drift]),
        D=np.column_stack([s.D, np.zeros(s.ny)]),
        inputs=(*s.inputs, "1"),
    )
    u = np.column_stack([d.u, np.ones(d.N)])
    if noise.initial is None:
        P0 = steady_state(s).P
    else:
        P0 = np.diag([noise.initial.get(name, 0.0) ** 2 for name in model.states])
    z = time_varying(constant, d.y - at.offset, u, x0=z0, P0=P0).x[:-1]
    driven = u @ constant.B.T
    for _ in range(min(horizon, d.N) - 1):
        z = np.vstack([z0, z[:-1] @ s.A.T + driven[:-1]])
    return np.asarray(z @ s.C.T + d.u @ s.D.T + at.offset)


def _rest(model: Model, noise: NoiseModel) -> Mapping[str, Any]:
    """The rest that a model is linearised about: of a linear one its own, in its parameters.

    In numbers it would be no rest for other parameters, or by a rounding none for these. Linear
    equations about one rest are those about another.
    """
    own = rest_of(model) if noise.rest else None
    return noise.rest if own is None else own


def _extended(
    model: Model,
    noise: NoiseModel,
    experiment: Experiment,
    start: Array | None,
    horizon: int,
    substeps: int,
) -> Array:
    """Predictions by an extended Kalman filter, and simulations from its predicted states."""
    criterion = ExtendedPredictionError(
        model, [experiment], noise.sources, initial=noise.initial, substeps=substeps
    )
    x = criterion.start
    if start is not None:
        x = _initial(criterion, start)
    else:
        for _ in range(NEWTON_STEPS):
            at = criterion.evaluate(x)
            if not np.isfinite(at.value):
                break
            x = x - np.linalg.lstsq(at.hessian, at.gradient, rcond=None)[0]
    found, d = criterion.filtered(x, 0), criterion.data[0]
    y, states = found.predicted, found.x
    values = np.array(list(criterion.parameters(x, 0).values()), dtype=float)
    for _ in range(min(horizon, d.N) - 1):
        y, states = criterion.filter_of(0).one_further(states, d.u, values)
    return np.asarray(y)


def _initial(criterion: PredictionError | ExtendedPredictionError, start: Array | None) -> Array:
    """The variables of the criterion (n,), which are initial states: given, or the best."""
    x = criterion.start
    if not len(x):
        return x
    if start is not None:
        places = list(criterion.model.states)
        return np.array([start[places.index(v.source)] for v in criterion.variables])
    first = criterion.evaluate(x)  # quadratic in the initial state: one Newton step is the minimum
    return np.asarray(x - np.linalg.lstsq(first.hessian, first.gradient, rcond=None)[0])
