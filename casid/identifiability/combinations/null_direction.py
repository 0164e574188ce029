"""Directions that change no output, as rational functions of the physical symbols.

A null vector of the information matrix is known at points of prime fields; its entries, normalised
to one in a free parameter, are rational functions of parameters, constants and initial values.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from casid.algebra.factoring import factored
from casid.algebra.interpolation import interpolate
from casid.algebra.prime_field import echelon
from casid.arrays import Array
from casid.errors import IdentifiabilityError, nearest
from casid.pickling import PickledByFields

Expr: TypeAlias = Any  # a sympy expression
NullAt: TypeAlias = Callable[[Mapping[str, int], int], Array]
"""(values of all variables modulo p, p) -> (d, n) null basis modulo p, the identity on the free
columns; it raises ZeroDivisionError at points where these columns cannot be free."""


@dataclass(frozen=True, slots=True, eq=False)
class NullDirection(PickledByFields):
    """d theta / d free: how parameters move together without a change of any output.

    Attributes
    ----------
    free : the parameter the others follow; its entry is 1.
    entries : parameter -> sympy expression in symbols of the physical names, 0 where it does not
        move, None where no closed form was found.
    initial_states : symbols in the entries that may change as well, at rates that the entries do
        not give (unknown initial values).
    """

    free: str
    entries: Mapping[str, Expr | None]
    initial_states: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        object.__setattr__(self, "entries", MappingProxyType(dict(self.entries)))
        if self.free not in self.entries or self.entries[self.free] != 1:
            raise IdentifiabilityError(
                f"the entry of the free parameter {self.free!r} must be 1, not "
                f"{self.entries.get(self.free)}; divide the direction by it"
            )

    @property
    def moved(self) -> tuple[str, ...]:
        """Parameters whose value changes along the direction, the free one among them."""
        return tuple(n for n, v in self.entries.items() if v is None or v != 0)

    @property
    def unchanged(self) -> tuple[str, ...]:
        """Parameters that do not change."""
        return tuple(n for n, v in self.entries.items() if v is not None and v == 0)

    @property
    def not_found(self) -> tuple[str, ...]:
        """Parameters that change at a rate for which no closed form was found."""
        return tuple(n for n, v in self.entries.items() if v is None)

    def following(self, free: str) -> NullDirection:
        """The direction, normalised to another parameter.

        Raises
        ------
        IdentifiabilityError
            If that parameter does not change, or at a rate that was not found.
        """

        if free not in self.entries:
            raise IdentifiabilityError(
                f"there is no parameter {free!r}{nearest(free, list(self.entries))}"
            )
        speed = self.entries[free]
        if speed is None or speed == 0:
            able = [n for n in self.moved if n not in self.not_found]
            raise IdentifiabilityError(
                f"the direction does not move {free!r} in a known way; follow one of "
                f"{', '.join(able)}"
            )

        def divided(v: Expr) -> Expr:  # entries are products of factors: equal ones cancel
            quotient = v / speed
            return factored(quotient) if v.is_Add or speed.is_Add else quotient

        entries = {n: None if v is None else divided(v) for n, v in self.entries.items()}
        return NullDirection(free, entries, self.initial_states)

    def __repr__(self) -> str:
        return f"<NullDirection along {self.free}: moves {', '.join(self.moved)}>"

    def __str__(self) -> str:
        lines = [
            f"d {n} / d {self.free} = {'not found in closed form' if v is None else v}"
            for n, v in self.entries.items()
            if n != self.free and (v is None or v != 0)
        ]
        if not lines:
            lines = [f"{self.free} moves alone: the outputs do not depend on it"]
        if self.unchanged:
            lines.append(f"unchanged: {', '.join(self.unchanged)}")
        return "\n".join(lines)


def null_directions(
    null_at: NullAt,
    parameters: Sequence[str],
    free: Sequence[str],
    variables: Sequence[str],
    *,
    initial_states: Sequence[str] = (),
    seed: int = 0,
) -> tuple[NullDirection, ...]:
    """The null directions as functions of the physical symbols, one for each free parameter.

    Parameters
    ----------
    null_at : see `NullAt`; the columns are `parameters`, the rows `free`.
    parameters : n names, the columns.
    free : d of them, on which the basis is the identity.
    variables : all names the basis may depend on: parameters, constants, initial values.
    initial_states : those of the variables that are unknown initial values and no columns.

    Returns
    -------
    one direction for each free parameter; each leaves the other free parameters unchanged. An entry
    with too many coefficients for `interpolate` is None.
    Every entry is verified at fresh points modulo a prime it was not found with: the probability
    that one is wrong is about its degree / 2^30, cubed.

    Raises
    ------
    IdentifiabilityError
        If `null_at` gives a basis that is not the identity on the free columns.
    """
    columns = [_position(n, parameters) for n in free]
    d, n = len(columns), len(parameters)
    identity = np.eye(d, dtype=np.int64)

    def entries(values: Mapping[str, int], p: int) -> Array:
        """Entries of the null basis modulo p, which is the identity on the free columns."""
        basis = np.asarray(null_at(values, p), dtype=np.int64)
        if basis.shape != (d, n) or not np.array_equal(basis[:, columns] % p, identity):
            raise IdentifiabilityError(
                f"the null basis of shape {basis.shape} is not the identity on the free columns "
                f"{', '.join(free)} of {n} parameters; normalise it to them"
            )
        return basis.ravel() % p

    found = interpolate(entries, variables, seed=seed)
    expressions = [None if f is None else f.to_sympy() for f in found]
    return tuple(
        NullDirection(
            name,
            dict(zip(parameters, expressions[k * n : (k + 1) * n], strict=True)),
            tuple(initial_states),
        )
        for k, name in enumerate(free)
    )


def normalised(null: Array, columns: Sequence[int], p: int) -> Array:
    """A null basis (d, n) modulo p combined so that it is the identity on d columns.

    Raises
    ------
    ZeroDivisionError
        If these columns are dependent, at this point at least.
    """
    d, n = null.shape
    order = [*columns, *(j for j in range(n) if j not in set(columns))]
    reduced, pivots = echelon(null[:, order], p)
    if len(columns) != d or pivots != list(range(d)):
        raise ZeroDivisionError("the free columns are dependent at this point")
    out = np.empty_like(reduced)
    out[:, order] = reduced
    return out


def _position(name: str, parameters: Sequence[str]) -> int:
    if name not in parameters:
        raise IdentifiabilityError(f"there is no parameter {name!r}{nearest(name, parameters)}")
    return list(parameters).index(name)
