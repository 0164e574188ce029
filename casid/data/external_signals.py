"""Signals that a problem declares external: nothing in the experiment affects them."""

from __future__ import annotations

from collections.abc import Sequence

from casid.errors import ModelError, nearest


def external_signals(problem: str, given: Sequence[str], there: Sequence[str]) -> tuple[str, ...]:
    """The names in `given`, or the one that it is, each of which is among those `there`.

    Raises
    ------
    ModelError
        For a signal that is neither recorded nor an input.
    """
    names = (given,) if isinstance(given, str) else tuple(given)
    for name in names:
        if name not in there:
            raise ModelError(
                f"problem {problem}: external signal {name!r} is neither recorded beside the "
                f"model nor one of its inputs{nearest(str(name), there)}; declare it, "
                f"recorded={{{name!r}: unit}}"
            )
    return names
