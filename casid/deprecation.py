"""Names of public attributes that have moved or changed: kept usable."""

from __future__ import annotations

import warnings
from typing import Any, Generic, TypeVar

T = TypeVar("T")


def renamed(old: str, new: str) -> property:
    """A property `old` that warns and gives the attribute `new`.

    Example: ``mends = renamed("mends", "remedies")`` in a class that has `remedies`.
    """

    def get(self: Any) -> Any:
        warnings.warn(
            f"{type(self).__name__}.{old} is called {new} now; {old} goes with the next release",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(self, new)

    get.__doc__ = f"Old name of `{new}`."
    return property(get)


class Grouped(Generic[T]):
    """A read-only attribute that a nested group of fields has.

    Example: ``rank: ClassVar[Grouped[int]] = Grouped("structure")`` in a class with a field
    `structure` that has a `rank`.
    """

    def __init__(self, group: str) -> None:
        self.group, self.name = group, ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        self.__doc__ = f"`{self.group}.{name}`."

    def __get__(self, instance: Any, owner: type | None = None) -> T:
        if instance is None:
            return self  # type: ignore[return-value]
        value: T = getattr(getattr(instance, self.group), self.name)
        return value
