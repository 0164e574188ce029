"""Joint input-output: responses of output and inputs to the references, and their quotient.

    w_j = T_j delta + .. ,  w_D = T_D delta + .. ,  T_j = sum_k G_jk T_k                       (1)

Both sides are estimated as impulse responses, in open loop and so consistently; (1) is then
solved for parametric G by an output-error fit in which each reference is a record that begins at
rest, impulse responses of inputs in, that of the output out.
"""

from __future__ import annotations

import numpy as np

from casid.arrays import Array
from casid.estimation.covariance import bartlett_lags, long_run_covariance
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.criterion import PredictionErrors
from casid.estimation.prediction_error.polynomial.estimation import prediction_error
from casid.estimation.prediction_error.polynomial.notes import offsets
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders
from casid.unknown_inputs.networks.estimation.module_data import ModuleData
from casid.unknown_inputs.networks.estimation.module_fit import ModuleFit, without_noise
from casid.unknown_inputs.networks.estimation.reference_responses import (
    ReferenceResponses,
    settled_responses,
)

OUTPUT = "output"
ASSUMES = (
    "references independent of all disturbances, disturbances of short memory; the fit of the "
    "responses is linearised at the estimate"
)


def joint(
    data: ModuleData, orders: Orders, lags: int | None, solver: Solver | None = None
) -> ModuleFit:
    """Estimate the modules as what turns the inputs' responses into the output's.

    Parameters
    ----------
    orders : C and D are not used.
    lags : of the impulse responses, as `settled_responses`.

    Raises
    ------
    DataError, IdentifiabilityError, SolveError
        As `reference_responses` and `prediction_error`.
    """
    nodes = {n: x for n, x in data.inputs.items() if n not in data.references}
    found = settled_responses({OUTPUT: data.y, **nodes}, data.references, lags, data.name)
    lags = found.lags
    # Responses in units of one standard deviation of their reference: as far as that is white,
    # their errors are then alike.
    size = [float(np.std(x)) for x in data.references.values()]
    plain = without_noise(orders)
    layout = Layout.of(plain, tuple(data.inputs))
    rest = np.zeros(layout.longest_lag + max(layout.nf, default=0))  # samples at rest before t = 0
    records, outputs = [], []
    for r, (reference, s) in enumerate(zip(found.references, size, strict=True)):
        impulse = {
            n: s * (np.arange(lags) == 0) * float(n == reference)
            for n in data.inputs
            if n not in nodes
        }
        own = {n: s * found.h[n][r] for n in nodes} | impulse
        records.append({n: np.concatenate([rest, own[n]]) for n in data.inputs})
        outputs.append(np.concatenate([rest, s * found.h[OUTPUT][r]]))
    model = prediction_error(outputs, records, plain, Ts=data.Ts, discard=0, solver=solver)
    of_means = offsets(
        list(zip(outputs, records, strict=True))
    )  # a response has no mean to take off
    notes = [n for n in model.notes if n not in of_means]
    if late := found.unsettled():
        names = ", ".join(late)
        notes.append(
            f"the response of {names} to the references has not died out after {lags} samples; "
            "where these are not white that biases it: raise lags="
        )
    # Linearised: theta_hat - theta = -H^-1 sum psi d eps, d eps = A dh_j - sum (B/F) dh_k.
    criterion = PredictionErrors(layout, list(zip(outputs, records, strict=True)), [0] * len(size))
    psi, _ = criterion.jacobian(model.theta)
    parts = psi.reshape(len(size), len(rest) + lags, layout.n)
    scores = _scores(found, layout, model.theta, parts, np.array(size))
    change = np.linalg.solve(psi.T @ psi, scores.T).T
    return ModuleFit(
        layout,
        model.theta,
        long_run_covariance(change, bartlett_lags(change)),
        ASSUMES,
        tuple(notes),
        {"responses": f"{lags} lags of {', '.join(found.references)}; fit {model.fit:.1f} %"},
    )


def _scores(
    found: ReferenceResponses, layout: Layout, theta: Array, psi: Array, size: Array
) -> Array:
    """Sum psi d eps of every sample of the record, (N, n).

    Parameters
    ----------
    psi : (references, samples at rest and lags, n) gradient of the prediction errors.
    size : (references,) standard deviations of the references.
    """
    from scipy.signal import lfilter

    p = layout.split(theta)
    filters: dict[str, tuple[Array, Array]] = {OUTPUT: (p.A, np.ones(1))}
    for n, b, f in zip(layout.inputs, p.B, p.F, strict=True):
        if n in found.residuals:
            filters[n] = (-b, f)
    scores = np.zeros((len(found.Z), layout.n))
    rest = psi.shape[1] - found.lags
    for signal, (above, below) in filters.items():
        # psi' times the Toeplitz matrix of the filter is the filter run backwards in time.
        back = lfilter(above, below, psi[:, ::-1], axis=1)[:, ::-1][:, rest:]
        weights = back * size[:, None, None]
        moved = found.influence(weights.reshape(-1, layout.n).T)
        scores += moved * found.residuals[signal][:, None]
    return scores
