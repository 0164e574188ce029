"""Attributes of a result whose fields are grouped by question, read from the result itself."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

T = TypeVar("T")


class Grouped(Generic[T]):
    """A read-only attribute that a nested group of fields has.

    Example: ``rank: ClassVar[Grouped[int]] = Grouped("structure")`` in a class with a field
    `structure` that has a `rank`; ``Grouped("fit", "nrmse")`` where it has another name there.
    """

    def __init__(self, group: str, name: str = "") -> None:
        self.group, self.name = group, name

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = self.name or name
        self.__doc__ = f"`{self.group}.{self.name}`."

    def __get__(self, instance: Any, owner: type | None = None) -> T:
        if instance is None:
            return self  # type: ignore[return-value]
        value: T = getattr(getattr(instance, self.group), self.name)
        return value
