"""Which outputs suffice: rank and verdicts of every subset of a system's outputs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from casid.algebra.prime_field import random_prime
from casid.algebra.row_basis import Basis, unit_vectors
from casid.argument_types import names_wrong_types
from casid.errors import IdentifiabilityError, nearest
from casid.identifiability.equations.system import System
from casid.identifiability.rank.observability import observability
from casid.identifiability.remedies.output_spans import OutputSpans, Spans
from casid.presentation import Presented

Subset = tuple[int, ...]  # positions of outputs, ascending

MAX_POINTS = 50
"""Points after which the error probability is reported as it is (very large models)."""


@dataclass(frozen=True, slots=True)
class SensorSubset:
    """Rank and identifiable parameters with some of the outputs.

    Attributes
    ----------
    rank : of the parameters and all initial states that are not known.
    deficiency : dimension of the unidentifiable directions of the parameters.
    identifiable : parameters.
    """

    outputs: tuple[str, ...]
    cost: float
    rank: int
    deficiency: int
    identifiable: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SensorSubsets(Presented):
    """All non-empty subsets of the outputs, the cheapest first.

    Attributes
    ----------
    subsets : in the order of cost, then of size.
    unknowns : parameters and initial states that are not known.
    minimal : subsets with the same information on the parameters as all outputs, none of whose own
        subsets has it.
    cheapest : those of the least cost among them.
    error_bound : probability that any verdict of the table is wrong; 0 where each rank is full.
    is_certified : False where initial values or parameters are special and a rank stayed below that
        of almost every point.
    points : random points evaluated (the most, where subsets needed a search of their own).
    """

    name: str
    parameters: tuple[str, ...]
    unknowns: int
    subsets: tuple[SensorSubset, ...]
    minimal: tuple[SensorSubset, ...]
    cheapest: tuple[SensorSubset, ...]
    error_bound: float
    is_certified: bool
    points: int

    def of(self, *outputs: str) -> SensorSubset:
        """The row of these outputs.

        Raises
        ------
        IdentifiabilityError
            If one of them is not among the outputs of the table.
        """
        wanted = set(outputs)
        for s in self.subsets:
            if set(s.outputs) == wanted:
                return s
        known = {y for s in self.subsets for y in s.outputs}
        stray = next(iter(sorted(wanted - known)), "")
        raise IdentifiabilityError(f"{self.name} has no output {stray!r}{nearest(stray, known)}")

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers."""
        return {
            "system": self.name,
            "unknowns": self.unknowns,
            "parameters": list(self.parameters),
            "subsets": [
                {
                    "outputs": list(s.outputs),
                    "cost": s.cost,
                    "rank": s.rank,
                    "deficiency": s.deficiency,
                    "identifiable": list(s.identifiable),
                }
                for s in self.subsets
            ],
            "minimal": [list(s.outputs) for s in self.minimal],
            "cheapest": [list(s.outputs) for s in self.cheapest],
            "error_bound": self.error_bound,
            "is_certified": self.is_certified,
            "points": self.points,
        }

    def __repr__(self) -> str:
        cheapest = ", ".join(self.cheapest[0].outputs) if self.cheapest else "none"
        return f"<SensorSubsets {self.name}: {len(self.subsets)} subsets, cheapest {cheapest}>"


@dataclass(frozen=True, slots=True, eq=False)
class _Rank:
    """Rank with a subset of the outputs, at one point or at several."""

    rank: int
    information: int  # rank on the parameters, initial states eliminated
    identifiable: tuple[bool, ...]


@names_wrong_types()
def sensor_subsets(
    system: System,
    outputs: Sequence[str] | None = None,
    costs: Mapping[str, float] | None = None,
    *,
    seed: int = 0,
    error_bound: float = 1e-12,
    limit: int = 1023,
) -> SensorSubsets:
    """Rank, deficiency and identifiable parameters of every non-empty subset of the outputs.

    Parameters
    ----------
    system : without unknown inputs.
    outputs : those to choose from (all); the others are left out.
    costs : of the outputs, 1 each by default.
    seed : of the random points and primes.
    error_bound : wanted, of the probability that any row of the table is wrong.
    limit : most subsets that are examined.

    Raises
    ------
    IdentifiabilityError
        If an output is not there or a cost is no number >= 0, or if there are more subsets than
        `limit`.
    ModelError
        If the system has unknown inputs, or is defined at no point.
    """
    names = tuple(dict.fromkeys(system.outputs if outputs is None else outputs))
    prices = _prices(system, names, costs or {})
    if not names or 2 ** len(names) - 1 > limit:
        raise IdentifiabilityError(
            f"{system.name}: {len(names)} outputs have {2 ** len(names) - 1} non-empty subsets, "
            f"and 1 to {limit} are examined; name fewer in outputs, or raise limit"
        )
    chosen = _measured(system, names)
    spans = OutputSpans(chosen)
    if spans.is_possible:
        ranks, bound, points = _all_points(spans, seed, error_bound)
        certified = True
    else:
        ranks, bound, points, certified = _one_by_one(chosen, seed, error_bound)
    rows = [_row(chosen, s, t, prices) for s, t in ranks.items()]
    order = {y: i for i, y in enumerate(names)}
    rows.sort(key=lambda r: (r.cost, len(r.outputs), [order[y] for y in r.outputs]))
    minimal = _minimal(rows)
    least = min(r.cost for r in minimal)
    return SensorSubsets(
        name=system.name,
        parameters=system.parameters,
        unknowns=spans.unknowns,
        subsets=tuple(rows),
        minimal=minimal,
        cheapest=tuple(r for r in minimal if r.cost == least),
        error_bound=bound,
        is_certified=certified,
        points=points,
    )


def _prices(system: System, names: Sequence[str], costs: Mapping[str, float]) -> dict[str, float]:
    for n in (*names, *costs):
        if n not in system.outputs:
            raise IdentifiabilityError(
                f"{system.name} has no output {n!r}{nearest(n, system.outputs)}"
            )
    for n, c in costs.items():
        if not (math.isfinite(c) and c >= 0):
            raise IdentifiabilityError(f"{n} costs {c!r}; give a number >= 0")
    return {n: float(costs.get(n, 1.0)) for n in names}


def _measured(system: System, names: Sequence[str]) -> System:
    """The system with these outputs only."""
    positions = [system.outputs.index(n) for n in names]
    return system.where(outputs=tuple(names), h=system.h[positions])


def _row(system: System, subset: Subset, found: _Rank, prices: Mapping[str, float]) -> SensorSubset:
    outputs = tuple(system.outputs[i] for i in subset)
    return SensorSubset(
        outputs,
        math.fsum(prices[y] for y in outputs),
        found.rank,
        len(system.parameters) - found.information,
        tuple(q for q, yes in zip(system.parameters, found.identifiable, strict=True) if yes),
    )


def _minimal(rows: Sequence[SensorSubset]) -> tuple[SensorSubset, ...]:
    """Subsets as informative as all: their span is part of that of all, so ranks decide."""
    best = min(r.deficiency for r in rows)
    enough = [r for r in rows if r.deficiency == best]
    sets = [set(r.outputs) for r in enough]
    return tuple(r for r, s in zip(enough, sets, strict=True) if not any(o < s for o in sets))


# -- almost every point: all subsets from one series ----------------------------------------------


def _all_points(
    spans: OutputSpans, seed: int, error_bound: float
) -> tuple[dict[Subset, _Rank], float, int]:
    rng = np.random.default_rng(seed)
    best: dict[Subset, _Rank] = {}
    failures: list[float] = []
    while True:
        here = spans.at(random_prime(rng), rng)
        for subset, found in _sums(here):
            best[subset] = _joined(best.get(subset), found)
        short = [t for t in best.values() if t.rank < spans.unknowns]
        failures.append(spans.failure(here, max((t.rank for t in short), default=0)))
        bound = min(1.0, len(short) * math.prod(failures))
        if bound <= error_bound or len(failures) == MAX_POINTS:
            return best, bound, len(failures)


def _joined(before: _Rank | None, now: _Rank) -> _Rank:
    """The verdicts on which the points of largest rank agree."""
    if before is None or now.rank > before.rank:
        return now
    if now.rank < before.rank:
        return before
    both = tuple(a and b for a, b in zip(before.identifiable, now.identifiable, strict=True))
    return _Rank(now.rank, before.information, both)


def _sums(spans: Spans) -> Iterator[tuple[Subset, _Rank]]:
    """Every subset of the outputs, each from the one without its last member."""
    columns = spans.rows[0].shape[1]
    everything = Basis(columns, spans.prime)
    for rows in spans.rows:
        everything.add(rows)

    def extend(subset: Subset, basis: Basis, found: _Rank | None) -> Iterator[tuple[Subset, _Rank]]:
        """Every larger subset with its rank; ranks below a full one need no elimination."""
        for i in range(subset[-1] + 1 if subset else 0, len(spans.rows)):
            larger = Basis(columns, spans.prime)
            larger.rows, larger.pivots = basis.rows, [*basis.pivots]
            gained = basis.rank < everything.rank and larger.add(spans.rows[i])
            here = found if found is not None and not gained else _rank(larger, spans.n_states)
            yield (*subset, i), here
            yield from extend((*subset, i), larger, here)

    return extend((), Basis(columns, spans.prime), None)


def _rank(basis: Basis, n_states: int) -> _Rank:
    """Rows that begin among the parameters are the information, initial states eliminated."""
    free = [i for i, pivot in enumerate(basis.pivots) if pivot >= n_states]
    information = basis.rows[free, n_states:]
    return _Rank(basis.rank, len(free), tuple(unit_vectors(information)))


# -- special points and kinks: a search for each subset -------------------------------------------


def _one_by_one(
    system: System, seed: int, error_bound: float
) -> tuple[dict[Subset, _Rank], float, int, bool]:
    k = len(system.outputs)
    subsets = [s for size in range(1, k + 1) for s in combinations(range(k), size)]
    ranks: dict[Subset, _Rank] = {}
    total, points, certified = 0.0, 0, True
    for subset in subsets:
        measured = _measured(system, [system.outputs[i] for i in subset])
        found = observability(measured, seed=seed, error_bound=error_bound / len(subsets))
        information = len(system.parameters) - found.deficiency
        ranks[subset] = _Rank(found.rank, information, tuple(found.identifiable.values()))
        total += found.error_bound
        points = max(points, len(found.points))
        certified = certified and found.is_certified
    return ranks, total, points, certified
