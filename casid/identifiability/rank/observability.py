"""The observability rank of one or several experiments, exactly, with an error bound.

Each experiment's series of sensitivities is reduced order by order until an order adds nothing:
then no later one does, at almost every point (Sedoglavic 2002; Linder 2017, section 2.7). The
information of an experiment on the parameters is the span of its rows after elimination of its
initial states; that of several experiments is the sum. Full rank at one point modulo one prime is a
proof. A deficiency is repeated at points and primes of their own until its error probability is
below the bound.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.algebra.prime_field import echelon, random_prime, to_field
from casid.algebra.row_basis import Basis, leading, padded
from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.errors import ModelError
from casid.identifiability.equations.system import System
from casid.identifiability.rank.error_bound import failure_probabilities
from casid.identifiability.rank.rank_result import Observability, PointRank
from casid.identifiability.rank.series import Schedule, Series, SpecialPoint
from casid.time_limit import wall_clock

ATTEMPTS = 40
"""Points tried modulo one prime (a square root exists at every second one)."""

PRIMES = 20
"""Primes tried before a model is refused as defined at no point."""

PATIENCE = 16
"""At special values the series ends after so many orders that add nothing (or n + 1)."""

MAX_KINKS = 4
"""Up to so many kinks (abs, sign) in one experiment, every choice of sides is evaluated."""


@names_wrong_types()
def observability(
    systems: System | Sequence[System],
    *,
    seed: int = 0,
    error_bound: float = 1e-12,
    time_limit: float | None = None,
    max_order: int | None = None,
    primes: Sequence[int] | None = None,
) -> Observability:
    """Rank and verdicts for experiments that share parameters (and constants) by name.

    Parameters
    ----------
    systems : one for each experiment, without unknown inputs.
    seed : of the random points and primes.
    error_bound : largest error probability of a deficiency.
    time_limit : seconds after which what is proven so far is returned.
    max_order : highest derivative; by default as many as raise the rank.
    primes : instead of random ones; there is one point for each.

    Raises
    ------
    ModelError
        If a system has unknown inputs left, or is defined at no point.

    Example
    -------
    >>> import casid
    >>> decay = {"states": ["x"], "params": ["a"], "equations": {"x": "-a*x"},
    ...          "outputs": {"y": "x"}}
    >>> casid.observability(casid.parse_system(decay))
    <Observability: rank 2 of 2>
    """
    search = RankEvaluation(systems)
    deadline = math.inf if time_limit is None else wall_clock() + time_limit
    rng = np.random.default_rng(seed)
    points: list[PointRank] = []
    failure = 1.0
    while True:
        given = primes[len(points) : len(points) + 1] if primes is not None else None
        point = _somewhere(search, rng, given, deadline, max_order)
        points.append(point)
        if point.is_partial or point.rank == search.unknowns:
            break
        best = max(p.rank for p in points)
        last = search.failure(best, points[-1].orders)
        failure = math.prod(search.failure(best, p.orders) for p in points)
        enough = len(points) == len(primes) if primes is not None else failure <= error_bound
        if enough or last == 1.0:  # degrees beyond the prime: no number of points would do
            break
        if wall_clock() > deadline:
            points[-1] = replace(point, is_partial=True)
            break
    return search.verdict(points, failure, deadline=deadline)


def _somewhere(
    search: RankEvaluation,
    rng: np.random.Generator,
    primes: Sequence[int] | None,
    deadline: float,
    max_order: int | None,
) -> PointRank:
    """The rank at a random point; a root of a special value exists modulo every second prime."""
    failed: ModelError | None = None
    for prime in primes or (random_prime(rng) for _ in range(PRIMES)):
        try:
            return search.at(prime, rng, deadline=deadline, max_order=max_order)
        except ModelError as problem:
            failed = problem
    assert failed is not None
    raise failed


def rank_at(
    systems: System | Sequence[System],
    prime: int,
    *,
    values: Mapping[str, int] | None = None,
    rng: np.random.Generator,
) -> PointRank:
    """The rank at one point: `values` where they name a parameter or constant, random elsewhere."""
    return RankEvaluation(systems).at(prime, rng, values=values)


class RankEvaluation:
    """The rank of several experiments, prepared for evaluation at any number of points.

    Raises
    ------
    ModelError
        If a system has unknown inputs left, or holds a function that cannot be immersed.
    """

    def __init__(self, systems: System | Sequence[System]) -> None:
        self.systems = (systems,) if isinstance(systems, System) else tuple(systems)
        if not self.systems:
            raise ModelError("no experiment given; name at least one system")
        for s in self.systems:
            if s.unknown_inputs:
                raise ModelError(
                    f"{s.name}: {', '.join(s.unknown_inputs)} is an unknown input; eliminate it, "
                    "or choose a class of signals for it"
                )
        made: dict[int, Schedule] = {}
        self.schedules = [made.setdefault(id(s), Schedule(s)) for s in self.systems]
        self.parameters = tuple(dict.fromkeys(p for s in self.systems for p in s.parameters))
        self.unknowns = len(self.parameters) + sum(len(_free_states(s)) for s in self.systems)
        self.bytes = 0
        self._failures: dict[tuple[int, tuple[int, ...]], float] = {}

    def at(
        self,
        prime: int,
        rng: np.random.Generator,
        *,
        values: Mapping[str, int] | None = None,
        deadline: float = math.inf,
        max_order: int | None = None,
    ) -> PointRank:
        """The rank at one point; what is not among `values` is drawn.

        `values` may name parameters, constants and initial states (of all experiments).
        """
        reason = ""
        for _ in range(ATTEMPTS):
            drawn = self._values(prime, rng, values or {})
            try:
                return self._at(prime, rng, drawn, deadline, max_order)
            except SpecialPoint as problem:
                reason = problem.function
            except ZeroDivisionError:
                reason = f"a number in the equations has a denominator divisible by {prime}"
        raise ModelError(
            f"{self.systems[0].name}: no point was found where the model is defined: {reason} at "
            f"{ATTEMPTS} random points. Look for a division by something that is zero whatever "
            "the parameters are, or for special values that make it zero"
        )

    def failure(self, rank: int, orders: Sequence[int]) -> float:
        """Bound on the probability that a point shows too small a rank or a wrong verdict.

        One event for each order at which the series may have stopped too early, and one for each
        verdict; where experiments differ, a minor has at most as many rows of each as in all.
        """
        if (rank, tuple(orders)) in self._failures:
            return self._failures[rank, tuple(orders)]
        known = sum(len(s.states) - len(_free_states(s)) for s in self.systems)
        columns = self.unknowns + known
        copies: dict[int, list[int]] = {}  # position of a schedule -> orders of its experiments
        for schedule, order in zip(self.schedules, orders, strict=True):
            copies.setdefault(self.schedules.index(schedule), []).append(order)
        total = 0.0
        for i, own in copies.items():
            single = failure_probabilities(
                self.schedules[i].program, rank + known, max(own), columns=columns, copies=len(own)
            )
            total += len(own) * sum(single) + self.unknowns * single[-1]
        self._failures[rank, tuple(orders)] = min(1.0, total)
        return self._failures[rank, tuple(orders)]

    def verdict(
        self, points: Sequence[PointRank], failure: float, *, deadline: float = math.inf
    ) -> Observability:
        """The verdicts on which all points of largest rank agree."""
        rank = max(p.rank for p in points)
        best = tuple(p for p in points if p.rank == rank)
        verdicts = np.all([p.identifiable() for p in best], axis=0)
        identifiable = dict(zip(self.parameters, verdicts.tolist(), strict=True))
        observable = []
        for i, system in enumerate(self.systems):
            of_states = np.all([p.observable()[i] for p in best], axis=0)
            verdict = dict(zip(best[0].states[i], np.atleast_1d(of_states).tolist(), strict=True))
            observable.append({x: bool(verdict.get(x, True)) for x in system.states})
        partial = any(p.is_partial for p in points) and rank < self.unknowns
        is_full = rank == self.unknowns
        return Observability(
            systems=self.systems,
            parameters=self.parameters,
            rank=rank,
            unknowns=self.unknowns,
            error_bound=0.0 if is_full else math.nan if partial else failure,
            is_partial=partial,
            is_certified=is_full or (not partial and self._is_certified(rank, deadline)),
            orders=best[0].orders,
            points=best,
            identifiable=identifiable,
            observable=tuple(observable),
            deficiency=len(self.parameters) - len(best[0].information),
            immersed=tuple(dict.fromkeys(f for s in self.schedules for f in s.program.immersed)),
            has_kinks=any(s.program.kinks for s in self.schedules),
            bytes=self.bytes,
        )

    def _is_certified(self, rank: int, deadline: float) -> bool:
        """True if no later derivative can raise the rank.

        The stopping rule holds at almost every point; elsewhere the rank there is a bound.
        """
        if any(len(s.program.kinks) > MAX_KINKS for s in self.schedules):
            return False
        if all(s.is_generic for s in self.systems):
            return True
        generic = [
            s.where(known_initial=(*s.known_initial, *s.initial_values), initial_values={}, at={})
            for s in self.systems
        ]
        left = None if deadline == math.inf else max(deadline - wall_clock(), 0.0)
        found = observability(generic, seed=1, time_limit=left)
        return found.rank == rank and not found.is_partial

    # -- one point ----------------------------------------------------------------------------

    def _values(self, p: int, rng: np.random.Generator, given: Mapping[str, int]) -> dict[str, int]:
        names = dict.fromkeys(n for s in self.systems for n in (*s.parameters, *s.constants))
        drawn = rng.integers(1, p, len(names)).tolist()
        values = dict(zip(names, drawn, strict=True))
        for n in values:
            held = {s.at.get(n) for s in self.systems if n in (*s.parameters, *s.constants)}
            number = next(iter(held)) if len(held) == 1 else None
            if number is not None:
                values[n] = to_field(number, p)
        known = {*values, *(x for s in self.systems for x in s.states)}
        return values | {n: int(v) % p for n, v in given.items() if n in known}

    def _at(
        self,
        p: int,
        rng: np.random.Generator,
        values: dict[str, int],
        deadline: float,
        max_order: int | None,
    ) -> PointRank:
        reduced: list[Array] = []
        orders: list[int] = []
        partial = False
        index = {n: i for i, n in enumerate(self.parameters)}
        for schedule in self.schedules:
            system = schedule.system
            rows = []
            order = 0
            for branches in _branches(len(schedule.program.kinks), rng):
                rows_, order_, cut = self._reduce(
                    schedule, values, p, rng, branches, deadline, max_order
                )
                rows.append(rows_)
                order, partial = max(order, order_), partial or cut
            orders.append(order)
            reduced.append(_spread(rows, system, index, p))
        states = tuple(_free_states(s) for s in self.systems)
        reduced_rows = [
            full[leading(full, len(x)) :, len(x) :] for full, x in zip(reduced, states, strict=True)
        ]
        several = len(reduced_rows) > 1
        information = echelon(np.vstack(reduced_rows), p)[0] if several else reduced_rows[0]
        if several:
            reduced = [
                echelon(np.vstack([full, padded(information, len(x))]), p)[0]
                for full, x in zip(reduced, states, strict=True)
            ]
        return PointRank(
            p, self.parameters, values, information, tuple(reduced), states, tuple(orders), partial
        )

    def _reduce(
        self,
        schedule: Schedule,
        values: Mapping[str, int],
        p: int,
        rng: np.random.Generator,
        branches: Sequence[int],
        deadline: float,
        max_order: int | None,
    ) -> tuple[Array, int, bool]:
        """Echelon form of an experiment's rows, the orders used, and whether it was cut."""
        system = schedule.system
        initial = {x: values.get(x, int(rng.integers(1, p))) for x in system.states}
        initial |= {x: to_field(v, p) for x, v in system.initial_values.items()}
        held = {n: to_field(v, p) for n, v in system.at.items()}
        series = Series(schedule, {**values, **held, **initial}, p, rng, branches)
        full = schedule.n_columns
        patience = 1 if system.is_generic else max(full + 1, PATIENCE)
        basis = Basis(full, p)
        idle = 0
        for order, rows in enumerate(series.rows()):
            gained = basis.add(rows)
            self.bytes = max(self.bytes, series.bytes)
            idle = 0 if gained else idle + 1
            if basis.rank == full or idle >= patience:
                return basis.rows, order, False
            if order == max_order or wall_clock() > deadline:
                return basis.rows, order, True
        raise AssertionError("a series has no end")


def _spread(parts: Sequence[Array], system: System, index: Mapping[str, int], p: int) -> Array:
    """Rows over [free initial states | all parameters] in echelon form; branches joined."""
    free = [i for i, x in enumerate(system.states) if x in set(_free_states(system))]
    nx, n = len(system.states), len(index)
    joined: list[Array] = []
    for part in parts:
        wide = np.zeros((len(part), len(free) + n), dtype=np.int64)
        wide[:, : len(free)] = part[:, free]
        wide[:, [len(free) + index[q] for q in system.parameters]] = part[:, nx:]
        joined.append(echelon(wide, p)[0])
    if len(joined) == 1:
        return joined[0]
    # Each side of a kink has states of its own: its information on the parameters adds.
    information = [m[leading(m, len(free)) :] for m in joined]
    best = max(joined, key=len)
    return echelon(np.vstack([best, *information]), p)[0]


def _branches(kinks: int, rng: np.random.Generator) -> list[list[int]]:
    """Signs of the kinks: all choices, or a sample where they are many."""
    if kinks <= MAX_KINKS:
        return [list(c) for c in itertools.product((1, -1), repeat=kinks)]
    sample = [[int(v) for v in rng.choice([-1, 1], kinks)] for _ in range(2**MAX_KINKS - 2)]
    return [[1] * kinks, [-1] * kinks, *sample]


def _free_states(system: System) -> tuple[str, ...]:
    known = {*system.known_initial, *system.initial_values}
    return tuple(x for x in system.states if x not in known)
