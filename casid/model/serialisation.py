"""A model as values and one text: its expressions in CasADi's own serialisation, symbols shared."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi as ca

from casid.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Mapping

State = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Place:
    """Where an expression stood: its number among those in the text."""

    number: int


def packed(attributes: Mapping[str, Any]) -> tuple[State, str]:
    """Attributes with a `Place` for every SX expression in them, and the text of the expressions.

    Dictionaries, lists, tuples and dataclasses are searched.
    """
    expressions: list[Any] = []
    state = {name: _packed(value, expressions) for name, value in attributes.items()}
    serializer = ca.StringSerializer()
    serializer.pack(expressions or [ca.SX(0)])
    return state, str(serializer.encode())


def unpacked(state: Mapping[str, Any], text: str) -> State:
    """The attributes again, with expressions of symbols of their own, shared as they were.

    Raises
    ------
    DataError
        If CasADi cannot read the text: it is damaged, or from a later version of CasADi.
    """
    expressions = expressions_of(text)
    return {name: _unpacked(value, expressions) for name, value in state.items()}


def expressions_of(text: str) -> list[Any]:
    """The SX expressions in a text.

    Raises
    ------
    DataError
        As `unpacked`.
    """
    try:
        return list(ca.StringDeserializer(text).unpack())
    except Exception as error:
        reason, version = str(error).splitlines()[0], ca.CasadiMeta.version()
        raise DataError(
            f"the expressions of the model cannot be read by CasADi {version} ({reason}); save the "
            "result again, or install the version of CasADi that saved it"
        ) from error


def _packed(value: Any, expressions: list[Any]) -> Any:
    if isinstance(value, ca.SX):
        expressions.append(value)
        return Place(len(expressions) - 1)
    return _walked(value, lambda part: _packed(part, expressions))


def _unpacked(value: Any, expressions: list[Any]) -> Any:
    if isinstance(value, Place):
        return expressions[value.number]
    return _walked(value, lambda part: _unpacked(part, expressions))


def _walked(value: Any, of: Any) -> Any:
    """A container with `of` applied to its parts; anything else unchanged."""
    if isinstance(value, dict):
        return {key: of(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(of(part) for part in value)
    if is_dataclass(value) and not isinstance(value, type):
        new = {f.name: of(getattr(value, f.name)) for f in fields(value)}
        changed = {n: v for n, v in new.items() if v is not getattr(value, n)}
        return replace(value, **changed) if changed else value
    return value
