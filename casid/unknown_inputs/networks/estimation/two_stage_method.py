"""Two stages: inputs predicted from the references, then prediction error.

Linder (2017), section 3.5 and Example 3.8; Van den Hof & Schrama (1993). The rest of the
inputs, and the output's own disturbance, are independent of the references and so of the second
stage's regressors.
"""

from __future__ import annotations

import numpy as np

from casid.arrays import Array
from casid.estimation.covariance import bartlett_lags, long_run_covariance
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.criterion import PredictionErrors
from casid.estimation.prediction_error.polynomial.estimation import prediction_error
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders
from casid.unknown_inputs.networks.estimation.module_data import ModuleData
from casid.unknown_inputs.networks.estimation.module_fit import ModuleFit
from casid.unknown_inputs.networks.estimation.reference_responses import (
    ReferenceResponses,
    settled_responses,
)

ASSUMES = (
    "references independent of all disturbances, responses that die out within the lags, "
    "disturbances of short memory; the first stage's uncertainty is in it"
)


def two_stage(
    data: ModuleData, orders: Orders, lags: int | None, solver: Solver | None = None
) -> ModuleFit:
    """Estimate from the part of the inputs that the references make.

    Parameters
    ----------
    orders : na = 0; C and D model the remaining noise.
    lags : of the first stage's impulse responses, as `settled_responses`.

    Raises
    ------
    DataError, IdentifiabilityError, SolveError
        As `reference_responses` and `prediction_error`.
    """
    nodes = {n: x for n, x in data.inputs.items() if n not in data.references}
    first = settled_responses(nodes, data.references, lags, data.name)
    lags = first.lags
    y = data.y[lags - 1 :]
    inputs = {n: first.made_of(n) if n in nodes else x[lags - 1 :] for n, x in data.inputs.items()}
    model = prediction_error(y, inputs, orders, Ts=data.Ts, solver=solver)
    layout = Layout.of(orders, tuple(inputs))
    covariance = _covariance(first, layout, model.theta, y, inputs, model.discarded[0])
    notes = list(model.notes)
    if late := first.unsettled():
        notes.append(
            f"the response of {', '.join(late)} to the references has not died out after {lags} "
            "samples, which biases the second stage: raise lags="
        )
    shares = {n: float(np.var(first.made_of(n)) / np.var(x[lags - 1 :])) for n, x in nodes.items()}
    text = ", ".join(f"{100 * s:.0f} % of {n}" for n, s in shares.items())
    return ModuleFit(
        layout,
        model.theta,
        covariance,
        ASSUMES,
        tuple(notes),
        {"references make": f"{text} (responses of {lags} lags)"},
    )


def _covariance(
    first: ReferenceResponses,
    layout: Layout,
    theta: Array,
    y: Array,
    inputs: dict[str, Array],
    discard: int,
) -> Array:
    """Both stages' estimating equations, linearised together.

    theta_hat - theta = -H^-1 sum_t (psi_t eps_t + M dh),  dh = gram^-1 sum_t z_t r_t,  with
    psi = d eps/d theta and M = sum_t psi_t d eps_t/d h, d eps/d h_k = -(D/C)(B_k/F_k) z.
    """
    from scipy.signal import lfilter

    criterion = PredictionErrors(layout, [(y, inputs)], [discard])
    psi, eps = criterion.jacobian(theta)
    H = psi.T @ psi
    p = layout.split(theta)
    scores = np.zeros((len(y), layout.n))
    scores[discard:] = psi * eps[:, None]
    for name, b, f in zip(layout.inputs, p.B, p.F, strict=True):
        if name not in first.h:
            continue
        above, below = np.convolve(p.D, b), np.convolve(p.C, f)
        moved = -lfilter(above, below, first.Z, axis=0)[discard:]
        scores += first.influence(psi.T @ moved) * first.residuals[name][:, None]
    change = np.linalg.solve(H, scores.T).T
    return np.asarray(long_run_covariance(change, bartlett_lags(change)))
