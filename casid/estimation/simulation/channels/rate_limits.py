"""Commands behind an actuator that moves at no more than a rate, exact within samples.

The actuator is where the command is, or moves towards it at the rate R:

    dp/dt = R sign(u - p),   p = u where that moves more slowly than R                        (1)

In each sample the command is a straight line, after a step at its beginning if it is held. The
actuator then moves along two straight lines at most, and the line that stands for them has their
mean and first moment: nothing moves by a part of a sample, and the derivative with R is exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Limited:
    """An actuator in each of N samples: first along one line, from `after` on along another.

    `first` and `second` are the slopes a sample, `at` where the sample begins, `slow_at` its
    derivative with the largest change in a sample, and `after` the share of the sample at which it
    turns, 1 where it does not. What it was before the first sample is known where it `is_placed`.
    """

    at: Array
    first: Array
    after: Array
    second: Array
    follows: Array  # bool: the second line is the command's
    tracks: Array  # bool: it is on the command all the time
    sign: Array  # of the motion towards the command
    is_placed: bool

    @property
    def lines(self) -> Array:
        """(N, 3) the actuator where the sample begins, and the ends of the line for it."""
        left = 1.0 - self.after
        bend = self.second - self.first
        mean = self.at + 0.5 * self.first + 0.5 * bend * left**2
        tilt = self.first + bend * (3.0 - 2.0 * left) * left**2
        return np.stack([self.at, mean - 0.5 * tilt, mean + 0.5 * tilt], axis=1)


def rate_limited(lines: Array, most: float, rest: float | None = None) -> Limited:
    """An actuator behind a command (N, 3) of a line in each sample.

    Parameters
    ----------
    lines : value at the sample, and where the line in it begins and ends.
    most : by which the actuator moves in a sample at most, the rate times the sample time.
    rest : where the actuator begins, by default where the command does.
    """
    begins, rises = lines[:, 1], lines[:, 2] - lines[:, 1]
    at, first, second = begins.copy(), rises.copy(), rises.copy()
    after, sign = np.ones(len(lines)), np.zeros(len(lines))
    follows, tracks = np.zeros(len(lines), dtype=bool), np.ones(len(lines), dtype=bool)
    before = np.concatenate([begins[:1] if rest is None else [rest], lines[:-1, 2]])
    breaks = np.flatnonzero((begins != before) | (np.abs(rises) > most)).tolist()
    begin_of, end_of = begins.tolist(), lines[:, 2].tolist()
    k = 0
    for start in breaks:
        if start < k:
            continue
        k, p = start, float(before[start])
        while k < len(lines):
            begin, end = begin_of[k], end_of[k]
            rise = end - begin
            if p == begin and -most <= rise <= most:
                break  # on the command again, until the next break
            up = 1.0 if (begin > p or (begin == p and rise > 0.0)) else -1.0
            closing, gap = most - up * rise, up * (begin - p)
            at[k], first[k], sign[k], tracks[k] = p, up * most, up, False
            if gap >= closing or begin == p:
                second[k], p = first[k], p + up * most
            else:
                after[k] = turn = gap / closing
                follows[k] = abs(rise) <= most
                if follows[k]:
                    second[k], p = rise, end
                else:
                    second[k] = -up * most
                    p = begin + rise * turn - up * most * (1.0 - turn)
            k += 1
    return Limited(at, first, after, second, follows, tracks, sign, rest is not None)


def change_with_rate(lines: Array, limited: Limited) -> Array:
    """(N, 3) derivative of an actuator's lines with the largest change in a sample."""
    return _moved(lines, limited, np.zeros_like(lines), per_rate=1.0)


def through_limit(
    lines: Array, limited: Limited, tangents: Mapping[str, Array]
) -> dict[str, Array]:
    """What becomes of tangents (N, 3) of the command behind the limit: those of the actuator.

    While it tracks the command they pass; while it moves at its rate it keeps what it had.
    """
    return {n: _moved(lines, limited, t, per_rate=0.0) for n, t in tangents.items()}


def _moved(lines: Array, limited: Limited, given: Array, *, per_rate: float) -> Array:
    """The derivative (N, 3) of the actuator, where the command has the derivative `given`.

    With q that where a sample begins, it is q + s r in the first part of a sample, r the share of
    it that has passed and s the sign of the motion; then the command's, or one of motion back.
    """
    begin, slope = given[:, 1], given[:, 2] - given[:, 1]
    rise = lines[:, 2] - lines[:, 1]
    turn, left = limited.after, 1.0 - limited.after
    at = begin.copy()  # q
    jump, bend = np.zeros(len(lines)), np.zeros(len(lines))
    first = np.where(limited.tracks, slope, per_rate * limited.sign)
    back = ~limited.follows & ~limited.tracks & (turn < 1.0)
    speed = np.abs(limited.first)
    q, last = 0.0, -2
    for k in np.flatnonzero(~limited.tracks).tolist():
        if k != last + 1:
            q = begin[k - 1] + slope[k - 1] if k else (0.0 if limited.is_placed else begin[0])
        at[k], last = q, k
        there = begin[k] + slope[k] * turn[k]
        if limited.follows[k]:
            jump[k], bend[k] = there - q - first[k] * turn[k], slope[k] - first[k]
            q = begin[k] + slope[k]
        elif back[k]:
            s, closing = limited.sign[k], speed[k] - limited.sign[k] * rise[k]
            later = (s * (there - q) - per_rate * turn[k]) / closing
            there += (rise[k] + s * speed[k]) * later
            jump[k], bend[k] = there - q - first[k] * turn[k], -2.0 * first[k]
            q = there - first[k] * left[k]
        else:
            q += first[k]
    mean = at + 0.5 * first + jump * left + 0.5 * bend * left**2
    tilt = first + 6.0 * jump * turn * left + bend * (3.0 - 2.0 * left) * left**2
    return np.stack([at, mean - 0.5 * tilt, mean + 0.5 * tilt], axis=1)
