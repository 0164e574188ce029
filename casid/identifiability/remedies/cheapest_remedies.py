"""The cheapest remedies of a deficiency: sensors, experiments, replicas, known values.

Candidate sets are compared at one random point (`screening`); the set that is chosen is then
decided by `observability`, with its error bound.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.identifiability.equations.system import System
from casid.identifiability.rank.observability import observability
from casid.identifiability.rank.rank_result import Observability
from casid.identifiability.remedies.candidates import Candidate
from casid.identifiability.remedies.candidates import experiment as experiment
from casid.identifiability.remedies.candidates import known_initial_state as known_initial_state
from casid.identifiability.remedies.candidates import known_parameter as known_parameter
from casid.identifiability.remedies.candidates import replica as replica
from casid.identifiability.remedies.candidates import sensor as sensor
from casid.identifiability.remedies.replicas import ReplicasNeeded as ReplicasNeeded
from casid.identifiability.remedies.replicas import replicas_needed as replicas_needed
from casid.identifiability.remedies.screening import Effect, Prepare, Screening
from casid.identifiability.remedies.sensor_subsets import SensorSubset as SensorSubset
from casid.identifiability.remedies.sensor_subsets import SensorSubsets as SensorSubsets
from casid.identifiability.remedies.sensor_subsets import sensor_subsets as sensor_subsets


@dataclass(frozen=True, slots=True)
class Remedies:
    """The effect of each candidate alone, and the cheapest set that reaches the goal.

    Attributes
    ----------
    goal : parameters that are to be identifiable.
    before : with nothing added.
    singles : each candidate alone; remedies first, by cost, then the others by the number of
        parameters still missing.
    together : with all candidates. If they do not reach the goal, none of their subsets does.
    cheapest : the cheapest remedies, smaller sets first, as found at one random point; `verdict`
        decides the first. Empty if there is none.
    verdict : the decision about the first of `cheapest`, with its error bound.
    looked_at : number of candidate sets that were compared.
    is_cut : sets that were not compared might be remedies of less cost.
    has_more : other sets might be remedies of the same cost.
    """

    goal: tuple[str, ...]
    before: Effect
    singles: tuple[Effect, ...]
    together: Effect
    cheapest: tuple[Effect, ...]
    verdict: Observability | None
    looked_at: int
    is_cut: bool
    has_more: bool

    def __str__(self) -> str:
        if self.before.is_remedy:
            return f"no remedy is needed: {', '.join(self.goal)}: identifiable"
        lines = [
            f"not identifiable: {', '.join(self.before.missing)} (deficiency "
            f"{self.before.deficiency})",
            "    cost  deficiency  missing  adding",
        ]
        idle = []
        for e in self.singles:
            if not e.gained and e.deficiency >= self.before.deficiency:
                idle.append(str(e))
                continue
            lines.append(
                f"{'*' if e.is_remedy else ' '} {e.cost:6g}  {e.deficiency:10d}  "
                f"{len(e.missing):7d}  {e}: gives {', '.join(e.gained) or 'no parameter yet'}"
            )
        if idle:
            lines.append(f"nothing is gained by one of these alone: {', '.join(idle)}")
        return "\n".join([*lines, *self.conclusion])

    @property
    def conclusion(self) -> list[str]:
        """The cheapest remedy and how certain it is, or why there is none; lines."""
        if not self.together.is_remedy:
            missing = ", ".join(self.together.missing)
            return [f"all candidates together are no remedy: {missing} remain unidentifiable"]
        if not self.cheapest or self.verdict is None:
            return ["the random point was special, and no set was confirmed; try another seed"]
        lines = [f"cheapest remedy: {self.cheapest[0]} (cost {self.cheapest[0].cost:g})"]
        if self.verdict.is_full:
            lines.append("  full rank: a proof")
        else:
            bound = self.verdict.error_bound
            lines.append(f"  probability that this is wrong: below {bound:.1e}")
        lines += [f"  as cheap: {e}" for e in self.cheapest[1:]]
        if self.is_cut:
            lines.append("  others might be cheaper: raise max_size or limit to compare more sets")
        elif self.has_more:
            lines.append("  others might be as cheap: raise max_size or limit to compare more sets")
        return [*lines, "  all other rows were found at one random point"]

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers."""
        return {
            "goal": list(self.goal),
            "before": self.before.to_json(),
            "singles": [e.to_json() for e in self.singles],
            "together": self.together.to_json(),
            "cheapest": [e.to_json() for e in self.cheapest],
            "error_bound": None if self.verdict is None else self.verdict.error_bound,
            "looked_at": self.looked_at,
            "is_cut": self.is_cut,
            "has_more": self.has_more,
        }


def cheapest_remedies(
    systems: System | Sequence[System],
    candidates: Sequence[Candidate],
    *,
    goal: Sequence[str] | None = None,
    max_size: int = 3,
    prepare: Prepare | None = None,
    seed: int = 0,
    error_bound: float = 1e-12,
    limit: int = 2000,
) -> Remedies:
    """Each candidate's effect, and the cheapest set of candidates that reaches the goal.

    Parameters
    ----------
    systems : the given experiments; with unknown inputs, if `prepare` eliminates them.
    candidates : made by `sensor`, `experiment`, `replica`, `known_parameter` and
        `known_initial_state`. A sensor is mounted in the added experiments, too.
    goal : parameters that are to be identifiable (all); one that becomes known counts.
    max_size : of the sets that are compared. A larger set is returned where no such set is a
        remedy: all candidates without those that can be spared, the dearest spared first.
    prepare : is applied to each system once its sensors are there, such as the elimination of
        unknown inputs.
    seed : of the random points and primes.
    error_bound : largest error probability of the verdict.
    limit : most sets that are compared, the cheapest first.

    Raises
    ------
    IdentifiabilityError
        If the goal or a candidate has an unknown name.
    ModelError
        If a sensor's formula cannot be read, or unknown inputs are left.

    Example
    -------
    >>> import casadi as ca
    >>> from casid import System, sensor
    >>> from casid.identifiability.remedies.candidates import experiment
    >>> from casid.identifiability.remedies.cheapest_remedies import cheapest_remedies
    >>> F, m, dm, v = (ca.SX.sym(n) for n in ("F", "m", "dm", "v"))
    >>> symbols = {"F": F, "m": m, "v": v}
    >>> nominal = System("nominal", ("v",), ("F", "m"), ("a",), symbols, F / m, F / m)
    >>> loaded = System("loaded", ("v",), ("F", "m"), ("a",), {**symbols, "dm": dm},
    ...                 F / (m + dm), F / (m + dm), constants=("dm",))
    >>> found = cheapest_remedies(nominal, [sensor("force", "F", 3.0), experiment("load", loaded)])
    >>> str(found.cheapest[0])
    'experiment load'
    """
    screening = Screening(systems, candidates, prepare, goal, np.random.default_rng(seed))
    everything = tuple(range(len(candidates)))
    before, together = screening.effect(()), screening.effect(everything)
    singles = [screening.effect((i,)) for i in everything]
    singles.sort(
        key=lambda e: (e.cost if e.is_remedy else math.inf, len(e.missing), e.deficiency, e.cost)
    )
    search = _Search(screening, seed, error_bound)
    if not before.is_remedy and together.is_remedy:
        search.spare(everything)
        search.compare(max_size, limit)
    return Remedies(
        goal=screening.goal,
        before=before,
        singles=tuple(singles),
        together=together,
        cheapest=tuple(search.found),
        verdict=search.verdict,
        looked_at=search.looked_at,
        is_cut=search.is_cut,
        has_more=search.has_more,
    )


class _Search:
    """The cheapest remedies so far, of one cost, the first of them decided."""

    def __init__(self, screening: Screening, seed: int, error_bound: float) -> None:
        self.screening = screening
        self.costs = [c.cost for c in screening.candidates]
        self._options: dict[str, Any] = {"seed": seed, "error_bound": error_bound}
        self.found: list[Effect] = []
        self.verdict: Observability | None = None
        self.looked_at = 0
        self.is_cut = self.has_more = False

    def spare(self, chosen: tuple[int, ...]) -> None:
        """All candidates that cannot be spared: a first remedy, and a bound on the cost.

        Where all candidates are known parameters it is the cheapest: the greedy set of a matroid.
        """
        for i in sorted(chosen, key=lambda i: (-self.costs[i], -i)):
            fewer = tuple(j for j in chosen if j != i)
            if self.screening.effect(fewer).is_remedy:
                chosen = fewer
        self._take(chosen)

    def compare(self, max_size: int, limit: int) -> None:
        """Sets up to a size, the cheapest first, until they cost more than the remedy found."""
        for chosen in self._by_cost(max_size):
            cost = self._cost(chosen)
            if self.found and cost > self.found[0].cost:
                break
            if self.looked_at == limit:
                self.is_cut = not self.found or cost < self.found[0].cost
                self.has_more = True
                break
            self.looked_at += 1
            if self.screening.effect(chosen).is_remedy:
                self._take(chosen)
        least = math.fsum(sorted(self.costs)[: max_size + 1])
        if len(self.costs) > max_size:  # larger sets cost at least that
            self.is_cut |= not self.found or least < self.found[0].cost
            self.has_more |= bool(self.found) and least <= self.found[0].cost

    def _by_cost(self, max_size: int) -> Iterator[tuple[int, ...]]:
        """Sets of candidates, the cheapest first, the smallest first among equals; lazily."""
        cheap = sorted(range(len(self.costs)), key=lambda i: self.costs[i])

        def entry(places: tuple[int, ...]) -> tuple[float, int, tuple[int, ...]]:
            return (self._cost([cheap[k] for k in places]), len(places), places)

        heap = [entry((0,))] if cheap and max_size > 0 else []
        while heap:
            _, size, places = heapq.heappop(heap)
            yield tuple(sorted(cheap[k] for k in places))
            following = places[-1] + 1  # each set is reached once: its last member moves on ...
            if following < len(cheap):
                heapq.heappush(heap, entry((*places[:-1], following)))
                if size < max_size:  # ... or the next one joins
                    heapq.heappush(heap, entry((*places, following)))

    def _cost(self, chosen: Sequence[int]) -> float:
        return math.fsum(self.costs[i] for i in chosen)

    def _take(self, chosen: tuple[int, ...]) -> None:
        """Keep a remedy found at the point: the first of a cost only if that is decided."""
        effect = self.screening.effect(chosen)
        members = {*effect.candidates}
        if any({*e.candidates} <= members for e in self.found):
            return
        is_as_cheap = bool(self.found) and effect.cost == self.found[0].cost
        if is_as_cheap and len(members) >= len(self.found[0].candidates):
            self.found.append(effect)
            return
        verdict = observability(self.screening.systems(chosen), **self._options)
        if all(verdict.identifiable.get(q, True) for q in self.screening.goal):
            self.found, self.verdict = [effect, *self.found] if is_as_cheap else [effect], verdict
