"""Remedies for unknown inputs of dynamic modules, estimated by prediction error.

The remedies of `casid.asymptotics.remedies` that a prediction-error method has: neglect the input,
approximate it, take its measurement for it, or eliminate it. The noise model and the other modules
take up what they can of the input that is left out, and the limits show how much.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from casid.asymptotics.comparison import Comparison, RemedyRow
from casid.asymptotics.input_measurement import InputMeasurement
from casid.asymptotics.linear_signals import LinearSignals
from casid.asymptotics.prediction_limit import prediction_error_limit
from casid.errors import IdentifiabilityError, ModelError, SolveError
from casid.prediction.polynomial_orders import Layout, Orders, PerInput
from casid.solving.nlp import Solver


def compare_module_remedies(
    system: LinearSignals,
    output: str,
    inputs: Sequence[str],
    unknown: str | Sequence[str],
    orders: Orders,
    truth: Mapping[str, float],
    *,
    approximations: Mapping[str, str] | None = None,
    measured: Mapping[str, str] | InputMeasurement | None = None,
    eliminated: Mapping[str, str] | None = None,
    N: float = 1000,
    accuracy: Mapping[str, float] | None = None,
    solver: Solver | None = None,
) -> Comparison:
    """Compare remedies for A y = sum (B_i/F_i) u_i + (C/D) e with some of the inputs unknown.

    Parameters
    ----------
    inputs : all inputs of the true relation, unknown ones among them.
    orders : of all inputs; where an input is neglected its module is left out. Where C and D
        would cancel (the noise is simpler), both orders are lowered, and a note says so.
    truth : coefficient -> true value, by the names of the structure: "b1[u_U]", "f1[u_U]". A
        noise model is part of the structure; its coefficients need no truth.
    approximations, measured, eliminated, N, accuracy : as in `compare_remedies`.

    Raises
    ------
    ModelError
        If a signal or coefficient is not there.
    IdentifiabilityError
        If the input measurement cannot recover the inputs.
    """
    asked = [unknown] if isinstance(unknown, str) else list(unknown)
    lost = [name for name in asked if name not in inputs]
    if lost:
        raise ModelError(f"unknown input {lost[0]} is no input; they are {', '.join(inputs)}")
    for name in truth:
        if name not in Layout.of(orders, inputs).names:
            raise ModelError(
                f"truth of {name}: no coefficient of this structure; it has "
                f"{', '.join(Layout.of(orders, inputs).names)}"
            )
    if isinstance(measured, InputMeasurement):
        system, measured = measured.recover(system)
    tried: list[tuple[str, str, dict[str, str]]] = [
        ("all inputs known", "known", {name: name for name in inputs}),
        ("neglect", "neglect", {name: name for name in inputs if name not in asked}),
    ]
    for verb, kind, by in (
        ("approximate by", "approximate", approximations),
        ("measure", "measure", measured),
        ("eliminate with", "eliminate", eliminated),
    ):
        if by:
            wrong = [name for name in by if name not in asked]
            if wrong:
                raise ModelError(
                    f"{by[wrong[0]]} is given for {wrong[0]}, which is no unknown input; these are "
                    f"{', '.join(asked)}"
                )
            here = {name: by.get(name, name) for name in inputs if name in by or name not in asked}
            left = [name for name in asked if name not in by]
            told = ", ".join(by.values()) + (f" and neglect {', '.join(left)}" if left else "")
            tried.append((f"{verb} {told}", kind, here))
    rows = []
    for name, kind, sources in tried:
        own = _restricted(orders, tuple(sources))
        there = Layout.of(own, list(sources)).names
        true = {n: v for n, v in truth.items() if n in there}
        rows.append(_row(f"{name}, PEM", kind, system, output, sources, own, true, solver))
    return Comparison(tuple(rows), tuple(truth), tuple(asked), N, dict(accuracy or {}))


def _row(
    name: str,
    kind: str,
    system: LinearSignals,
    output: str,
    sources: Mapping[str, str],
    orders: Orders,
    truth: Mapping[str, float],
    solver: Solver | None,
) -> RemedyRow:
    """One remedy; a noise model that is larger than the noise is made smaller."""
    note: tuple[str, ...] = ()
    while True:
        try:
            found = prediction_error_limit(
                system, output, sources, orders, truth, solver=solver, method=name
            )
        except (IdentifiabilityError, SolveError) as refused:
            if not (isinstance(refused, IdentifiabilityError) and orders.nc and orders.nd):
                return RemedyRow(name, kind, None, str(refused))
            orders = replace(orders, nc=orders.nc - 1, nd=orders.nd - 1)
            note = (f"the noise is simpler than asked for: nc = {orders.nc}, nd = {orders.nd}",)
        else:
            return RemedyRow(name, kind, replace(found, notes=found.notes + note))


def _restricted(orders: Orders, inputs: Sequence[str]) -> Orders:
    """The orders of these inputs alone."""

    def own(order: PerInput) -> PerInput:
        if not isinstance(order, Mapping):
            return order if inputs else 0
        return {name: value for name, value in order.items() if name in inputs} or 0

    return replace(orders, nb=own(orders.nb), nf=own(orders.nf), nk=own(orders.nk))
