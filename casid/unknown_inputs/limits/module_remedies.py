"""Remedies for unknown inputs of dynamic modules, estimated by prediction error, IV or two stages.

The remedies of `remedy_table` for modules. The noise model and the other modules take up what they
can of an input that is left out; the limits show how much.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders, PerInput
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.comparison import Comparison, RemedyRow
from casid.unknown_inputs.limits.input_measurement import InputMeasurement
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.polynomial_regression import instrumental_limit
from casid.unknown_inputs.limits.prediction_limit import prediction_error_limit
from casid.unknown_inputs.limits.remedy_table import (
    Substitution,
    attempted_row,
    remedy_table,
    with_simpler_noise,
)
from casid.unknown_inputs.limits.two_stage_limit import two_stage_limit


@names_wrong_types(ModelError)
def compare_module_remedies(
    system: LinearSignals,
    output: str,
    inputs: Sequence[str],
    unknown: str | Sequence[str],
    orders: Orders,
    truth: Mapping[str, float],
    *,
    approximations: Mapping[str, str] | None = None,
    explain: Mapping[str, int] | None = None,
    measured: Mapping[str, str] | InputMeasurement | None = None,
    eliminated: Mapping[str, str] | None = None,
    known: Sequence[str] = (),
    N: float = 1000,
    accuracy: Mapping[str, float] | None = None,
    solver: Solver | None = None,
) -> Comparison:
    """Compare remedies for A y = sum (B_i/F_i) u_i + (C/D) e with some of the inputs unknown.

    Parameters
    ----------
    output : the measured signal y.
    inputs : all inputs of the true relation, unknown ones among them.
    orders : of all inputs; where an input is neglected its module is left out. Where C and D
        would cancel (the noise is simpler), both orders are lowered, and a note says so.
    truth : coefficient -> true value, by the names of the structure: "b1[u_U]", "f1[u_U]". A
        noise model is part of the structure; its coefficients need no truth.
    approximations, measured, eliminated, N, accuracy : as in `compare_remedies`.
    explain : known signal -> coefficients of an FIR filter, from lag 0 on, through which it stands
        in the place of the unknown inputs.
    known : references, externals of the system that are known. With them there are two more
        estimators: instrumental variables, whose instruments are the regressors as the references
        make them, for A y = sum B_i u_i (one F may be there, it is the common denominator), and
        two stages, in which the measured input is predicted from the references.
    solver : of the nonlinear minima, a `Solver`.

    Raises
    ------
    ModelError
        If a signal or coefficient is not there.
    IdentifiabilityError
        If the input measurement cannot recover the inputs.
    """
    absent = [unknown] if isinstance(unknown, str) else list(unknown)
    _require_sound(inputs, absent, Layout.of(orders, inputs).names, truth)
    if isinstance(measured, InputMeasurement):
        system, measured = measured.recover(system)
    explained = [(", ".join(explain), tuple(explain))] if explain else []
    table = remedy_table(absent, approximations, explained, measured, eliminated)
    table.sort(key=lambda row: bool(row.explained))
    task = _Task(system, output, orders, dict(truth), tuple(known), dict(explain or {}), solver)
    rows: list[RemedyRow] = []
    for row in table:
        kept = [name for name in inputs if name in row.by or name not in absent]
        rows += task.rows(row, {name: row.by.get(name, name) for name in kept})
    return Comparison(tuple(rows), tuple(truth), tuple(absent), N, dict(accuracy or {}))


def _require_sound(
    inputs: Sequence[str], unknown: Sequence[str], names: Sequence[str], truth: Mapping[str, float]
) -> None:
    """Refuse unknown inputs that are no inputs, and truths of no coefficient."""
    for name in unknown:
        if name not in inputs:
            raise ModelError(f"unknown input {name} is no input; they are {', '.join(inputs)}")
    for name in truth:
        if name not in names:
            raise ModelError(
                f"truth of {name}: no coefficient of this structure; it has {', '.join(names)}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """The arguments that all rows of the table share."""

    system: LinearSignals
    output: str
    orders: Orders
    truth: Mapping[str, float]
    known: tuple[str, ...]
    explain: Mapping[str, int]
    solver: Solver | None

    def rows(self, row: Substitution, sources: Mapping[str, str]) -> list[RemedyRow]:
        """One remedy by prediction error and, with references, IV and two stages."""
        own = _restricted(self.orders, tuple(sources))
        if row.explained:
            own, sources = self._explained(own, sources)
        true = {n: v for n, v in self.truth.items() if n in Layout.of(own, list(sources)).names}
        replaced = [n for n, signal in sources.items() if n != signal]
        first = f"predict from {row.signals}, two-stage"

        def direct(orders: Orders) -> Asymptotics:
            return prediction_error_limit(
                self.system, self.output, sources, orders, true,
                solver=self.solver, method=f"{row.name}, PEM",
            )  # fmt: skip

        def instrumental(orders: Orders) -> Asymptotics:
            return self._by_instruments(sources, orders, true, f"{row.name}, IV")

        def in_two_stages(orders: Orders) -> Asymptotics:
            return two_stage_limit(
                self.system, self.output, sources, self.known, orders, true,
                predicted=replaced, solver=self.solver, method=first,
            )  # fmt: skip

        tried = [(f"{row.name}, PEM", row.kind, direct)]
        if self.known and row.kind != "approximate":
            tried.append((f"{row.name}, IV", row.kind, instrumental))
        if self.known and row.kind == "measure":
            tried.insert(0, (first, "predict", in_two_stages))
        return [attempted_row(n, k, with_simpler_noise(e, own)) for n, k, e in tried]

    def _explained(self, own: Orders, sources: Mapping[str, str]) -> tuple[Orders, dict[str, str]]:
        """The known inputs, and FIR filters of the signals that explain."""
        nb, nf, nk = (
            {n: order[n] if isinstance(order, Mapping) else order for n in sources}
            for order in (own.nb, own.nf, own.nk)
        )
        for name, lags in self.explain.items():
            nb[name], nf[name], nk[name] = lags, 0, 0
        return replace(own, nb=nb, nf=nf, nk=nk), {**sources, **{n: n for n in self.explain}}

    def _by_instruments(
        self, sources: Mapping[str, str], orders: Orders, truth: Mapping[str, float], name: str
    ) -> Asymptotics:
        layout = Layout.of(orders, list(sources))
        with_f = [n for n, nf in zip(layout.inputs, layout.nf, strict=True) if nf]
        if len(with_f) > 1 or (with_f and (layout.na or len(sources) > 1)):
            raise ModelError(
                f"A y = sum B u is linear, with F of {', '.join(with_f)} beside other terms it is "
                "not; give na in place of nf, or a structure with one input"
            )
        linear = replace(orders, na=layout.na + sum(layout.nf), nf=0, nc=0, nd=0)
        found = instrumental_limit(self.system, self.output, sources, self.known, linear)
        # With one input, A is its F.
        names = tuple(f"f{n[1:]}[{with_f[0]}]" if with_f and n[0] == "a" else n
                      for n in found.names)  # fmt: skip
        true = {n: v for n, v in truth.items() if n in names}
        return replace(found, method=name, names=names, truth=true)


def _restricted(orders: Orders, inputs: Sequence[str]) -> Orders:
    """The orders of these inputs alone."""

    def own(order: PerInput) -> PerInput:
        if not isinstance(order, Mapping):
            return order if inputs else 0
        return {name: value for name, value in order.items() if name in inputs} or 0

    return replace(orders, nb=own(orders.nb), nf=own(orders.nf), nk=own(orders.nk))
