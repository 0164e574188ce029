"""Figure 3.5 of Linder (2017) through the general machinery, for any numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from analysis.static_examples.formulas import TRUTH, variance_boundary
from casid.arrays import Array
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.decision_map import DecisionMap, decision_map
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.regression import Regression
from casid.unknown_inputs.limits.regression_limit import regression_limit
from problems.static_input import VARIANCES

UNIT = {"alpha": 1.0, "l1": 1.0, "lO": 1.0, "bU": 1.0}
"""The numbers of Figure 3.5."""


def pair() -> tuple[Asymptotics, Asymptotics]:
    """Measuring with errors and neglecting, beta = 0, symbolically; s is l2 + lu."""
    system = LinearSignals.of(
        {
            "u_K": "delta1",
            "u_U": "alpha*delta1 + delta2",
            "y_O": "bK*u_K + bU*u_U + tau_O",
            "y_U": "u_U + e_U",
        },
        {k: v for k, v in VARIANCES.items() if k != "tau_u"} | {"delta2": "s"},
    )
    measured = Regression("y_O", {"bK": "u_K", "bU": "y_U"})
    neglected = Regression("y_O", {"bK": "u_K"})
    return (
        regression_limit(system, measured, TRUTH, method="measuring with errors"),
        regression_limit(system, neglected, {"bK": TRUTH["bK"]}, method="neglecting"),
    )


def figure_3_5(
    values: Mapping[str, float], s: Array, le: Array, N: float = 1
) -> tuple[DecisionMap, Any]:
    """The map over s = l2 + lu and le for given alpha, l1, lO, bU, and its figure.

    Parameters
    ----------
    s, le : (nx,) and (ny,) values on the axes.
    N : samples of the mean square error; 1 in the thesis.
    """
    measuring, neglecting = pair()
    drawn = decision_map(
        measuring, neglecting, "bK", ("s", s), ("le", le), {**values, "bK": 0.0}, N=N
    )
    fine = np.linspace(s[0], s[-1], 2001)
    with np.errstate(divide="ignore"):
        boundary = np.array([variance_boundary(v, values) for v in fine])
    shown = np.where((boundary >= le[0]) & (boundary <= le[-1]), boundary, np.nan)
    figure = drawn.plot({"(3.58), closed form": (fine, shown)})
    figure.update_xaxes(title_text="s = l2 + lu, variance of the unknown input's own part")
    figure.update_yaxes(title_text="le, variance of its sensor's noise")
    return drawn, figure
