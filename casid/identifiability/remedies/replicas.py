"""How often an experiment must be repeated: each replica has initial states and inputs of its own.

With j replicas the outputs tell of the parameters the sum of j generic members of one family of
spaces. Once a member adds nothing, the sum contains almost every member, so no further replica ever
adds anything: the first idle replica ends the search. Source: A. Ovchinnikov, A. Pillay,
G. Pogudin, T. Scanlon, "Multi-experiment parameter identifiability of ODEs and model theory", SIAM
J. Appl. Algebra Geom. 6 (2022) 339-367.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.algebra.prime_field import random_prime
from casid.algebra.row_basis import Basis, unit_vectors
from casid.errors import IdentifiabilityError
from casid.identifiability.equations.system import System
from casid.identifiability.rank.observability import Search
from casid.identifiability.rank.rank_result import PointRank

Told = tuple[int, tuple[bool, ...]]  # rank of the information, parameter by parameter

MAX_POINTS = 50
"""Points after which the error probability is reported as it is (very large models)."""


@dataclass(frozen=True, slots=True)
class ReplicasNeeded:
    """What repetitions tell, count by count.

    Attributes
    ----------
    deficiencies : of the parameters with 1, 2, ... replicas, up to the first that completes them or
        adds nothing, or up to the limit.
    identifiable : parameters, by the same counts.
    needed : replicas after which all parameters are identifiable; None if that was not reached.
    enough : replicas after which a further one tells nothing new; None if the limit cut the search.
    is_cut : the limit was reached while replicas still told something new.
    error_bound : probability that a deficiency or a verdict is wrong; 0 where one replica already
        has full rank.
    """

    parameters: tuple[str, ...]
    deficiencies: tuple[int, ...]
    identifiable: tuple[tuple[str, ...], ...]
    needed: int | None
    enough: int | None
    is_cut: bool
    error_bound: float

    def deficiency(self, count: int) -> int:
        """Of the parameters with `count` >= 1 replicas.

        Raises
        ------
        IdentifiabilityError
            If the search was cut before that count.
        """
        if count < 1 or (self.is_cut and count > len(self.deficiencies)):
            raise IdentifiabilityError(
                f"{count} replicas were not looked at, only 1 to {len(self.deficiencies)}; raise "
                "limit in replicas_needed"
            )
        return self.deficiencies[min(count, len(self.deficiencies)) - 1]

    def __str__(self) -> str:
        n = len(self.parameters)
        lines = ["replicas  deficiency  identifiable"]
        for i, (d, told) in enumerate(zip(self.deficiencies, self.identifiable, strict=True)):
            lines.append(f"{i + 1:8d}  {d:10d}  {len(told)} of {n}")
        lines.append(self.conclusion)
        if self.error_bound:
            lines.append(f"probability that this is wrong: below {self.error_bound:.1e}")
        return "\n".join(lines)

    @property
    def conclusion(self) -> str:
        """How many replicas are worth making."""
        if self.needed is not None:
            return f"{self.needed} make all parameters identifiable"
        if self.is_cut:
            return "the limit was reached while replicas still told more; raise limit"
        if self.deficiencies[-1] == len(self.parameters):
            return "no number of them tells anything of the parameters"
        return f"more than {self.enough} tell nothing new; replicas do not mend it"

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers."""
        return {
            "parameters": list(self.parameters),
            "deficiencies": list(self.deficiencies),
            "identifiable": [list(told) for told in self.identifiable],
            "needed": self.needed,
            "enough": self.enough,
            "is_cut": self.is_cut,
            "error_bound": self.error_bound,
        }


def replicas_needed(
    systems: System | Sequence[System],
    limit: int = 8,
    *,
    seed: int = 0,
    error_bound: float = 1e-12,
) -> ReplicasNeeded:
    """Deficiency of the parameters by number of replicas.

    A replica repeats all given experiments at the same parameters and known constants, with initial
    states and known inputs of its own (known initial states are other generic numbers, too). Each
    adds what it tells to what the earlier ones told; nothing is computed twice.

    Parameters
    ----------
    systems : one or several experiments without unknown inputs.
    limit : no more replicas than this are looked at.
    seed : of the random points and primes.
    error_bound : wanted, of the probability that any deficiency or verdict is wrong.

    Raises
    ------
    IdentifiabilityError
        If `limit` is less than 1.
    ModelError
        If a system has unknown inputs, or is defined at no point.
    """
    if limit < 1:
        raise IdentifiabilityError(f"limit = {limit} replicas; allow at least one")
    search = Search(systems)
    rng = np.random.default_rng(seed)
    best: list[Told] = []  # by count
    failures: list[float] = []
    while True:
        first, told = _at_a_point(search, rng, len(best), limit)
        best = _joined(best, told)
        failures.append(_failure(search, first, len(best)))
        proven = len(failures) == 1 and first.rank == search.unknowns
        bound = 0.0 if proven else min(1.0, len(best) * math.prod(failures))
        if bound <= error_bound or len(failures) == MAX_POINTS:
            break
    ranks = [rank for rank, _ in best]
    n = len(search.parameters)
    enough = ranks.index(ranks[-1]) + 1  # the first count that tells as much as the last
    complete = ranks[-1] == n
    is_idle = ranks[-1] == 0  # one that tells nothing of the parameters: then no other does
    is_cut = not complete and not is_idle and enough == len(ranks)
    counts = enough if complete else len(ranks)
    return ReplicasNeeded(
        parameters=search.parameters,
        deficiencies=tuple(n - r for r in ranks[:counts]),
        identifiable=tuple(
            tuple(q for q, yes in zip(search.parameters, told, strict=True) if yes)
            for _, told in best[:counts]
        ),
        needed=enough if complete else None,
        enough=None if is_cut else enough,
        is_cut=is_cut,
        error_bound=bound,
    )


def _at_a_point(
    search: Search, rng: np.random.Generator, least: int, limit: int
) -> tuple[PointRank, list[Told]]:
    """What 1, 2, ... replicas tell at one point; at least so many counts, and until one is idle."""
    first = point = search.at(random_prime(rng), rng)
    n = len(search.parameters)
    basis = Basis(n, first.prime)
    told: list[Told] = []
    while True:
        gained = basis.add(point.information)
        told.append((basis.rank, tuple(unit_vectors(basis.rows))))
        is_over = basis.rank == n or not gained
        if len(told) >= limit or (is_over and len(told) >= least):
            return first, told
        if basis.rank < n:
            point = search.at(first.prime, rng, values=first.values)


def _joined(before: list[Told], now: list[Told]) -> list[Told]:
    """Count by count, points of largest rank decide, together; a short list goes on as it ends."""
    if not before:
        return now
    before = before + [before[-1]] * (len(now) - len(before))
    out = []
    for old, new in zip(before, now, strict=True):
        both = tuple(a and b for a, b in zip(old[1], new[1], strict=True))
        out.append((old[0], both) if old[0] == new[0] else max(old, new, key=lambda t: t[0]))
    return out


def _failure(search: Search, first: PointRank, count: int) -> float:
    """Bound on the probability that a point shows too small a rank for one of the counts."""
    repeated = Search(search.systems * count)
    rank = min(count * first.rank, repeated.unknowns)
    return repeated.failure(rank, first.orders * count)
