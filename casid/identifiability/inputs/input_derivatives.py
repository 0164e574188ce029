"""Arbitrary unknown inputs by counting: each derivative of the input is one more unknown number.

Up to the order k, the outputs hold w, dw/dt, ..., d^k w/dt^k. Let I_k be the span
of their gradients with respect to (x(0), theta), the columns of all these numbers eliminated. Then

    I_{k+1} = (dy + I_k + dI_k/dt) without dw                                                  (1)

because rows in which w cannot be eliminated have independent coefficients, and so do all their
derivatives, in the next derivative of w: they contribute nothing later. So I_k depends on the one
before only; once it is constant it remains so, after at most n + p orders, with n states and p
parameters. This is the structure algorithm on gradients: no equation is solved, so no expression
grows, and w may enter nonlinearly.

The result is that of `elimination` without its equations: for models whose derivatives are too
large to write down, and an independent check for the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casid.algebra.prime_field import random_prime, rank
from casid.identifiability.equations.system import System
from casid.identifiability.inputs.input_classes import as_polynomial
from casid.identifiability.rank.observability import RankEvaluation
from casid.identifiability.rank.rank_result import Observability, PointRank
from casid.time_limit import wall_clock


def observability_by_counting(
    systems: System | Sequence[System],
    *,
    seed: int = 0,
    error_bound: float = 1e-12,
    time_limit: float | None = None,
) -> Observability:
    """Rank and verdicts for arbitrary unknown inputs, each experiment's own.

    Parameters
    ----------
    systems : with unknown inputs. Experiments that share one are merged before (`merge`).
    seed, error_bound, time_limit : as in `observability`.

    Returns
    -------
    Observability of parameters and initial states; the unknown inputs are not counted. In its
    `points`, the derivatives of the unknown inputs are among the states. Where time runs out, what
    is called identifiable is proven nevertheless.

    Raises
    ------
    ModelError
        As `observability`.
    """
    given = (systems,) if isinstance(systems, System) else tuple(systems)
    parameters = {p for s in given for p in s.parameters}
    enough = max((len(s.states) for s in given), default=0) + len(parameters)
    once = {id(s): as_polynomial(s, enough) for s in given}
    search = RankEvaluation([once[id(s)] for s in given])
    deadline = math.inf if time_limit is None else wall_clock() + time_limit
    rng = np.random.default_rng(seed)
    points: list[PointRank] = []
    failure, is_cut = 1.0, False
    while failure > error_bound and not is_cut:
        point = search.at(random_prime(rng), rng, deadline=deadline, max_order=enough)
        points.append(point)
        best = max(p.rank for p in points)
        failure = math.prod(search.failure(best, p.orders) for p in points)
        if best == search.unknowns:
            failure = 0.0
        is_short = point.is_partial and min(point.orders) < enough
        is_cut = wall_clock() > deadline and (is_short or failure > error_bound)
    verdict = search.verdict(points, failure)
    inputs = [_input_rows(verdict.points[0], i, s) for i, s in enumerate(given)]
    total = verdict.rank - sum(known for known, _ in inputs)
    unknowns = verdict.unknowns - sum(count for _, count in inputs)
    return replace(
        verdict,
        systems=given,
        rank=total,
        unknowns=unknowns,
        is_partial=is_cut,
        is_certified=not is_cut and all(s.is_generic for s in given),
        error_bound=math.nan if is_cut else failure,
        observable=tuple(
            {x: found[x] for x in s.states}
            for s, found in zip(given, verdict.observable, strict=True)
        ),
    )


def _input_rows(point: PointRank, i: int, system: System) -> tuple[int, int]:
    """Rank and number of the columns of an experiment's unknown inputs and their derivatives."""
    own = set(system.states)
    columns = [j for j, x in enumerate(point.states[i]) if x not in own]
    return (rank(point.full[i][:, columns], point.prime) if columns else 0), len(columns)
