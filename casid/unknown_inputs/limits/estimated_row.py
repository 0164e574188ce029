"""One row of a comparison by prediction error, its noise model no larger than the noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from casid.errors import CasidError, IdentifiabilityError
from casid.estimation.prediction_error.polynomial_orders import Orders
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.comparison import RemedyRow


def estimated_row(
    name: str,
    kind: str,
    estimate: Callable[[Orders], Asymptotics],
    orders: Orders,
    remark: str = "",
) -> RemedyRow:
    """The row of an estimator, or its refusal.

    Where C and D would cancel (the noise is simpler than they are) both orders are lowered, and a
    note says so.
    """
    note: tuple[str, ...] = ()
    while True:
        try:
            found = estimate(orders)
        except CasidError as refused:
            if not (isinstance(refused, IdentifiabilityError) and orders.nc and orders.nd):
                return RemedyRow(name, kind, None, str(refused), remark)
            orders = replace(orders, nc=orders.nc - 1, nd=orders.nd - 1)
            note = (f"the noise is simpler than asked for: nc = {orders.nc}, nd = {orders.nd}",)
        else:
            return RemedyRow(name, kind, replace(found, notes=found.notes + note), "", remark)
