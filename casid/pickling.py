"""Pickles of frozen dataclasses whose mappings are read-only, which Python cannot pickle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any


class PickledByFields:
    """A dataclass that is pickled and deeply copied as a call with its fields."""

    __slots__ = ()

    def __reduce__(self) -> tuple[Any, ...]:
        given: dict[str, Any] = {}
        for entry in fields(self):  # type: ignore[arg-type]  # of the dataclass that inherits
            if entry.init:
                value = getattr(self, entry.name)
                given[entry.name] = dict(value) if isinstance(value, MappingProxyType) else value
        return _called, (type(self), given)


def _called(kind: type, given: Mapping[str, Any]) -> Any:
    return kind(**given)
