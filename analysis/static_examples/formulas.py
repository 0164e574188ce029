"""The closed forms of Linder (2017), (3.10)-(3.63), corrected, each as the thesis has it.

Corrections: s = l2 + lu where (3.56)-(3.59) print l2; (3.48) is for a first stage that is known,
with an estimated one lu becomes le; (3.63) is the 2 x 2 covariance of (bK, bU).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import sympy as sp

from casid.unknown_inputs.limits.regression import FirstStage, Regression

Expr = Any

alpha, beta, bK, bU = sp.symbols("alpha beta bK bU")
l1, l2, lu, lO, le = sp.symbols("l1 l2 lu lO le")
a1, a2 = sp.symbols("a1 a2")
s = l2 + lu
TRUTH: Mapping[str, Expr] = {"bK": bK, "bU": bU}
_x = 1 / (l1 + beta**2 * lu)
_turn = (alpha * beta - 1) ** 2


@dataclass(frozen=True, slots=True)
class ClosedForm:
    """One example: what is regressed, and what the thesis says comes out.

    Attributes
    ----------
    limit : coefficient -> expression.
    covariance : (row, column) -> expression of N Cov; only what the thesis gives.
    special : symbol -> value that the formula is for (beta = 0).
    """

    example: str
    equations: str
    regression: Regression
    limit: Mapping[str, Expr]
    covariance: Mapping[tuple[str, str], Expr]
    special: Mapping[str, int] = field(default_factory=dict)


def _sym(names: tuple[str, ...], rows: list[list[Expr]]) -> dict[tuple[str, str], Expr]:
    return {(n, m): rows[i][j] for i, n in enumerate(names) for j, m in enumerate(names)}


_BOTH = ("bK", "bU")
_K: dict[str, Any] = {"bK": "u_K"}
_STAGE = FirstStage("y_U", ["delta1", "delta2"])
_KNOWN_STAGE = FirstStage("y_U", ["delta1", "delta2"], is_known=True)
_ZERO = {"beta": 0}
_shape = [[alpha**2 / l2 + 1 / l1, -alpha / l2], [-alpha / l2, 1 / l2]]
_D = l1 * l2 + _turn * l1 * lu + beta**2 * l2 * lu
_S = alpha**2 * l1 + l2
_c = _turn * bU**2 * l1 * lu
_hit = s * le * bU**2 + s * lO + le * lO


def _scaled(factor: Expr) -> dict[tuple[str, str], Expr]:
    return _sym(_BOTH, [[factor * e for e in row] for row in _shape])


def _with(generated: FirstStage) -> Regression:
    return Regression("y_O", {**_K, "bU": "predicted"}, generated={"predicted": generated})


_ATTENUATED = {"bK": bK + alpha * le / (s + le) * bU, "bU": bU - le / (s + le) * bU}
_ATTENUATED_COVARIANCE = _sym(_BOTH, [
    [bU**2 * s / l1 * le * (alpha**2 * l1 + s + le) / (s + le) ** 2
     + lO * (alpha**2 / (s + le) + 1 / l1), -alpha * _hit / (s + le) ** 2],
    [-alpha * _hit / (s + le) ** 2, _hit / (s + le) ** 2]])  # fmt: skip
"""(3.55)-(3.56): least squares with a noisy regressor is biased towards zero."""

FORMS: tuple[ClosedForm, ...] = (
    ClosedForm(
        "3.1 both inputs known", "(3.10)", Regression("y_O", {**_K, "bU": "u_U"}), TRUTH,
        _sym(_BOTH, [[lO / _D * (alpha**2 * l1 + l2 + lu), lO / _D * (-alpha * l1 - beta * lu)],
                     [lO / _D * (-alpha * l1 - beta * lu), lO / _D * (l1 + beta**2 * lu)]]),
    ),
    ClosedForm(
        "3.1 both inputs known, beta = 0", "(3.11)", Regression("y_O", {**_K, "bU": "u_U"}), TRUTH,
        _sym(_BOTH, [[lO * (alpha**2 / s + 1 / l1), -lO * alpha / s], [-lO * alpha / s, lO / s]]),
        _ZERO,
    ),
    ClosedForm(
        "3.3 neglect, LS", "(3.17)-(3.18)", Regression("y_O", _K),
        {"bK": bK + (alpha * l1 + beta * lu) * _x * bU},
        {("bK", "bK"): (bU**2 * l2 + lO) * _x + _turn * bU**2 * l1 * lu * _x**2},
    ),
    ClosedForm(
        "3.3 neglect, IV", "(3.19)-(3.20)", Regression("y_O", _K, ["delta1"]),
        {"bK": bK + alpha * bU}, {("bK", "bK"): (lO + bU**2 * (l2 + _turn * lu)) / l1},
    ),
    ClosedForm(
        "3.5 approximate by a1 delta1 + a2 delta2", "(3.29)-(3.30)",
        Regression("y_O", {**_K, "bU": "u_hat"}),
        {"bK": bK + (alpha - a1 / a2) * bU, "bU": bU / a2},
        {k: (lO + bU**2 * lu) * v for k, v in _sym(_BOTH, [
            [a1**2 / (a2**2 * l2) + 1 / l1, -a1 / (a2**2 * l2)],
            [-a1 / (a2**2 * l2), 1 / (a2**2 * l2)]]).items()},
        _ZERO,
    ),
    ClosedForm(
        "3.6 explain by delta2", "(3.33)-(3.34)", Regression("y_O", {**_K, "b2": "delta2"}),
        {"bK": bK + (alpha * l1 + beta * lu) * _x * bU, "b2": bU},
        _sym(("bK", "b2"), [[lO * _x + _c * _x**2, 0], [0, lO / l2 + _c * _x / l2]]),
    ),
    ClosedForm(
        "3.6 explain by delta1, delta2", "(3.36)-(3.37)",
        Regression("y_O", {**_K, "b1": "delta1", "b2": "delta2"}),
        {"bK": bK + bU / beta, "b1": (alpha - 1 / beta) * bU, "b2": bU},
        _sym(("bK", "b1", "b2"), [
            [lO / (beta**2 * lu), -lO / (beta**2 * lu), 0],
            [-lO / (beta**2 * lu), lO / l1 + lO / (beta**2 * lu), 0],
            [0, 0, lO / l2]]),
    ),
    ClosedForm(
        "3.8 first stage", "(3.46)", Regression("y_U", {"g1": "delta1", "g2": "delta2"}),
        {"g1": alpha, "g2": sp.Integer(1)},
        _sym(("g1", "g2"), [[(le + lu) / l1, 0], [0, (le + lu) / l2]]),
    ),
    ClosedForm(
        "3.8 two stages, first known, beta = 0", "(3.48)", _with(_KNOWN_STAGE), TRUTH,
        _scaled(lO + bU**2 * lu), _ZERO,
    ),
    ClosedForm(
        "3.8 two stages, first estimated, beta = 0", "(3.48) corrected", _with(_STAGE), TRUTH,
        _scaled(lO + bU**2 * le), _ZERO,
    ),
    ClosedForm(
        "3.8 two stages, first known", "(3.49)-(3.50)", _with(_KNOWN_STAGE),
        {"bK": bK + beta * lu * _S / (l1 * l2 + beta**2 * lu * _S) * bU},
        {("bK", "bK"): (l1 * l2 * (lO + bU**2 * lu) * _S + beta**2 * lO * lu * _S**2)
                       / (beta**2 * lu * _S + l1 * l2) ** 2},
    ),
    ClosedForm(
        "3.9 errors in variables, LS", "(3.55)-(3.56) corrected",
        Regression("y_O", {**_K, "bU": "y_U"}),
        _ATTENUATED, _ATTENUATED_COVARIANCE, _ZERO,
    ),
    ClosedForm(
        "3.10 errors in variables, IV", "(3.63)",
        Regression("y_O", {**_K, "bU": "y_U"}, ["delta1", "delta1 + delta2"]), TRUTH,
        _scaled(lO + bU**2 * le),
    ),
    ClosedForm(
        "4.2 eliminated with y_I, LS", "(4.36) as (3.55)-(3.56)",
        Regression("y_O", {**_K, "bU": "u_I"}),
        _ATTENUATED, _ATTENUATED_COVARIANCE, _ZERO,
    ),
    ClosedForm(
        "4.2 eliminated with y_I, IV", "(4.36) as (3.63)",
        Regression("y_O", {**_K, "bU": "u_I"}, ["delta1", "delta1 + delta2"]), TRUTH,
        _scaled(lO + bU**2 * le),
    ),
)  # fmt: skip
"""Every estimator of Examples 3.1-3.10 and 4.2."""


def variance_boundary(s_value: Expr, values: Mapping[str, float]) -> Expr:
    """The le at which EIV and neglecting have one variance, the equality of (3.58), s not l2."""
    C1 = values["alpha"] ** 2 * values["lO"] * values["l1"]
    C2 = values["bU"] ** 2
    C3 = values["alpha"] ** 2 * values["bU"] ** 2 * values["l1"]
    return -(C1 * s_value - C2 * s_value**3) / (C1 + C3 * s_value - C2 * s_value**2)
