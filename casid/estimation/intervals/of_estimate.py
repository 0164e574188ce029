"""Intervals into the rows of an estimate."""

from __future__ import annotations

from dataclasses import replace

from casid.estimation.estimate import Estimate, Estimated
from casid.estimation.intervals.choice import SOURCES, Chosen


def with_intervals(estimate: Estimate, chosen: Chosen) -> Estimate:
    """The estimate, in SI, with its intervals and what they assume."""

    def row(p: Estimated) -> Estimated:
        if p.name not in chosen.ends:
            return p
        return replace(p, ends=chosen.ends[p.name], interval_kind=chosen.kinds[p.name])

    kinds = dict.fromkeys(chosen.kinds.values())
    papers = [paper for kind in kinds for paper in SOURCES[kind]]
    origin = replace(estimate.origin, sources=(*estimate.sources, *papers))
    return replace(
        estimate,
        parameters=tuple(row(p) for p in estimate.parameters),
        initial_states=tuple(row(p) for p in estimate.initial_states),
        uncertainty=replace(estimate.uncertainty, intervals=dict(chosen.assumes)),
        warnings=(*estimate.warnings, *chosen.warnings),
        origin=origin,
    )
