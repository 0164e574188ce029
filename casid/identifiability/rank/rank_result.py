"""Rank and verdicts at one point, and from all points together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casid.algebra.row_basis import leading, unit_vectors
from casid.arrays import Array
from casid.identifiability.equations.system import System


@dataclass(frozen=True, slots=True, eq=False)
class PointRank:
    """Row echelon forms of the sensitivities at one point, modulo `prime`.

    Attributes
    ----------
    values : parameters and constants at the point.
    information : (r, n_parameters), of all experiments, initial states eliminated.
    full : by experiment, over [initial states that are not known | parameters].
    states : by experiment, the states of the columns of `full`.
    orders : by experiment, the highest derivative that was needed.
    is_partial : time ran out, or the highest order allowed was reached.
    """

    prime: int
    parameters: tuple[str, ...]
    values: Mapping[str, int]
    information: Array
    full: tuple[Array, ...]
    states: tuple[tuple[str, ...], ...]
    orders: tuple[int, ...]
    is_partial: bool = False

    @property
    def rank(self) -> int:
        """Rank of the joint observability matrix."""
        of_states = sum(
            leading(full, len(states)) for full, states in zip(self.full, self.states, strict=True)
        )
        return of_states + len(self.information)

    def identifiable(self) -> list[bool]:
        """Per parameter: its unit vector lies in the span of the rows."""
        return unit_vectors(self.information)

    def moves(self, parameter: str) -> bool:
        """True if a parameter affects an output, be its effect separable from others or not."""
        i = self.parameters.index(parameter)
        return any(
            bool(np.any(full[:, len(states) + i]))
            for full, states in zip(self.full, self.states, strict=True)
        )

    def unobservable(self) -> list[str]:
        """States that are unobservable from the outputs, experiment by experiment."""
        pairs = zip(self.states, self.observable(), strict=True)
        return [
            s
            for states, seen in pairs
            for s, is_seen in zip(states, seen, strict=True)
            if not is_seen
        ]

    def observable(self) -> list[list[bool]]:
        """Per experiment and state of `states`."""
        return [
            unit_vectors(full)[: len(states)]
            for full, states in zip(self.full, self.states, strict=True)
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """The rank and what follows from it parameter by parameter and state by state.

    Attributes
    ----------
    rank, unknowns : over all experiments; parameters and initial states that are not known.
    error_bound : 0 where the rank is full, which is a proof; otherwise the probability that a
        verdict is wrong is at most this; nan where `is_partial`.
    is_certified : False where initial values or parameters are special and the rank stayed below
        that of almost every point: then later derivatives might raise it. False too where there
        are more than `MAX_KINKS` kinks, whose sides are not all evaluated.
    points : of largest rank.
    deficiency : dimension of the unidentifiable directions of the parameters.
    bytes : memory of the largest series.
    """

    systems: tuple[System, ...]
    parameters: tuple[str, ...]
    rank: int
    unknowns: int
    error_bound: float
    is_partial: bool
    is_certified: bool
    orders: tuple[int, ...]
    points: tuple[PointRank, ...]
    identifiable: Mapping[str, bool]
    observable: tuple[Mapping[str, bool], ...]
    deficiency: int
    immersed: tuple[str, ...]
    has_kinks: bool
    bytes: int

    @property
    def is_full(self) -> bool:
        """True if every parameter is identifiable and every initial state observable: a proof."""
        return self.rank == self.unknowns

    def __repr__(self) -> str:
        return f"<Observability: rank {self.rank} of {self.unknowns}>"
