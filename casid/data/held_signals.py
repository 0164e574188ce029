"""Whether a channel moves in steps: a command that is switched, or held until the next one."""

from __future__ import annotations

import numpy as np

from casid.arrays import Array

_HELD = 0.5  # heuristic: in a held command more samples than these repeat the one before ...
_STEP = 0.05  # ... and the others move by more than this share of its spread: no quantisation
_LEVELS = 4  # of a grid at least: a switch of three positions has steps of one size, too; heuristic
_NEXT = 0.9  # of the changes of a reading that go to the next level; heuristic


def is_switched(values: Array) -> bool:
    """True for a command that is on or off, 0 or 1."""
    return bool(np.ptp(values) > 0.0 and np.isin(values, (0.0, 1.0)).all())


def is_held(values: Array) -> bool:
    """True for a signal of steps: most samples repeat the one before.

    A reading on a coarse grid repeats too, and moves by single steps.
    """
    changes = np.abs(np.diff(values))
    moving = changes[changes > 0.0]
    if not moving.size or moving.size > (1.0 - _HELD) * changes.size:
        return False
    is_large = bool(np.median(moving) > _STEP * np.std(values))
    return is_large and not is_rounded(values, float(moving.min()))


def is_rounded(values: Array, step: float) -> bool:
    """True of a reading on a grid of `step`: nine changes in ten go to the next of its levels."""
    moves = np.abs(np.round(np.diff(values) / step))
    moves = moves[moves > 0]
    if not moves.size or np.unique(values).size < _LEVELS:
        return False
    return float(np.mean(moves == 1)) >= _NEXT
