"""The surge speed in turns, and what taking it as constant costs in m and zbar_m.

The first target, a bias of the mean, was missed: the sign of the error goes with the rudder.
What a constant speed costs is the size of the error, which the stated one knows nothing of.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict

import numpy as np

from analysis.common.output import Output
from analysis.common.targets import Target, at_most
from analysis.ship_algorithm.records import low_passed
from analysis.ship_algorithm.study import EIGHT, LOAD, TRUTH, fit
from analysis.ship_basin_turns.figures import speed_figure
from analysis.ship_basin_turns.records import QUIET, SHIPS, long_sets
from analysis.ship_basin_turns.speed import (
    at_smoothed_speed,
    at_true_speed,
    drop,
    smoothed,
    surge_time,
)
from casid.arrays import Array

ANGLE = 0.3  # rad


def speed(out: Output, *, quick: bool) -> Iterator[Target]:
    """Part 4."""
    sets = long_sets(duration=120.0 if quick else 300.0, angle=ANGLE, disturbance=QUIET)
    track, u = smoothed(sets[0], seed=11)
    seen = drop(sets[0], u, float(np.mean(track.u_sd)))
    print(f"-- surge speed, its own lag {surge_time(sets[0]):.1f} s\n    {seen}")
    out.table("turns_speed", [asdict(seen)])
    behind = f"behind the surge's lag (at once {seen.at_once:+.2f})"
    yield at_most(f"correlation of u with |rudder| {behind}", seen.after_lag, -0.8)
    what = f"smoothed u: rms error over its stated one, {1e3 * seen.sd:.1f} mm/s"
    yield at_most(what, seen.error / seen.sd, 1.2)
    out.figure("turns_speed", speed_figure(sets[0], u, track.u_sd.mean()))
    yield from constant_speed(out, quick=quick)


def constant_speed(out: Output, *, quick: bool) -> Iterator[Target]:
    """What constant U costs in m and zbar_m, over draws of rudder, disturbances and noise."""
    draws = range(1, 5 if quick else 11)
    found: dict[str, list[list[float]]] = {}
    for seed in draws:
        sets = long_sets(duration=300.0, angle=ANGLE, seed=seed, disturbance=QUIET)
        held = long_sets(
            duration=300.0, angle=ANGLE, seed=seed, disturbance=QUIET, ship=SHIPS["speed held"]
        )
        made = {"constant U": [s.experiment for s in sets], "u r for r": at_true_speed(sets)}
        made["speed held"] = [s.experiment for s in held]
        if not quick and seed <= 4:
            made["smoothed u r for r"] = at_smoothed_speed(sets, seed=100 * seed)
        for kind, experiments in made.items():
            e = fit(EIGHT, low_passed(experiments)).estimate
            own = [a for n in LOAD for a in (e[n] - TRUTH[n], e.std_error(n))]
            found.setdefault(kind, []).append(own)
    rows = [
        _row(kind, n, np.array(values)[:, 2 * i : 2 * i + 2])
        for kind, values in found.items()
        for i, n in enumerate(LOAD)
    ]
    out.table("turns_constant_speed", rows)
    print("-- errors of m and zbar_m over draws of rudder and noise, % of the truth")
    print_rows(rows, ".2f")
    yield from _verdicts(rows)


def print_rows(rows: Iterable[Mapping[str, object]], form: str = ".4f") -> None:
    """The values of each row on a line."""
    for row in rows:
        values = (f"{v:{form}}" if isinstance(v, float) else str(v) for v in row.values())
        print("    " + "  ".join(values))


def _row(kind: str, name: str, table: Array) -> dict[str, str | float | int]:
    """Of (draws, 2): errors, and standard errors as stated."""
    error, stated = (100 * table / abs(TRUTH[name])).T
    return {
        "speed": kind,
        "parameter": name,
        "mean": float(error.mean()),
        "std. error of the mean": float(error.std(ddof=1) / np.sqrt(len(error))),
        "rms": float(np.sqrt(np.mean(error**2))),
        "stated": float(np.mean(stated)),
        "draws": len(error),
    }


def _verdicts(rows: Sequence[Mapping[str, str | float | int]]) -> Iterator[Target]:
    """The torque K_r (u - U) r is a function of the rudder: the sign of the error is the draw's."""
    from scipy.stats import f

    table = {(str(r["speed"]), str(r["parameter"])): r for r in rows}
    for n in LOAD:
        constant, product = table["constant U", n], table["u r for r", n]
        count = int(constant["draws"])
        least = float(np.sqrt(f.ppf(0.99, count, count)))
        ratio = float(constant["rms"]) / float(product["rms"])
        yield Target(
            f"constant U: rms error of {n} over that with u r for r",
            f"{float(constant['rms']):.1f} % / {float(product['rms']):.1f} % = {ratio:.1f}",
            f">= {least:.1f}, 99 % of F({count}, {count})",
            ratio >= least,
        )
        mean, error = float(product["mean"]), float(product["std. error of the mean"])
        what, met = f"u r in the place of r: mean error of {n}", abs(mean) <= 3 * error
        yield Target(what, f"{mean:+.1f} +- {error:.1f} %", "within 3 std. errors of 0", met)
