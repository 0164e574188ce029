"""Names of public attributes that have moved or changed: kept usable."""

from __future__ import annotations

import warnings
from typing import Any


def renamed(old: str, new: str) -> property:
    """A property `old` that warns and gives the attribute `new`.

    Example: ``mends = renamed("mends", "remedies")`` in a class that has `remedies`.
    """

    def get(self: Any) -> Any:
        """The value under its new name, with a warning."""
        warnings.warn(
            f"{type(self).__name__}.{old} is called {new} now; {old} goes with the next release",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(self, new)

    get.__doc__ = f"Old name of `{new}`."
    return property(get)
