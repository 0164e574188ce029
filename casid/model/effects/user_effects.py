"""Effects of a user's own: a term in a balance, a parameter replaced, a channel distorted.

    Problem(..., effects=[
        balance_effect(
            "stribeck", "torque", lambda s: -s.c * s.p * casadi.exp(-((s.p / 0.1) ** 2)),
            parameter="c", unit="N m s/rad", sided="positive",
        ),
    ])

They join the catalogue beside its own: tested, refitted, ranked and named alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Required, TypedDict, Unpack

import numpy as np

from casid.argument_types import names_wrong_types
from casid.errors import ModelError
from casid.model.declarations import Input, Parameter
from casid.model.declared_units import numbers_in_si
from casid.model.effects.effect import Effect, Sided
from casid.model.model import Model
from casid.model.units import is_si

Expr = Any  # a CasADi expression
Formula = Callable[["Symbols"], Expr]
UserEffect = Effect | Callable[[Model], Effect | Sequence[Effect]]


class Symbols:
    """A model's symbols by attribute or item, the effect's own parameters by the names it gave.

    States, inputs and parameters are CasADi symbols; an output is its expression.
    """

    def __init__(self, model: Model, own: Mapping[str, str]) -> None:
        self._model, self._own = model, dict(own)

    def __getitem__(self, name: str) -> Expr:
        """The symbol called `name`."""
        if name in self._own:
            return self._model.symbol(self._own[name])
        if name in self._model.outputs:
            return self._model.outputs[name][0]
        return self._model.symbol(name)

    def __getattr__(self, name: str) -> Expr:
        if name.startswith("__"):
            raise AttributeError(name)
        return self[name]


class EffectOptions(TypedDict, total=False):
    """What sizes a user's effect, and how it is described.

    Attributes
    ----------
    parameter, unit : what the effect is sized by, and what is tested; SI unit. Default "c"; the
        unit is required.
    further : shapes (a width, an exponent) that do nothing at the null value: estimated too, or
        known where they have a value, `Parameter("width", "rad/s", value=0.5)`.
    channels : recorded channels that the model does not use but the effect does, name -> unit.
    sided : "positive" where physics allows no negative size; default "both".
    description : the effect in words, as in the report.
    """

    parameter: str
    unit: Required[str]
    further: Sequence[Parameter]
    channels: Mapping[str, str] | None
    sided: Sided
    description: str


@dataclass(frozen=True, slots=True)
class _Options:
    """`EffectOptions` with the defaults filled in."""

    unit: str
    parameter: str = "c"
    further: Sequence[Parameter] = ()
    channels: Mapping[str, str] | None = None
    sided: Sided = "both"
    description: str = ""


@names_wrong_types()
def balance_effect(
    kind: str, balance: str, term: Formula, **options: Unpack[EffectOptions]
) -> Effect:
    """A term in a balance.

    Parameters
    ----------
    kind : a name of the user's own, in lower case; it appears in `diagnosis.json`.
    term : of the symbols, in the balance's unit; zero where `parameter` is zero.
    unit : of `parameter`, the effect's size, which is tested; SI unit.
    options : parameter, the name of the size (default "c"); further, channels, sided and
        description, as in `EffectOptions`.

    Example
    -------
    >>> import casid
    >>> casid.balance_effect("quartic", "force", lambda s: -s["c"] * s["x"] ** 4, unit="N/m^4")
    <Effect quartic in force>
    """

    def change(new: Model, own: Mapping[str, str]) -> None:
        new.add_term(balance, term(Symbols(new, own)))

    return _effect(kind, balance, change, 0.0, _Options(**options))


@names_wrong_types()
def parameter_effect(
    kind: str,
    replaced: str,
    expression: Formula,
    *,
    null: float = 0.0,
    **options: Unpack[EffectOptions],
) -> Effect:
    """A parameter of the model replaced by an expression, itself where the effect is null.

    Parameters
    ----------
    kind : name of the effect, as it stands in a diagnosis.
    replaced : the parameter of the model.
    expression : of the symbols of model and effect, `s["name"]`, in SI units.
    null : value of the effect's own parameter at which the model is as it was.
    options : as in `balance_effect`.
    """

    def change(new: Model, own: Mapping[str, str]) -> None:
        new.substitute_symbol(replaced, expression(Symbols(new, own)))

    return _effect(kind, replaced, change, null, _Options(**options))


@names_wrong_types()
def channel_effect(
    kind: str,
    channel: str,
    expression: Formula,
    *,
    null: float = 0.0,
    **options: Unpack[EffectOptions],
) -> Effect:
    """A channel distorted: an output becomes an expression of itself, `s[channel]`, and more.

    Parameters
    ----------
    channel : an output, or an input: there the expression says what acts, given what was recorded,
        so that it undoes the distortion.
    kind, expression, null, options : as in `parameter_effect`.
    """

    def change(new: Model, own: Mapping[str, str]) -> None:
        """Replace the channel by the user's expression."""
        value = expression(Symbols(new, own))
        if channel in new.outputs:
            new.replace_output(channel, value, new.outputs[channel][1])
        else:
            new.substitute_symbol(channel, value)

    return _effect(kind, channel, change, null, _Options(**options))


def _effect(
    kind: str,
    where: str,
    change: Callable[[Model, Mapping[str, str]], None],
    null: float,
    o: _Options,
) -> Effect:
    """An effect that changes a model, of a size with its null value and further parameters."""
    size = Parameter(o.parameter, o.unit, null, lower=null if o.sided == "positive" else -np.inf)
    parameters = (size, *o.further)

    def apply(new: Model, names: Sequence[str]) -> None:
        for channel, unit in (o.channels or {}).items():
            new.add_input(Input(channel, unit, "known", "foh"))
        change(new, {p.name: n for p, n in zip(parameters, names, strict=True)})

    # A user's name comes before an unnamed neighbour, after the catalogue's.
    return Effect(
        kind,
        where,
        parameters,
        apply,
        sided=o.sided,
        priority=1,
        cost=sum(not p.is_known for p in parameters),
        description=o.description,
    )


def user_effects(model: Model, entries: Sequence[UserEffect]) -> list[Effect]:
    """The effects of `Problem.effects` for a model: functions called with it, lists laid out.

    Raises
    ------
    ModelError
        If an entry is neither an effect nor a function that gives one.
    """
    out: list[Effect] = []
    for entry in entries:
        made = entry(model) if callable(entry) else entry
        for effect in made if isinstance(made, list | tuple) else [made]:
            if not isinstance(effect, Effect):
                raise ModelError(
                    f"effects of {model.name}: {effect!r} is no casid.Effect, nor a function that "
                    "gives one; make one with casid.balance_effect, casid.parameter_effect or "
                    "casid.channel_effect"
                )
            out.append(_in_si(effect))
    return out


def _in_si(effect: Effect) -> Effect:
    """The effect with its parameters in SI; the units that they were declared in are kept."""
    declared = {p.name: p.unit for p in effect.parameters if not is_si(p.unit)}
    if not declared:
        return effect
    numbers = ("start", "lower", "upper", "value")
    parameters = tuple(numbers_in_si(p, numbers) for p in effect.parameters)
    return replace(effect, parameters=parameters, declared_units=declared)
