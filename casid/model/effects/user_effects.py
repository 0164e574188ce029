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
from typing import Any

import numpy as np

from casid.errors import ModelError
from casid.model.effects.effect import Effect, Sided
from casid.model.model import Input, Model, Parameter

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


def balance_effect(
    kind: str,
    balance: str,
    term: Formula,
    *,
    parameter: str = "c",
    unit: str,
    further: Sequence[Parameter] = (),
    channels: Mapping[str, str] | None = None,
    sided: Sided = "both",
    description: str = "",
) -> Effect:
    """A term in a balance.

    Parameters
    ----------
    kind : a name of the user's own, in lower case; it appears in `diagnosis.json`.
    term : of the symbols, in the balance's unit; zero where `parameter` is zero.
    parameter, unit : what the effect is sized by, and what is tested; SI unit.
    further : shapes (a width, an exponent) that do nothing at the null value: estimated too, or
        known where they have a value, `Parameter("width", "rad/s", value=0.5)`.
    channels : recorded channels that the model does not use but the effect does, name -> unit.
    sided : "positive" where physics allows no negative size.
    description : the effect in words, as in the report.
    """

    def apply(new: Model, own: Mapping[str, str]) -> None:
        new.add_term(balance, term(Symbols(new, own)))

    first = _first(parameter, unit, 0.0, sided)
    return _effect(kind, balance, (first, *further), apply, channels, sided, description)


def parameter_effect(
    kind: str,
    replaced: str,
    expression: Formula,
    *,
    parameter: str = "c",
    unit: str,
    null: float = 0.0,
    further: Sequence[Parameter] = (),
    channels: Mapping[str, str] | None = None,
    sided: Sided = "both",
    description: str = "",
) -> Effect:
    """A parameter of the model replaced by an expression, itself where the effect is null.

    As `balance_effect`; `null` is the value of `parameter` at which the model is as it was.
    """

    def apply(new: Model, own: Mapping[str, str]) -> None:
        new.substitute_symbol(replaced, expression(Symbols(new, own)))

    first = _first(parameter, unit, null, sided)
    return _effect(kind, replaced, (first, *further), apply, channels, sided, description)


def channel_effect(
    kind: str,
    channel: str,
    expression: Formula,
    *,
    parameter: str = "c",
    unit: str,
    null: float = 0.0,
    further: Sequence[Parameter] = (),
    channels: Mapping[str, str] | None = None,
    sided: Sided = "both",
    description: str = "",
) -> Effect:
    """A channel distorted: an output becomes an expression of itself, `s[channel]`, and more.

    For an input the expression says what acts, given what was recorded: the distortion undone. As
    `parameter_effect` otherwise.
    """

    def apply(new: Model, own: Mapping[str, str]) -> None:
        value = expression(Symbols(new, own))
        if channel in new.outputs:
            new.replace_output(channel, value, new.outputs[channel][1])
        else:
            new.substitute_symbol(channel, value)

    first = _first(parameter, unit, null, sided)
    return _effect(kind, channel, (first, *further), apply, channels, sided, description)


def _first(name: str, unit: str, null: float, sided: Sided) -> Parameter:
    return Parameter(name, unit, null, lower=null if sided == "positive" else -np.inf)


def _effect(
    kind: str,
    where: str,
    parameters: tuple[Parameter, ...],
    change: Callable[[Model, Mapping[str, str]], None],
    channels: Mapping[str, str] | None,
    sided: Sided,
    description: str,
) -> Effect:
    def apply(new: Model, names: Sequence[str]) -> None:
        for channel, unit in (channels or {}).items():
            new.add_input(Input(channel, unit, "known", "foh"))
        change(new, {p.name: n for p, n in zip(parameters, names, strict=True)})

    # A user's name comes before an unnamed neighbour, after the catalogue's.
    return Effect(
        kind,
        where,
        parameters,
        apply,
        sided=sided,
        priority=1,
        cost=sum(not p.is_known for p in parameters),
        description=description,
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
            out.append(effect)
    return out
