"""The direct method: prediction error of a polynomial model on the measured inputs (ls)."""

from __future__ import annotations

from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.estimation import prediction_error
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders
from casid.unknown_inputs.networks.estimation.module_data import ModuleData
from casid.unknown_inputs.networks.estimation.module_fit import ModuleFit


def direct(data: ModuleData, orders: Orders, solver: Solver | None = None) -> ModuleFit:
    """Least squares where the orders are ARX, else the NLP of the prediction-error criterion.

    (2.36)-(2.39) of Linder (2017), with the sandwich covariance (2.54)-(2.56).

    Raises
    ------
    DataError, IdentifiabilityError, SolveError
        As `casid.estimation.prediction_error.polynomial.estimation.prediction_error`.
    """
    model = prediction_error(
        data.y, data.inputs, orders, Ts=data.Ts, errors="robust", solver=solver
    )
    return ModuleFit(
        Layout.of(orders, tuple(data.inputs)),
        model.theta,
        model.covariance,
        model.assumes,
        model.notes,
        {"prediction": f"{model.structure}, fit {model.fit:.1f} % one step ahead"},
    )
