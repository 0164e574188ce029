"""A module's equation as a linear regression with coefficients nonlinear in the parameters.

    A F_1 .. F_m w_j = sum_k B_k prod_{l != k} F_l u_k + error                                 (1)

has columns that are lags of signals alone, so that moments see it; its coefficients are products of
those of A, B_k and F_k.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from casid.estimation.prediction_error.polynomial.orders import Layout
from casid.linear.linear_model import TransferMatrix
from casid.linear.sampled.difference_equation import DifferenceEquation
from casid.linear.sampled.lagged_columns import Column


def module_regression(layout: Layout, output: str, Ts: float) -> DifferenceEquation:
    """(1) for `casid.instrumental`; its parameters are `layout.names` (no C, no D)."""
    p = ca.SX.sym("p", layout.n)
    A, B, F = _polynomials(layout, p)
    left = _product([A, *F])
    columns = [Column(f"-{output}[t-{m}]", ((output, m, -1.0),)) for m in range(1, len(left))]
    theta = list(left[1:])
    names = [f"A{m}" for m in range(1, len(left))]
    for k, (u, nk) in enumerate(zip(layout.inputs, layout.nk, strict=True)):
        b = _product([B[k], *(f for i, f in enumerate(F) if i != k)])
        columns += [Column(f"{u}[t-{nk + m}]", ((u, nk + m, 1.0),)) for m in range(len(b))]
        names += [f"B{nk + m}[{u}]" for m in range(len(b))]
        theta += b
    g = ca.Function("g", [p], [ca.vertcat(*theta)])
    transfer = TransferMatrix(
        name=output,
        denominator=ca.SX.ones(1),
        numerators=(),
        p=p,
        inputs=layout.inputs,
        outputs=(output,),
        parameters=layout.names,
    )
    return DifferenceEquation(
        name=output,
        output=output,
        inputs=layout.inputs,
        Ts=Ts,
        method="discrete",
        left=Column(f"{output}[t]", ((output, 0, 1.0),)),
        columns=tuple(columns),
        coefficients=tuple(names),
        parameters=layout.names,
        g=g,
        relations=ca.DM.zeros(0, len(names) + 1).full(),
        transfer=transfer,
        description=(),
    )


def _polynomials(layout: Layout, p: Any) -> tuple[list[Any], list[list[Any]], list[list[Any]]]:
    """A, B_k without their delay and F_k, as lists of expressions."""
    place = 0

    def take(n: int) -> list[Any]:
        nonlocal place
        place += n
        return [p[i] for i in range(place - n, place)]

    A = [ca.SX(1), *take(layout.na)]
    B = [take(n) for n in layout.nb]
    return A, B, [[ca.SX(1), *take(n)] for n in layout.nf]


def _product(polynomials: list[list[Any]]) -> list[Any]:
    out = polynomials[0]
    for other in polynomials[1:]:
        made = [ca.SX(0)] * (len(out) + len(other) - 1)
        for i, a in enumerate(out):
            for k, b in enumerate(other):
                made[i + k] = made[i + k] + a * b
        out = made
    return out
