"""The errors casid raises on purpose: what went wrong, where, and how to correct it."""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Iterable


class CasidError(Exception):
    """Base of every error that casid raises on purpose."""


class DataError(CasidError, ValueError):
    """A record, file or channel cannot be used."""


class UnitError(DataError):
    """A unit is unknown, ambiguous, or of another dimension than the model's."""


class ModelError(CasidError):
    """A model or problem file contradicts itself."""


class IdentifiabilityError(CasidError):
    """The model and experiments do not identify the requested parameters."""


class SolveError(CasidError):
    """A simulation diverged or a solver gave up."""


class OutOfTimeError(SolveError):
    """A time limit ended the work before it was done.

    Attributes
    ----------
    found : what there was until then, where that is something.
    """

    def __init__(self, message: str, found: object = None) -> None:
        super().__init__(message)
        self.found = found


class UnknownNameError(CasidError, KeyError):
    """A result holds nothing of the name in brackets, as in `estimate["mass"]`."""

    __str__ = Exception.__str__  # a KeyError would show its text in quotes


def require_texts(where: str, **texts: Iterable[object]) -> None:
    """Refuse names and units that are no texts.

    Raises
    ------
    ModelError
        With `where`, what it is to be, and what was given.
    """
    for what, given in texts.items():
        for text in given:
            if not isinstance(text, str):
                raise ModelError(f"{where}: {what} {text!r} is no text; put it in quotes")


def shell_option(name: str, value: str) -> str:
    """`--map 'phi=roll angle'`: an option as a shell takes it; for messages."""
    return f"{name} {shlex.quote(value)}"


def nearest(name: str, known: Iterable[str], *, is_listed: bool = False) -> str:
    """``; did you mean 'b1'?`` for the nearest known name, or what there is; for messages.

    Parameters
    ----------
    is_listed : the message says what there is already.
    """
    known = sorted(set(known))
    lowered = {k.lower(): k for k in reversed(known)}
    close = difflib.get_close_matches(name.lower(), lowered, n=1, cutoff=0.6)
    if close:
        return f"; did you mean {lowered[close[0]]!r}?"
    if is_listed:
        return ""
    listing = ", ".join(known[:12]) + (", ..." if len(known) > 12 else "")
    return f"; known are: {listing}" if known else "; none is declared"
