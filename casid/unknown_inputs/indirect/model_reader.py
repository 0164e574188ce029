"""The direct model of a casid model: its outputs sorted into y_O and y_I."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from casid.argument_types import names_wrong_types
from casid.errors import ModelError, nearest
from casid.linear.linear_model import LinearModel, TransferMatrix, linearise
from casid.model.model import Model
from casid.unknown_inputs.indirect.direct_model import DirectModel, direct_model


@names_wrong_types(ModelError)
def direct_model_of(
    system: Model | LinearModel,
    *,
    using: Sequence[str] | str,
    unknown: Sequence[str] | str | None = None,
    outputs: Sequence[str] | str | None = None,
    values: Mapping[str, Any] | None = None,
) -> DirectModel:
    """(4.3)-(4.5) in s, every output with white noise of its own.

    Parameters
    ----------
    system : a model with unknown inputs in it (before `eliminate`), linear or linearised about
        zero, or a `LinearModel`.
    using : outputs that are to stand for the unknown inputs, y_I.
    unknown : unknown inputs, u_I; by default those that the model declares so.
    outputs : y_O; by default all outputs but those of `using`.
    values : numbers for parameters; the others stay symbols (`known` ones have their value).

    Raises
    ------
    ModelError
        If a name is wrong, no input is unknown, a parameter is called s, or fewer outputs are used
        than there are unknown inputs.
    """
    linear = linearise(system) if isinstance(system, Model) else system
    y_I, u_I = _names(using), _names(unknown)
    if unknown is None and isinstance(system, Model):
        u_I = tuple(n for n, i in system.inputs.items() if i.kind == "unknown")
    y_O = tuple(o for o in linear.outputs if o not in y_I) if outputs is None else _names(outputs)
    _require_names(linear, u_I, y_I + y_O)
    u_K = tuple(i for i in linear.inputs if i not in u_I)
    known = {**linear.known, **(values or {})}
    transfer = linear.transfer()

    def block(rows: Sequence[str], columns: Sequence[str]) -> Any:
        return [[_entry(transfer, y, u) for u in columns] for y in rows] if columns else None

    measured = (*y_O, *y_I)
    return direct_model(
        G_OK=block(y_O, u_K),
        G_OI=block(y_O, u_I),
        G_IK=block(y_I, u_K),
        G_II=block(y_I, u_I),
        H_O=[[int(a == b) for b in measured] for a in y_O],
        H_I=[[int(a == b) for b in measured] for a in y_I],
        names={
            "outputs": y_O,
            "known": u_K,
            "indirect": u_I,
            "measured_I": y_I,
            "noise": [f"noise of {n}" for n in measured],
        },
        values=known,
    )


def _names(given: Sequence[str] | str | None) -> tuple[str, ...]:
    return (given,) if isinstance(given, str) else tuple(given or ())


def _require_names(linear: LinearModel, unknown: tuple[str, ...], outputs: tuple[str, ...]) -> None:
    """Refuse names that the model does not have, no unknown input, and a parameter called s."""
    if not unknown:
        raise ModelError(
            f"{linear.name}: which input is unknown? Give unknown='...', one of "
            f"{', '.join(linear.inputs)}; an indirect model has none left"
        )
    for names, there, what in (
        (outputs, linear.outputs, "output"),
        (unknown, linear.inputs, "input"),
    ):
        for name in names:
            if name not in there:
                raise ModelError(f"{linear.name} has no {what} {name!r}{nearest(name, there)}")
    if "s" in linear.parameters:
        raise ModelError(
            f"{linear.name} has a parameter called s, which here is the symbol of differentiation; "
            "call it otherwise"
        )


def _entry(transfer: TransferMatrix, output: str, name: str) -> Any:
    """One transfer function as a CasADi expression in s."""
    import casadi as ca

    s = ca.SX.sym("s")
    above = transfer.numerators[transfer.outputs.index(output)][transfer.inputs.index(name)]
    below = transfer.denominator
    return _value(above, s) / _value(below, s)


def _value(polynomial: Any, s: Any) -> Any:
    import casadi as ca

    value = ca.SX(0)
    for k in range(int(polynomial.numel())):
        value = value * s + polynomial[k]
    return value
