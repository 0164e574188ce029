"""Record lengths at which two causes are told apart with 95 %: designed inputs and searched ones.

    python -m analysis.designed_experiments --out DIR [--pair "cart drag"] [--runs 200] [--jobs 1]
                                            [--fits] [--quick] [--summary] [--ship]

For each pair the shortest designed record is sought, and under the same limits the shortest of the
best of 200 multisines and PRBS that are drawn at each length. The causes are faint, so that both
records are long against the system's time constants: in a short record the energy of the misfit
grows with a power of the length (`growth`, 2 to 5), and a gain in energy is the gain in length to
that power. The right names are counted in simulated records of the designed input, truth and rival
fitted to each, and each diagnosed with the whole catalogue (not with `--fits`). Every finished pair
is a line of DIR/pairs.jsonl at once: a run that was stopped goes on where it was. `--summary`
judges the pairs that are there. `--ship` answers the questions of `ship` alone: the rudder, and the
calibration, with which an unknown load is known best.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.stats import binomtest

import casid
from analysis.common.case_file import Row, finished, last_rows
from analysis.common.figures import Chart
from analysis.common.output import Output
from analysis.common.runner import Run, Study, jobs
from analysis.common.targets import Target, holds
from analysis.designed_experiments import ship
from analysis.designed_experiments.pairs import PAIRS, Pair

SEARCHED = ("PRBS", "multisine")
LONGEST = 6.0  # times the designed record, up to where the searched inputs are tried
PAIRS_WANTED, SYSTEMS_WANTED = 8, 5
HALVED = 2.0  # times the standard errors of the designed rudder, in a zigzag
LEAST, OFTEN = 3.0, 5.0  # times as long: for every pair, for half of them
NEAR = 4  # designs whose energies are nearest to the one wanted, by which its growth is judged
LEVEL = 0.01  # of the test that shares agree with what was predicted, for all pairs together


def compared(
    pair: Pair, *, runs: int, candidates: int, seconds: float, by: Literal["diagnoses", "fits"]
) -> Row:
    """Both record lengths of a pair, and the check of the designed one."""
    began = time.process_time()
    problem, aim = pair.problem(), casid.Aim.separate(*pair.causes)
    designed = casid.design_experiment(
        problem,
        aim,
        pair.limits,
        pair.duration,
        sizes=pair.sizes,
        Ts=pair.Ts,
        interval=pair.interval,
        seconds=seconds,
        verify=runs,
        verify_by=by,
    )
    sizes = {entry["cause"]: entry["values"] for entry in designed.details["sizes"]}
    searched = casid.design_experiment(
        problem,
        aim,
        pair.limits,
        (designed.duration, LONGEST * designed.duration),
        sizes=sizes,
        Ts=pair.Ts,
        interval=pair.interval,
        candidates=candidates,
        standards=SEARCHED,
        starts=0,
    )
    return {
        "pair": pair.name,
        "system": pair.system,
        "closed_loop": pair.is_closed_loop,
        "designed": designed.duration,
        "is_enough": designed.is_enough,
        "searched": searched.duration,
        "searched_is_enough": searched.is_enough,
        "ratio": searched.duration / designed.duration,
        "gain": designed.gain,
        "growth": growth(designed.details["durations"]),
        "outcomes": [o.to_json() for o in designed.outcomes],
        "durations": [designed.details["durations"], searched.details["durations"]],
        "limits": [use.to_json() for use in designed.limits],
        "input": designed.solver.begun_from,
        "standard": searched.solver.begun_from,
        "cpu": time.process_time() - began,
    }


def growth(tried: Sequence[Mapping[str, float]]) -> float | None:
    """The power of the length with which the energy of designs grows about the one that decides.

    Parameters
    ----------
    tried : durations with the share of the energy wanted, as `casid.design_experiment` lists them.
    """
    points = [(t["duration"], t["share"]) for t in tried if t["share"] > 0.0]
    if len(points) < 2:
        return None
    near = sorted(points, key=lambda p: abs(math.log(p[1])))[:NEAR]
    length, share = np.log(near).T
    return float(np.polyfit(length, share, 1)[0]) if np.ptp(length) > 0.1 else None


def key_of(row: Row) -> str:
    """What identifies a row."""
    return str(row["pair"])


def line_of(row: Row) -> str:
    """One line for a finished pair."""
    at_least = "" if row["searched_is_enough"] else "more than "
    checked = ", ".join(f"{o['right']} of {o['runs']} ({o['power']:.3f})" for o in row["outcomes"])
    diagnosed = ", ".join(str(o["diagnosed"]) for o in row["outcomes"])
    return (
        f"{row['pair']:<18} designed {row['designed']:8.4g} s  searched {at_least}"
        f"{row['searched']:.4g} s  ratio {at_least}{row['ratio']:.3g}  right {checked}  "
        f"diagnosed {diagnosed}  growth {row['growth'] or math.nan:.2g}  "
        f"{row['cpu']:.0f} s"
    )


def targets_of(rows: Sequence[Row], *, quick: bool) -> Iterator[Target]:
    """What the study is to show."""
    if not quick:
        systems = {row["system"] for row in rows}
        found = f"{len(rows)} on {len(systems)}"
        enough = len(rows) >= PAIRS_WANTED and len(systems) >= SYSTEMS_WANTED
        wanted = f">= {PAIRS_WANTED} on {SYSTEMS_WANTED}"
        yield holds("pairs of causes, and systems", found, wanted, enough)
        closed = sum(row["closed_loop"] for row in rows)
        yield holds("pairs in closed loop", closed, ">= 1", closed >= 1)
    for row in rows:
        yield holds(
            f"{row['pair']}: the designed record decides",
            f"{min(o['power'] for o in row['outcomes']):.3f}",
            ">= 0.95",
            row["is_enough"],
        )
        kept = all(u["lower"] <= u["lowest"] and u["highest"] <= u["upper"] for u in row["limits"])
        yield holds(f"{row['pair']}: every limit kept", kept, True, kept)
        if not quick:
            what = f"{row['pair']}: searched over designed length"
            yield holds(what, f"{row['ratio']:.3g}", f">= {LEAST:g}", row["ratio"] >= LEAST)
    if not quick:
        often = sum(row["ratio"] >= OFTEN for row in rows)
        yield holds(
            f"pairs of ratio {OFTEN:g} and more", often, ">= half", 2 * often >= len(rows) > 0
        )
    yield from _agreement(rows)


def ship_targets(run: Run) -> Iterator[Target]:
    """The rudder against zigzags, and the calibration against that of the thesis."""
    designed, *others = ship.rudder(
        seconds=4.0 if run.quick else 60.0, starts=1 if run.quick else 3
    )
    run.output.table("rudder", [m.row() for m in (designed, *others)])
    for other in others:
        ratios = other.mass / designed.mass, other.height / designed.height
        what = f"{other.name}: errors of mass and height over the designed"
        wanted = HALVED if other.name.startswith("zigzag") else 1.0
        found = f"{ratios[0]:.2f}, {ratios[1]:.2f}"
        yield holds(what, found, f">= {wanted:g}", min(ratios) >= wanted)
    yield holds("roll of the designed rudder", f"{designed.roll:.2f}", "<= 10", designed.roll <= 10)
    thesis, best = ship.calibration()
    run.output.table("calibration", [thesis.row(), best.row()])
    for name, a, b in (("mass", best.mass, thesis.mass), ("height", best.height, thesis.height)):
        what = f"error of the {name} after the best calibration over the thesis's"
        yield holds(what, f"{a / b:.2f} ({best.m:g} kg at {best.zbar_m:g} m)", "<= 1", a <= b)


def _agreement(rows: Sequence[Row]) -> Iterator[Target]:
    """Shares of right names against what was predicted, as one family of binomial tests."""
    every = [(row["pair"], o) for row in rows for o in row["outcomes"] if o["runs"]]
    for name, o in every:
        for what, counted in (("right names", o["right"]), ("diagnosed", o.get("diagnosed"))):
            if counted is None:
                continue
            p = float(binomtest(counted, o["runs"], o["power"]).pvalue)
            yield holds(
                f"{name}, {o['truth']}: {what}",
                f"{counted} of {o['runs']}, p = {p:.2g}",
                f"{o['power']:.3f} predicted",
                p >= LEVEL / len(every),
            )


def write(rows: Sequence[Row], output: Output) -> None:
    """The table, and figures of ratios and of shares."""
    if not rows:
        return
    flat = [{k: v for k, v in row.items() if not isinstance(v, list)} for row in rows]
    output.table("pairs", flat)
    chart = Chart("Record of the best searched input over the designed one, for the same decision")
    names = [row["pair"] for row in rows]
    chart.add("Bar", x=names, y=[row["ratio"] for row in rows], name="ratio of record lengths")
    output.figure("ratios", chart.figure)
    chart = Chart("Right names in simulated records against the predicted probability")
    checked = [o for row in rows for o in row["outcomes"] if o["runs"]]
    chart.add(
        "Scatter",
        x=[o["power"] for o in checked],
        y=[o["right"] / o["runs"] for o in checked],
        mode="markers",
        name="share of right names",
    )
    chart.add("Scatter", x=[0.9, 1.0], y=[0.9, 1.0], mode="lines", name="as predicted")
    output.figure("shares", chart.figure)


def study(run: Run) -> Iterator[Target]:
    """Run the pairs that the file lacks; targets, table and figures of all."""
    options = run.options
    if options.ship:
        yield from ship_targets(run)
        return
    chosen = {p.name: p for p in PAIRS if not options.pair or p.name in options.pair}
    if run.quick:
        chosen = {p.name: p for p in PAIRS if p.name == "cart friction"}
    runs = run.runs(200, 10)
    work = partial(
        compared,
        runs=runs,
        candidates=20 if run.quick else 200,
        seconds=4.0 if run.quick else 30.0,
        by="fits" if options.fits else "diagnoses",
    )
    with tempfile.TemporaryDirectory() as scratch:
        file = (run.folder or Path(scratch)) / "pairs.jsonl"
        if not options.summary:
            for row in finished(file, key_of, chosen, work, options.jobs):
                print(line_of(row), flush=True)
        rows = last_rows(file, key_of)
    write(rows, run.output)
    yield from targets_of(rows, quick=run.quick)


STUDY = Study(
    study,
    quick="one pair, few candidates and simulated records",
    out="folder for pairs.jsonl, the table and figures",
    options={
        "--pair": {"action": "append", "choices": [p.name for p in PAIRS], "help": "default: all"},
        "--runs": {"type": int, "help": "simulated records a truth (default 200, quick 10)"},
        **jobs(1),
        "--fits": {"action": "store_true", "help": "count fits of truth and rival, no diagnoses"},
        "--ship": {"action": "store_true", "help": "the rudder and the calibration alone"},
        "--summary": {"action": "store_true", "help": "of the pairs there are; run none"},
    },
)
