"""Which column of a file plays which part in a template: guessed by unit and by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from casid.data.templates.file_channels import FileChannel
from casid.errors import UnitError
from casid.model.units import parse_unit, si_unit

_UNIT, _WORD, _ORDER, _CONSTANT = 2.0, 1.0, 1e-3, 0.5  # heuristic weights of a guess


@dataclass(frozen=True, slots=True)
class Role:
    """A signal of a template.

    Attributes
    ----------
    units : SI units that a column of it may have; the first is taken where the file has none.
    words : parts of words in a column's name, English and German, that speak for it.
    against : parts of words that speak against it.
    by_name : True where the unit alone does not make a column this signal.
    column : the one column that plays it, whatever its unit.
    instead_of : a signal beside which it is not sought: the duty of a heater whose power is there.
    """

    name: str
    side: Literal["input", "output"]
    units: tuple[str, ...]
    words: str
    against: str = ""
    by_name: bool = False
    column: str | None = None
    instead_of: str | None = None

    def score(self, channel: FileChannel) -> float:
        """How well a column fits, 0 where it does not."""
        if self.column is not None:
            return _UNIT * (channel.column == self.column)
        names = _hits(self.words, channel.words)
        if channel.unit is None:
            fit = 0.0
        elif any(same_quantity(channel.unit, unit) for unit in self.units):
            fit = _UNIT
        else:
            return 0.0
        if not names and (fit == 0.0 or self.by_name):
            return 0.0
        total = fit + _WORD * names - _WORD * _hits(self.against, channel.words)
        return max(total - _CONSTANT * channel.is_constant, 0.0)

    def likeness(self, channel: FileChannel) -> float:
        """How likely a column without a known unit plays it: by its name, and what it does."""
        side = is_command(channel) or channel.is_held if self.side == "input" else False
        known = channel.unit is not None and not any(
            same_quantity(channel.unit, unit) for unit in self.units
        )
        words = _hits(self.words, channel.words) - _hits(self.against, channel.words)
        symbols = {w for w in self.words.split() if len(w) == 1}
        is_symbol = any(len(w) <= _SYMBOL and w[0] in symbols for w in channel.words)  # T_i
        return words + 0.5 * (side + is_symbol - channel.is_constant) - 10 * known

    def likely_unit(self, channel: FileChannel) -> str:
        """The unit that the values of a column without one fit; empty where they fit several."""
        if channel.unit is not None:
            return channel.unit
        low, high = float(np.min(channel.values)), float(np.max(channel.values))
        if self.units[0] == "K" and (high < _COLDEST or low > _COLDEST):
            return "degC" if high < _COLDEST else "K"
        return ""


_SYMBOL = 3  # letters of a symbol with its index, at most

_COLDEST = 200.0
"""Number of a temperature below which it is no absolute one [K]; a heuristic."""


def same_quantity(unit: str, other: str) -> bool:
    """True if two units measure the same kind of quantity; an angle is no pure number."""
    try:
        a, b = parse_unit(unit).dimension, parse_unit(other).dimension
        if a != b:
            return False
        return any(a) or si_unit(unit) == si_unit(other)
    except UnitError:
        return False


def _hits(parts: str, words: Sequence[str]) -> int:
    """How many words hold one of `parts`; parts of one or two letters have to be the whole word."""
    listed = parts.split()
    return sum(any(w == p or (len(p) > 2 and p in w) for p in listed) for w in words)


def is_command(channel: FileChannel) -> bool:
    """True if a column's name calls it a command, which is held between samples."""
    return _hits("cmd command soll setpoint sollwert pwm", channel.words) > 0


def assign(roles: Sequence[Role], channels: Sequence[FileChannel]) -> Mapping[str, FileChannel]:
    """The columns that fit the roles best together; a role that none fits is left out."""
    from scipy.optimize import linear_sum_assignment

    if not roles or not channels:
        return {}
    scores = np.array([[role.score(c) for c in channels] for role in roles])
    order = _ORDER * np.arange(len(channels))  # of equals the first of the file
    rows, columns = linear_sum_assignment(scores - order * (scores > 0), maximize=True)
    return {
        roles[i].name: channels[j]
        for i, j in zip(rows.tolist(), columns.tolist(), strict=True)
        if scores[i, j] > 0
    }
