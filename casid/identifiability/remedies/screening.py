"""Effects of sets of candidates, at one point of the parameters that all experiments share.

Each experiment's rows are computed once for every set of sensors. A known value leaves out its
column; an experiment or a replica adds its rows. So candidate sets are compared by linear algebra.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.algebra.prime_field import echelon, random_prime
from casid.algebra.row_basis import unit_vectors
from casid.arrays import Array
from casid.errors import IdentifiabilityError, nearest
from casid.identifiability.equations.system import System
from casid.identifiability.rank.observability import RankEvaluation
from casid.identifiability.rank.rank_result import PointRank
from casid.identifiability.remedies.candidates import Candidate, can_mount, check, with_sensor

Prepare = Callable[[System], System]
Origin = tuple[int, int]  # candidate (-1: there already), number among its experiments


@dataclass(frozen=True, slots=True)
class Effect:
    """The effect of some candidates together.

    Attributes
    ----------
    candidates, cost : what is added.
    gained : parameters that become identifiable, or are known then.
    missing : those of the goal that remain unidentifiable.
    deficiency : dimension of the remaining unidentifiable directions of the parameters.
    """

    candidates: tuple[Candidate, ...]
    cost: float
    gained: tuple[str, ...]
    missing: tuple[str, ...]
    deficiency: int

    @property
    def is_remedy(self) -> bool:
        """True if nothing of the goal is missing."""
        return not self.missing

    def __str__(self) -> str:
        return " and ".join(str(c) for c in self.candidates)

    def to_json(self) -> dict[str, Any]:
        """Plain lists and numbers."""
        return {
            "candidates": [{"kind": c.kind, "label": c.label} for c in self.candidates],
            "cost": self.cost,
            "gained": list(self.gained),
            "missing": list(self.missing),
            "deficiency": self.deficiency,
        }


class Screening:
    """All candidates at one point of the parameters."""

    def __init__(
        self,
        systems: System | Sequence[System],
        candidates: Sequence[Candidate],
        prepare: Prepare | None,
        goal: Sequence[str] | None,
        rng: np.random.Generator,
    ) -> None:
        self.base = (systems,) if isinstance(systems, System) else tuple(systems)
        self.candidates, self.prepare, self._rng = tuple(candidates), prepare, rng
        added = [s for c in self.candidates for s in c.systems]
        check(self.candidates, (*self.base, *added))
        self.parameters = tuple(
            dict.fromkeys(q for s in (*self.base, *added) for q in s.parameters)
        )
        there = tuple(dict.fromkeys(q for s in self.base for q in s.parameters))
        self.goal = there if goal is None else tuple(dict.fromkeys(goal))
        for q in self.goal:
            if q not in there:
                raise IdentifiabilityError(f"goal: there is no parameter {q!r}{nearest(q, there)}")
        self._prepared: dict[Any, System] = {}
        self._points: dict[Any, PointRank] = {}
        # A point where everything is defined: the largest problem says which.
        self.prime = random_prime(rng)
        every = [s for _, s in self._experiments(range(len(self.candidates)))]
        self.values = RankEvaluation(every).at(self.prime, rng).values
        self._before = self._identified(())

    def effect(self, chosen: Sequence[int]) -> Effect:
        """The effect of these candidates together, at the point."""
        found, deficiency = self._identified(chosen)
        before = self._before[0]
        own = tuple(self.candidates[i] for i in chosen)
        return Effect(
            own,
            math.fsum(c.cost for c in own),
            tuple(q for q in self.parameters if q in found and q not in before),
            tuple(q for q in self.goal if q not in found),
            deficiency,
        )

    def systems(self, chosen: Sequence[int]) -> list[System]:
        """The experiments with these candidates added."""
        own = [self.candidates[i] for i in chosen]
        known = {c.label for c in own if c.kind == "known parameter"}
        out = []
        for (original, _), s in self._experiments(chosen):
            initial = [x for x in self._known_states(own, original) if x in s.states]
            initial = [x for x in initial if x not in (*s.known_initial, *s.initial_values)]
            fixed = [q for q in s.parameters if q in known]
            out.append(s.with_known(*fixed).where(known_initial=(*s.known_initial, *initial)))
        return out

    # -- inside -------------------------------------------------------------------------------

    def _experiments(self, chosen: Sequence[int]) -> list[tuple[tuple[System, Origin], System]]:
        """(the experiment as given, its origin), and its equations with sensors."""
        originals = [(s, (-1, k)) for k, s in enumerate(self.base)]
        for i in chosen:
            c = self.candidates[i]
            if c.kind == "experiment":
                more = c.systems or [s for s in self.base if c.concerns(s)]
                originals += [(s, (i, k)) for k, s in enumerate(more)]
        own = [self.candidates[i] for i in chosen]
        return [((s, origin), self._with_sensors(s, own)) for s, origin in originals]

    def _with_sensors(self, system: System, own: Sequence[Candidate]) -> System:
        sensors = [c for c in own if c.kind == "sensor" and can_mount(c, system)]
        key = (id(system), *map(id, sensors))
        if key not in self._prepared:
            for c in sensors:
                system = with_sensor(system, c)
            self._prepared[key] = self.prepare(system) if self.prepare else system
        return self._prepared[key]

    def _known_states(self, own: Sequence[Candidate], original: System) -> list[str]:
        return [c.label for c in own if c.kind == "known initial state" and c.concerns(original)]

    def _identified(self, chosen: Sequence[int]) -> tuple[frozenset[str], int]:
        """Parameters that are identifiable or known, and the deficiency of the others."""
        own = [self.candidates[i] for i in chosen]
        known = {c.label for c in own if c.kind == "known parameter"}
        index = {q: i for i, q in enumerate(q for q in self.parameters if q not in known)}
        parts, present = [], set()
        for (original, origin), system in self._experiments(chosen):
            point = self._point(system, origin)
            present |= {q for q in point.parameters if q in index}
            parts.append(self._information(point, self._known_states(own, original), index))
        joint = echelon(np.vstack(parts), self.prime)[0]
        found = {q for q, yes in zip(index, unit_vectors(joint), strict=True) if yes}
        return frozenset(found | known), len(present) - len(joint)

    def _point(self, system: System, origin: Origin) -> PointRank:
        key = (id(system), origin)
        if key not in self._points:
            search = RankEvaluation(system)
            self._points[key] = search.at(self.prime, self._rng, values=self.values)
        return self._points[key]

    def _information(
        self, point: PointRank, known_states: Sequence[str], index: dict[str, int]
    ) -> Array:
        """The information of an experiment on the unknown parameters, over all of them."""
        (full,), (states,) = point.full, point.states
        free = [i for i, x in enumerate(states) if x not in known_states]
        ahead = len(free)
        if ahead < len(states):
            columns = [*free, *range(len(states), full.shape[1])]
            full = echelon(full[:, columns], self.prime)[0]
        rows = full[~full[:, :ahead].any(axis=1), ahead:]
        wide = np.zeros((len(rows), len(index)), dtype=np.int64)
        for j, q in enumerate(point.parameters):
            if q in index:
                wide[:, index[q]] = rows[:, j]
        return wide
