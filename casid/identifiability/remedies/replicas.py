"""How often an experiment must be repeated: each replica has initial states and inputs of its own.

The information of j replicas on the parameters is the sum of j generic members of one family of
spaces. Once a member adds nothing, the sum contains almost every member, so no further replica ever
adds anything: the first that adds nothing ends the search. Source: A. Ovchinnikov, A. Pillay,
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
from casid.data.files import plain_fields
from casid.errors import IdentifiabilityError
from casid.identifiability.equations.system import System
from casid.identifiability.rank.observability import RankEvaluation
from casid.identifiability.rank.rank_result import PointRank

Verdict = tuple[int, tuple[bool, ...]]  # rank of the information; which are identifiable

MAX_POINTS = 50
"""Points after which the error probability is reported as it is (very large models)."""


@dataclass(frozen=True, slots=True)
class ReplicasNeeded:
    """Deficiency and identifiable parameters by number of replicas.

    Attributes
    ----------
    deficiencies : of the parameters with 1, 2, ... replicas, up to the first that completes them or
        adds nothing, or up to the limit.
    identifiable : parameters, by the same counts.
    needed : replicas after which all parameters are identifiable; None if that was not reached.
    enough : replicas after which a further one adds nothing; None if the limit cut the search.
    is_cut : the limit was reached while replicas still added information.
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
        """Rank deficiency of the parameters with `count` >= 1 replicas.

        Raises
        ------
        IdentifiabilityError
            If the search was cut before that count.
        """
        if count < 1 or (self.is_cut and count > len(self.deficiencies)):
            raise IdentifiabilityError(
                f"{count} replicas were not computed, only 1 to {len(self.deficiencies)}; raise "
                "limit in replicas_needed"
            )
        return self.deficiencies[min(count, len(self.deficiencies)) - 1]

    def __str__(self) -> str:
        n = len(self.parameters)
        lines = ["replicas  deficiency  identifiable"]
        for i, (d, found) in enumerate(zip(self.deficiencies, self.identifiable, strict=True)):
            lines.append(f"{i + 1:8d}  {d:10d}  {len(found)} of {n}")
        lines.append(self.conclusion)
        if self.error_bound:
            lines.append(f"probability that this is wrong: below {self.error_bound:.1e}")
        return "\n".join(lines)

    @property
    def conclusion(self) -> str:
        """How many replicas are needed, or why none helps."""
        if self.needed is not None:
            return f"{self.needed} make all parameters identifiable"
        if self.is_cut:
            return "the limit was reached while replicas still added information; raise limit"
        if self.deficiencies[-1] == len(self.parameters):
            return "no number of them gives information on the parameters"
        return f"more than {self.enough} add nothing; replicas are no remedy"

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers."""
        return plain_fields(self)


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
    adds its information to that of the earlier ones; nothing is computed twice.

    Parameters
    ----------
    systems : one or several experiments without unknown inputs.
    limit : most replicas.
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
    search = RankEvaluation(systems)
    rng = np.random.default_rng(seed)
    best: list[Verdict] = []  # by count
    failures: list[float] = []
    while True:
        first, found = _at_a_point(search, rng, len(best), limit)
        best = _joined(best, found)
        failures.append(_failure(search, first, len(best)))
        proven = len(failures) == 1 and first.rank == search.unknowns
        bound = 0.0 if proven else min(1.0, len(best) * math.prod(failures))
        if bound <= error_bound or len(failures) == MAX_POINTS:
            break
    ranks = [rank for rank, _ in best]
    n = len(search.parameters)
    enough = ranks.index(ranks[-1]) + 1  # the first count with the rank of the last
    complete = ranks[-1] == n
    is_idle = ranks[-1] == 0  # no information on the parameters: then no other has any
    is_cut = not complete and not is_idle and enough == len(ranks)
    counts = enough if complete else len(ranks)
    return ReplicasNeeded(
        parameters=search.parameters,
        deficiencies=tuple(n - r for r in ranks[:counts]),
        identifiable=tuple(
            tuple(q for q, yes in zip(search.parameters, found, strict=True) if yes)
            for _, found in best[:counts]
        ),
        needed=enough if complete else None,
        enough=None if is_cut else enough,
        is_cut=is_cut,
        error_bound=bound,
    )


def _at_a_point(
    search: RankEvaluation, rng: np.random.Generator, least: int, limit: int
) -> tuple[PointRank, list[Verdict]]:
    """Verdicts for 1, 2, ... replicas at one point, until one adds nothing, at least `least`."""
    first = point = search.at(random_prime(rng), rng)
    n = len(search.parameters)
    basis = Basis(n, first.prime)
    found: list[Verdict] = []
    while True:
        gained = basis.add(point.information)
        found.append((basis.rank, tuple(unit_vectors(basis.rows))))
        is_over = basis.rank == n or not gained
        if len(found) >= limit or (is_over and len(found) >= least):
            return first, found
        if basis.rank < n:
            point = search.at(first.prime, rng, values=first.values)


def _joined(before: list[Verdict], now: list[Verdict]) -> list[Verdict]:
    """For each count the verdicts of the points of largest rank; a short list is continued."""
    if not before:
        return now
    before = before + [before[-1]] * (len(now) - len(before))
    out = []
    for old, new in zip(before, now, strict=True):
        both = tuple(a and b for a, b in zip(old[1], new[1], strict=True))
        out.append((old[0], both) if old[0] == new[0] else max(old, new, key=lambda t: t[0]))
    return out


def _failure(search: RankEvaluation, first: PointRank, count: int) -> float:
    """Bound on the probability that a point shows too small a rank for one of the counts."""
    repeated = RankEvaluation(search.systems * count)
    rank = min(count * first.rank, repeated.unknowns)
    return repeated.failure(rank, first.orders * count)
