"""Systems with unknown inputs from what a user has: casid models, python-control objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError, nearest
from casid.linear.linear_model import LinearModel, linearise
from casid.model.model import Model
from casid.unknown_inputs.observers.unknown_input_system import UnknownInputSystem


def unknown_input_system(
    system: Any,
    unknown: Sequence[str] | str | None = None,
    *,
    values: Mapping[str, float] | None = None,
    outputs: Sequence[str] | None = None,
) -> UnknownInputSystem:
    """System (1) from a casid Model or LinearModel, or a python-control system.

    Parameters
    ----------
    system : a `Model` (linear, or linearised about zero), a `LinearModel`, a
        ``control.StateSpace`` with named inputs, or an `UnknownInputSystem`, which is returned.
    unknown : names of the unknown inputs; those of a `Model` that are declared so by default.
    values : parameter -> value, for parameters of a Model that are not known.
    outputs : those that are measured; all by default.

    Raises
    ------
    ModelError
        If a name is wrong, no input is unknown, an unknown parameter has no value, or the model
        rests elsewhere than at zero.
    """
    if isinstance(system, UnknownInputSystem):
        return system
    chosen = None if unknown is None else (unknown,) if isinstance(unknown, str) else tuple(unknown)
    if isinstance(system, Model):
        holds = {n: i.hold for n, i in system.inputs.items()}
        units = system.symbol_units | {n: unit for n, (_, unit) in system.outputs.items()}
        if chosen is None:
            chosen = tuple(n for n, i in system.inputs.items() if i.kind == "unknown")
        return _from_linear(linearise(system), chosen, values, outputs, units, holds)
    if isinstance(system, LinearModel):
        return _from_linear(system, chosen, values, outputs, {}, {})
    return _from_control(system, chosen, outputs)


def _from_linear(
    linear: LinearModel,
    unknown: tuple[str, ...] | None,
    values: Mapping[str, float] | None,
    outputs: Sequence[str] | None,
    units: Mapping[str, str],
    holds: Mapping[str, str],
) -> UnknownInputSystem:
    import casadi as ca

    A, B, C, D = linear.matrices(values)
    rest = ca.Function("rest", [linear.p], [ca.vertcat(*linear.equilibrium.values())])
    at = np.array(rest(linear.vector(values))).ravel()
    away = [n for n, v in zip(linear.equilibrium, at, strict=True) if v != 0]
    if away:
        raise ModelError(
            f"{linear.name}: {', '.join(away)} are not zero at rest; subtract the value there from "
            "the channel, and leave the constant out of the model"
        )
    names = (linear.states, linear.inputs, linear.outputs)
    given = _Given(linear.name, (A, B, C, D), *names, units=units, holds=holds)
    return given.split(unknown, outputs)


def _from_control(
    system: Any, unknown: tuple[str, ...] | None, outputs: Sequence[str] | None
) -> UnknownInputSystem:
    import control

    if isinstance(system, control.TransferFunction):
        raise ModelError(
            "a transfer function names no states; give a realisation, control.ss(system), with "
            "inputs=[...] and outputs=[...]"
        )
    if not isinstance(system, control.StateSpace):
        raise ModelError(
            f"a {type(system).__name__} is no linear system; give a casid Model, a LinearModel or "
            "a control.StateSpace with named inputs"
        )
    if system.dt is True:
        raise ModelError(
            f"{system.name}: discrete without a sample time; give dt in seconds, "
            "control.StateSpace(A, B, C, D, 0.01)"
        )
    names = (tuple(system.state_labels), tuple(system.input_labels), tuple(system.output_labels))
    matrices = (system.A, system.B, system.C, system.D)
    given = _Given(str(system.name), matrices, *names, Ts=float(system.dt or 0.0))
    return given.split(unknown, outputs)


@dataclass(frozen=True, slots=True, eq=False)
class _Given:
    """A state space with all inputs together."""

    name: str
    matrices: tuple[Array, Array, Array, Array]
    states: Sequence[str]
    inputs: Sequence[str]
    outputs: Sequence[str]
    Ts: float = 0.0
    units: Mapping[str, str] = field(default_factory=dict)
    holds: Mapping[str, str] = field(default_factory=dict)

    def split(
        self, unknown: tuple[str, ...] | None, outputs: Sequence[str] | None
    ) -> UnknownInputSystem:
        """Columns of the inputs sorted into known and unknown ones, rows of the outputs chosen."""
        if not unknown:
            raise ModelError(
                f"{self.name}: which input is unknown? Give unknown='...', one of "
                f"{', '.join(self.inputs)}"
            )
        kept = tuple(self.outputs if outputs is None else outputs)
        for wanted, there, what in (
            (unknown, self.inputs, "input"),
            (kept, self.outputs, "output"),
        ):
            for one in wanted:
                if one not in there:
                    raise ModelError(f"{self.name} has no {what} {one!r}{nearest(one, there)}")
        A, B, C, D = self.matrices
        known = tuple(i for i in self.inputs if i not in unknown)
        k, u = ([list(self.inputs).index(i) for i in group] for group in (known, unknown))
        rows = [list(self.outputs).index(o) for o in kept]
        return UnknownInputSystem(
            A,
            B[:, k],
            B[:, u],
            C[rows],
            D[rows][:, k],
            D[rows][:, u],
            self.Ts,
            tuple(self.states),
            known,
            unknown,
            kept,
            dict(self.units),
            {n: v for n, v in self.holds.items() if n in known},
            self.name,
        )
