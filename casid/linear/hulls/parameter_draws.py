"""Random parameter vectors: the known ones at their values, the free ones over orders of magnitude.

What holds for an analytic function on an open set holds everywhere, so properties of
theta = g(theta_p) may be looked for far from where a system works.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

import casadi as ca
import numpy as np

from casid.algebra.symbolic import exact
from casid.arrays import Array
from casid.errors import ModelError, nearest

Range = tuple[float, float]


class ParameterDraw:
    """Random parameters: the known ones at their values, the free ones over orders of magnitude."""

    def __init__(
        self,
        parameters: Sequence[str],
        values: Mapping[str, float],
        free: Sequence[str],
        ranges: Mapping[str, Range],
        seed: int,
    ) -> None:
        check_names(parameters, values, free)
        for name in ranges:
            if name not in free:
                raise ModelError(
                    f"a range is given for {name!r}, which is not free{nearest(name, free)}"
                )
            low, high = ranges[name]
            if not low < high:
                raise ModelError(
                    f"range of {name}: ({low:g}, {high:g}) is empty; give (low, high), low < high"
                )
        lacking = [p for p in parameters if p not in free and p not in values]
        if lacking:
            raise ModelError(
                f"no value for the known {', '.join(lacking)}; add it to `values`, or name it "
                "among the free parameters"
            )
        self.parameters = tuple(parameters)
        self.free = tuple(free)
        self.known = {p: float(values[p]) for p in parameters if p not in free}
        bad = [p for p, v in self.known.items() if not np.isfinite(v)]
        if bad:
            raise ModelError(f"the known value of {bad[0]} is {self.known[bad[0]]}; give a number")
        self._centre = {p: float(values.get(p, 1.0)) for p in free}
        self._ranges = ranges
        self._rng = np.random.default_rng(seed)

    def point(self) -> Array:
        """One parameter vector, (np,)."""
        decades = self._rng.uniform(0.3, 3.0)
        drawn = {p: self._one(p, decades) for p in self.free}
        return np.array([self.known[p] if p in self.known else drawn[p] for p in self.parameters])

    def exact_point(self) -> list[Fraction]:
        """One parameter vector of short decimals."""
        return [
            exact(v) if p in self.known else exact(float(f"{v:.3e}"))
            for p, v in zip(self.parameters, self.point().tolist(), strict=True)
        ]

    def _one(self, name: str, decades: float) -> float:
        rng = self._rng
        low, high = self._ranges.get(name, (-np.inf, np.inf))
        if np.isfinite(low) and np.isfinite(high):
            if low * high > 0:
                ends = np.log(np.abs([low, high]))
                return float(np.sign(low) * np.exp(rng.uniform(ends.min(), ends.max())))
            return float(rng.uniform(low, high))
        centre = self._centre[name]
        size = (abs(centre) or 1.0) * 10.0 ** rng.uniform(-decades, decades)
        if np.isfinite(low):
            return float(low + size)
        if np.isfinite(high):
            return float(high - size)
        return float(size * (np.sign(centre) or rng.choice([-1.0, 1.0])))


def check_names(
    parameters: Sequence[str], values: Mapping[str, float], free: Sequence[str]
) -> None:
    """Refuse a name that is no parameter, or is repeated.

    Raises
    ------
    ModelError
    """
    for name in (*free, *values):
        if name not in parameters:
            raise ModelError(
                f"{name!r} is not a parameter of the coefficients{nearest(name, parameters)}"
            )
    for names in (free, parameters):
        twice = [name for name in names if list(names).count(name) > 1]
        if twice:
            raise ModelError(f"parameter {twice[0]!r} is named twice; name it once")


def count_of_coefficients(g: ca.Function, parameters: Sequence[str]) -> int:
    """The number of coefficients of g: one vector of parameters -> one vector of coefficients.

    Raises
    ------
    ModelError
        If g has other arguments.
    """
    if g.n_in() != 1 or g.n_out() != 1 or g.numel_in(0) != len(parameters):
        raise ModelError(
            f"{g.name()} takes {[g.numel_in(i) for i in range(g.n_in())]} entries; it must map one "
            f"vector of the {len(parameters)} parameters {', '.join(parameters)} to one vector"
        )
    return int(g.numel_out(0))
