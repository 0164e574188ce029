"""Spikes of the residual in turns, with the terms of the simulator switched off one at a time.

The thesis sees about ten times the average at almost every turn entry (Figure 9.17).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

import casid
from analysis.common.output import Output
from analysis.common.targets import Target, at_most, equal
from analysis.ship_algorithm.records import NONE, SIDEWAYS, Disturbance, low_passed
from analysis.ship_algorithm.study import EIGHT, TRUTH, fit
from analysis.ship_basin_turns.figures import residual_figure
from analysis.ship_basin_turns.records import QUIET, SHIPS, Sailed, long_sets
from analysis.ship_basin_turns.residuals import (
    Spikes,
    equation_errors,
    missing_torques,
    predicted_errors,
    spikes,
    with_torques,
)
from casid.arrays import Array
from problems.ship_4dof import Ship

ANGLE = 0.3  # rad
THESIS_PEAK = 10.0  # of the residual at turn entries, in averages


def rms(x: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(x**2)))


def at_commanded_angle(sailed: Sailed) -> casid.Experiment:
    """The record with the commanded rudder angle in the place of the rudder's own."""
    e = sailed.experiment
    return replace(e, record=e.record.with_channel("delta", sailed.cut(sailed.command), "rad"))


def ablation(duration: float) -> list[dict[str, object]]:
    """Spikes with one kind of term off at a time: unfiltered at the truth, and fitted."""
    rows: list[dict[str, object]] = []
    kinds: list[tuple[str, Ship, Disturbance, bool]] = [
        (name, ship, NONE, False) for name, ship in SHIPS.items()
    ]
    kinds.append(("all terms, commanded angle recorded", SIDEWAYS, NONE, True))
    kinds.append(("all terms, a tenth of the disturbances", SIDEWAYS, QUIET, False))
    kinds.append(("all terms, disturbances of ship_algorithm", SIDEWAYS, Disturbance(), False))
    for name, ship, disturbance, commanded in kinds:
        sets = long_sets(duration=duration, angle=ANGLE, ship=ship, disturbance=disturbance)
        raw = [at_commanded_angle(s) if commanded else s.experiment for s in sets]
        filtered = low_passed(raw)
        found = fit(EIGHT, filtered).estimate
        true = spikes(sets, raw, equation_errors(EIGHT, raw, TRUTH))
        through = spikes(sets, filtered, equation_errors(EIGHT, filtered, TRUTH))
        fitted = spikes(sets, filtered, equation_errors(EIGHT, filtered, found.values))
        row: dict[str, object] = {"ship": name}
        for kind, at in (("truth", true), ("truth, 0.5 Hz", through), ("fitted, 0.5 Hz", fitted)):
            row |= {f"{kind}: {k}": v for k, v in at.row().items()}
        rows.append(row | {n: found[n] for n in found.names})
        print(f"    {name:<42}{_short(true)} | {_short(through)} | {_short(fitted)}")
    return rows


def _short(s: Spikes) -> str:
    return f"{s.near:.1e} / {s.elsewhere:.1e} = {s.ratio:5.2f}, peak {s.entries / s.mean:4.1f}"


def terms(sets: Sequence[Sailed]) -> tuple[list[dict[str, object]], float, float]:
    """Predicted spikes by term; rms of the residual at the truth, and of what terms leave of it."""
    experiments = [with_torques(s) for s in sets]
    errors = equation_errors(EIGHT, experiments, TRUTH)
    parts = predicted_errors(EIGHT, experiments, TRUTH)
    rows: list[dict[str, object]] = []
    for term in missing_torques(sets[0]):
        own = {name: found[term] for name, found in parts.items()}
        torque = np.concatenate([missing_torques(s)[term] for s in sets])
        row: dict[str, object] = {"term": term, "rms torque [N m]": rms(torque)}
        rows.append(row | spikes(sets, experiments, own).row())
        print(f"    {term:<42}{_short(spikes(sets, experiments, own))}")
    left = np.concatenate([errors[n] - sum(parts[n].values()) for n in errors])
    return rows, rms(np.concatenate(list(errors.values()))), rms(left)


def residuals(out: Output, *, quick: bool) -> Iterator[Target]:
    """Part 1."""
    duration = 120.0 if quick else 240.0
    sets = long_sets(duration=duration, angle=ANGLE)
    print("-- residuals: rms near changes / elsewhere, peak at entries over the mean\n  by term")
    by_term, whole, left = terms(sets)
    out.table("turns_residual_terms", by_term)
    print("  ships: at the truth | the same through 0.5 Hz | fitted")
    rows = ablation(duration)
    out.table("turns_residual_ablation", rows)
    table = {str(row["ship"]): row for row in rows}

    def at(ship: str, what: str) -> float:
        return float(str(table[ship][what]))

    linear = long_sets(duration=duration, angle=ANGLE, ship=SHIPS["none of them"])
    rule = equation_errors(EIGHT, [s.experiment for s in linear], TRUTH)
    own = rms(np.concatenate(list(rule.values())))
    share = f"left by the terms ({100 * left / whole:.0f} % of it)"
    what = f"residual at the truth: {share}, over the rule's own error on a linear ship"
    yield at_most(what, left / own, 1.5, "times")
    largest = max(by_term, key=lambda row: float(str(row["rms near changes"])))["term"]
    yield equal("the term with the largest error near changes", largest, "speed in K_r r")
    key = "truth: rms near changes"
    single = [n for n in SHIPS if n not in ("all terms", "none of them")]
    cure = min(single, key=lambda n: at(n, key))
    text = f"{cure}: {at(cure, key):.1e} of {at('all terms', key):.1e}"
    what = "off one at a time: the least error near changes"
    yield Target(what, text, "speed held", cure == "speed held")
    yield Target(
        "rate limit off: error near changes",
        f"{at('no rate limit', key) / at('all terms', key):.2f} times",
        ">= 1: the rudder's own angle is recorded, its limit is no cause",
        at("no rate limit", key) >= at("all terms", key),
    )
    key = "fitted, 0.5 Hz: peak at entries / mean"
    others = ", ".join(
        f"{at(n, key):.1f} {what}"
        for n, what in (
            ("no rate limit", "without the rate limit"),
            ("all terms, commanded angle recorded", "with the commanded angle"),
        )
    )
    print(
        f"  the thesis: peaks of {THESIS_PEAK:g} averages at turn entries. Not reproduced, "
        f"{at('all terms', key):.2g} here, fitted, without noise ({others})"
    )
    experiments = low_passed([with_torques(s) for s in sets])
    found = fit(EIGHT, low_passed([s.experiment for s in sets])).estimate
    first = experiments[0]
    fitted = equation_errors(EIGHT, experiments, found.values)[first.name]
    true = equation_errors(EIGHT, experiments, TRUTH)[first.name]
    parts = predicted_errors(EIGHT, experiments, TRUTH)[first.name]
    out.figure("turns_residuals", residual_figure(sets[0], first.record.t, fitted, true, parts))
