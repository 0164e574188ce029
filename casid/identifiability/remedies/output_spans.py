"""The span of each output's sensitivities at one point: the rows of all its derivatives.

The rows of several outputs' derivatives span the sum of what each output's span. So one series, at
one point, serves every subset of the outputs: each output's span is reduced on its own, until one
of its derivatives adds nothing (at almost every point none does after that), and sums of spans are
linear algebra.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casid.algebra.row_basis import Basis
from casid.arrays import Array
from casid.errors import ModelError
from casid.identifiability.equations.system import System
from casid.identifiability.rank.observability import ATTEMPTS, RankEvaluation
from casid.identifiability.rank.series import Series, SpecialPoint


@dataclass(frozen=True, slots=True, eq=False)
class Spans:
    """Each output's span at one point modulo `prime`.

    Attributes
    ----------
    rows : by output, (r_i, n_states + n_parameters) over [states of unknown initial value |
        parameters], linearly independent before the columns of known states were left out.
    orders : by output, the first derivative that added nothing, or completed the rank.
    """

    prime: int
    n_states: int
    rows: tuple[Array, ...]
    orders: tuple[int, ...]


class OutputSpans:
    """The spans of a system's outputs, prepared for evaluation at any number of points.

    Parameters
    ----------
    system : without unknown inputs, at almost every point (`is_possible`).
    """

    def __init__(self, system: System) -> None:
        self._search = RankEvaluation(system)
        self.system, self.unknowns = system, self._search.unknowns
        self.schedule = self._search.schedules[0]
        known = {*system.known_initial}
        free = [i for i, x in enumerate(system.states) if x not in known]
        nx = len(system.states)
        self.n_states = len(free)
        self._columns = [*free, *range(nx, nx + len(system.parameters))]

    @property
    def is_possible(self) -> bool:
        """False at special points and with kinks, where one idle derivative proves nothing."""
        return self.system.is_generic and not self.schedule.program.kinks

    def at(self, prime: int, rng: np.random.Generator) -> Spans:
        """The spans at a random point.

        Raises
        ------
        ModelError
            If no point is found where the system is defined.
        """
        reason = ""
        names = (*self.system.parameters, *self.system.constants, *self.system.states)
        for _ in range(ATTEMPTS):
            drawn = rng.integers(1, prime, len(names)).tolist()
            try:
                return self._spans(dict(zip(names, drawn, strict=True)), prime, rng)
            except SpecialPoint as problem:
                reason = problem.function
        raise ModelError(
            f"{self.system.name}: no point was found where the model is defined: {reason} at "
            f"{ATTEMPTS} random points; look for a division by something that is always zero"
        )

    def failure(self, spans: Spans, rank: int) -> float:
        """Bound on the probability that a subset's rank or a verdict is wrong at a point.

        As in a search for that subset, but each output has a series of its own, whose derivatives
        might have ended too early.

        Parameters
        ----------
        rank : that was found.
        """
        return min(1.0, len(spans.orders) * self._search.failure(rank, (max(spans.orders),)))

    def _spans(self, values: dict[str, int], prime: int, rng: np.random.Generator) -> Spans:
        width = self.schedule.n_columns
        bases = [Basis(width, prime) for _ in self.system.outputs]
        orders = [0] * len(bases)
        active = list(range(len(bases)))
        for order, rows in enumerate(Series(self.schedule, values, prime, rng).rows()):
            for i in active.copy():
                orders[i] = order
                if not bases[i].add(rows[i : i + 1]) or bases[i].rank == width:
                    active.remove(i)
            if not active:
                break
        rows_of = tuple(basis.rows[:, self._columns] for basis in bases)
        return Spans(prime, self.n_states, rows_of, tuple(orders))
