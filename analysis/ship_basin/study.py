"""Chapter 9 made again: the weight aboard a model ship from minute-long records in a basin.

    python -m analysis.ship_basin [--quick] [--out DIR] [--draws N] [--jobs N] [--no-turns]

Linder (2017), sections 9.3-9.5, on simulated records; those of the basin are not published. What
the thesis gives is taken from there, what it does not give was chosen:

- Records 1 to 4 have the lengths of Table 9.3 (63.2, 36.1, 51.1, 65.5 s, 50 Hz), the weights and
  heights of Table 9.2 (0.2 kg at -0.256 m, 0.4 kg at -0.268 m), and are joined as in Table 9.4.
- The ship is that of Table 8.2 with another added mass in sway and a stronger rudder
  (`ship_algorithm.records.SIDEWAYS`): with the table's own no rudder distinguishes K_vdot from K_r.
- Gyro noise 0.002 rad/s, accelerometer 0.02 m/s^2, yaw rate 0.002 rad/s; biases 0.01 rad/s and
  0.01 m/s^2. Roll torque 0.01 N m, sway force 0.1 N, yaw torque 0.01 N m rms, corner 6 rad/s.
- One parameter is held, z_f: the nine of (8.62) are not identifiable with one calibration weight.

The rudder was chosen after 40 draws of each of five: +-0.2 rad, reversed at random every 0.7 s.
Holding it for 0.35 or 1.4 s changes little, +-0.35 rad halves all scatter but leaves least squares
hardly worse in cases 2 and 3, where its errors cancel between calibration and load. The lengths of
the thesis are enough for medians within 5 %; a single voyage of case 1 scatters by more than 10 %.

Two lags of every signal and prefilter 1 are used; the thesis' 16 lags stand beside them, and more
flexible prefilters. `analysis.ship_basin_turns` has what is nonlinear: turns, damping, speed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.common.output import Output
from analysis.common.runner import Run, Study, jobs
from analysis.common.targets import Target, at_most
from analysis.ship_algorithm.study import SETTINGS, print_estimate
from analysis.ship_basin import figures
from analysis.ship_basin.records import (
    CASES,
    LIGHT,
    Basin,
    basin,
    experiments_of,
    nonlinear_basin,
    truth_of,
)
from analysis.ship_basin.runs import (
    INSTRUMENTS,
    LEAST_SQUARES,
    LOAD,
    Desk,
    Draws,
    Found,
    How,
    estimated,
)
from casid.estimation.moments.stages.convergence import Convergence
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from problems.ship import TABLE_8_2

LIGHTER = (0.4, 0.2, 0.1, 0.05)
"""Calibration weights [kg], all at the height of the light one."""

PREFILTERS = {
    "1": INSTRUMENTS,
    "ARMA(2, 2)": How(noise_model=(2, 2)),
    "ARMA(4, 4)": How(noise_model=(4, 4)),
}
LAGS = {
    "2 lags": INSTRUMENTS,
    "2 lags, optimal weights": How(weighting="optimal"),
    "16 lags": How(lags=16),
}


@dataclass(frozen=True)
class Extent:
    """How many draws each part has."""

    cases: int
    squares: int
    lighter: int
    halves: int
    prefilters: int
    lags: int


FULL = Extent(2000, 300, 200, 200, 30, 100)
QUICK = Extent(20, 6, 5, 5, 2, 2)


# -- one voyage ------------------------------------------------------------------------------------


def table(case: int, label: str, found: MomentEstimate) -> list[dict[str, object]]:
    """Print and return the parameters of one estimate, as Tables 9.5 to 9.11."""
    truth = TABLE_8_2 | truth_of(case)
    print_estimate(f"-- case {case}, {label}", found, truth)
    rows: list[dict[str, object]] = []
    for n in found.names:
        row: dict[str, object] = {"case": case, "estimator": label, "parameter": n}
        row |= {"estimate": found[n], "std_error": found.std_error(n), "truth": truth[n]}
        rows.append(row | {"error, %": 100 * abs(found[n] / truth[n] - 1)})
    return rows


def apart(case: int, found: MomentEstimate) -> float:
    """The larger distance of m and zbar_m from the truth, in standard errors."""
    truth = truth_of(case)
    return max(abs(found[n] - truth[n]) / max(found.std_error(n), 1e-12) for n in LOAD)


def voyage(out: Output) -> Iterator[Target]:
    """Tables 9.5, 9.6, 9.8 to 9.11 and Figures 9.16 to 9.19 of one set of records."""
    records, rows, paths = basin(1), [], {}
    for case in CASES:
        experiments = experiments_of(records, case)
        found = estimated(experiments)
        rows += table(case, "IV", found)
        rows += table(case, "LS", estimated(experiments, LEAST_SQUARES))
        path = Convergence.of(found.stages[0], truth_of(case))
        print(path)
        out.table(f"iterations_case_{case}", path.rows())
        paths[case] = path
        # Two normal numbers exceed 3.2 once in 400 draws.
        yield at_most(f"case {case}: m, zbar_m of one voyage", apart(case, found), 3.2, "std. err.")
        text = f"{len(path.moved)} iterations, last move {path.moved[-1]:.1e}"
        wanted = f"< {SETTINGS.tolerance:g}"
        yield Target(f"case {case}: iterations settle, (8.93)", text, wanted, path.is_settled)
    out.table("estimates", rows)
    out.figure("iterations", figures.iterations(paths, {c: truth_of(c) for c in CASES}))


# -- many draws ------------------------------------------------------------------------------------


def show(rows: Sequence[dict[str, Any]]) -> None:
    """Print rows of `Found.line`."""
    for row in rows:
        text = "".join(
            f"  {n}: {row[f'median error of {n}, %']:+.1f} %, spread {row[f'spread of {n}, %']:.1f}"
            f" (std. error {row[f'std. error of {n}, %']:.1f}), covers "
            f"{row[f'95 % of {n} covers, %']:.1f}"
            for n in LOAD
        )
        print(f"    {row['what']:<34}{text}; {row['draws']} draws")


def cases(desk: Desk, extent: Extent, out: Output) -> Iterator[Target]:
    """Medians of instruments and least squares, and how often intervals hold the truth."""
    found = desk.do("cases", Draws(), extent.cases)
    squares = desk.do("least squares", Draws(hows=(("LS", LEAST_SQUARES),)), extent.squares)
    rows = [found.line(f"case {c} IV") for c in CASES] + [
        squares.line(f"case {c} LS") for c in CASES
    ]
    print("-- instruments and least squares")
    show(rows)
    out.table("cases", rows)
    out.figure("scatter", figures.scatter(found, squares))
    for case in CASES:
        own, theirs = f"case {case} IV", f"case {case} LS"
        for n in LOAD:
            yield at_most(f"{own}: error of the median {n}", abs(found.median(own, n)), 5.0, "%")
        ours = max(abs(found.median(own, n)) for n in LOAD)
        other = max(abs(squares.median(theirs, n)) for n in LOAD)
        text = f"{other:.1f} %, instruments {ours:.2f} %"
        what = f"{theirs}: the larger of the medians' errors"
        yield Target(what, text, ">= 3 times", other >= 3 * ours)
        for n in LOAD:
            yield coverage(found, own, n)
        yield at_most(f"{own}: draws refused", 100 * found.refused(own), 1.0, "%")


def coverage(found: Found, label: str, name: str) -> Target:
    """The share of 95 % intervals that hold the truth, with its Monte Carlo standard error."""
    from scipy.stats import binom

    count, low, high = found.covered(label, name)
    share = 1 - (low + high) / count
    error = float(np.sqrt(max(share * (1 - share), 0.95 * 0.05) / count))
    # The band of 2000 draws is 2 %; of fewer what chance does not exceed in one of 740 studies,
    # as rarely as three standard errors of a normal number.
    slack = 0.02
    if count < 2000:
        slack = max(slack, float(binom.ppf(1 - 0.00135, count, 0.05)) / count - 0.05)
    return Target(
        f"{label}: 95 % interval of {name}",
        f"{100 * share:.1f} +- {100 * error:.1f} % ({low} low, {high} high)",
        f"{95 - 100 * slack:.0f} to {min(95 + 100 * slack, 100):.0f} % of {count}",
        bool(abs(share - 0.95) <= slack),
    )


def lighter(desk: Desk, extent: Extent, out: Output) -> Iterator[Target]:
    """The error of case 3 as the calibration weight falls."""
    rows, reported, observed = [], [], []
    for m_c in LIGHTER:
        light = {**LIGHT, "m": m_c}
        made = replace(Basin(), weights=(Basin().weights[0], light, *Basin().weights[2:]))
        name = f"calibration of {m_c:g} kg"
        found = desk.do(name, Draws(made, cases=(3,)), extent.lighter)
        line = found.line("case 3 IV")
        rows.append({"calibration, kg": m_c, **line, "what": name})
        observed.append(found.spread("case 3 IV", "m"))
        reported.append(found.std_error("case 3 IV", "m"))
    print("-- case 3 with lighter calibration weights")
    show(rows)
    out.table("lighter_calibration", rows)
    out.figure("lighter_calibration", figures.lighter(rows))
    # The load's lever is measured in units of the calibration's, whose relative error is as
    # 1/m_c; what the loaded record itself leaves does not depend on m_c.
    grows = all(b > a for a, b in zip(reported, reported[1:], strict=False))
    limit = LIGHTER[0] / LIGHTER[-1]
    yield Target(
        f"standard error of m, calibrations of {LIGHTER[0]:g} to {LIGHTER[-1]:g} kg",
        ", ".join(f"{v:.1f}" for v in reported) + " %",
        f"grows, at most {limit:g}-fold",
        grows and reported[-1] <= limit * reported[0],
    )
    slack = 3 / np.sqrt(2 * extent.lighter) + 0.1
    worst = max(abs(a / b - 1) for a, b in zip(observed[:-1], reported[:-1], strict=True))
    yield at_most("m over the draws beside its standard error, 0.1 kg up", worst, slack, "relative")


def split(desk: Desk, extent: Extent, out: Output) -> Iterator[Target]:
    """Table 9.7: case 1 from the first and from the second halves."""
    draws = Draws(cases=(1,), halved=True)
    found = desk.do("halves", draws, extent.halves)
    whole = desk.do("whole", Draws(cases=(1,)), extent.halves)
    parts = [f"case 1 IV {part} half" for part in ("first", "second")]
    rows = [whole.line("case 1 IV"), *(found.line(part) for part in parts)]
    print("-- case 1 from halves of its records, as Table 9.7 (there 18.6 % and 50.3 % in m)")
    show(rows)
    out.table("halves", rows)
    own, spread = whole.std_error("case 1 IV", "m"), whole.spread("case 1 IV", "m")
    for part in parts:
        ratio = found.std_error(part, "m") / own
        # Half the samples; and every piece loses the transient of its instruments, a quarter of
        # it at most: sqrt(2) to sqrt(8/3) beside the whole without one, some allowance for chance.
        text = f"{ratio:.2f} times (spread {found.spread(part, 'm') / spread:.2f})"
        what = f"{part}: standard error of m beside that of whole records"
        yield Target(what, text, "1.27 to 1.8 times", 1.27 <= ratio <= 1.8)


def compared(
    desk: Desk, name: str, hows: dict[str, How], runs: int, out: Output
) -> dict[str, list[float]]:
    """Spreads of m and zbar_m in case 3 over the same draws, estimated in several ways."""
    found = desk.do(name, Draws(hows=tuple(hows.items()), cases=(3,)), runs)
    labels = {f"case 3 {how}": how for how in hows}
    rows = [found.line(label) for label in labels]
    print(f"-- {name}")
    show(rows)
    out.table(name.replace(" ", "_"), rows)
    spreads: dict[str, list[float]] = {how: [] for how in hows}
    for label, how in labels.items():
        spreads[how] += [found.spread(label, n) for n in LOAD]
    return spreads


def settings(desk: Desk, extent: Extent, out: Output) -> Iterator[Target]:
    """The effect of lags, weights and prefilters."""
    lags = compared(desk, "lags", LAGS, extent.lags, out)
    ratio = float(np.median(np.array(lags["2 lags"]) / lags["16 lags"]))
    # The same draws: the ratio of two such spreads is known to some 10 % from 100 of them.
    yield at_most("2 lags: spread beside that of the thesis' 16", ratio, 1.3, "times")
    # The most flexible takes ten seconds a draw: it seldom settles.
    tried = {n: h for n, h in PREFILTERS.items() if extent.prefilters > 2 or n != "ARMA(4, 4)"}
    filters = compared(desk, "prefilters", tried, extent.prefilters, out)
    print("  section 9.5: more flexible prefilters are worse. Spreads beside that of prefilter 1:")
    for name in list(tried)[1:]:
        ratio = float(np.median(np.array(filters[name]) / filters["1"]))
        print(f"    {name:<12}{ratio:.2f} times, {'as it says' if ratio > 1 else 'not so here'}")


def nonlinear(out: Output) -> Iterator[Target]:
    """The cases once on the manoeuvring ship, whose speed drops in turns."""
    records, rows = nonlinear_basin(1), []
    for case in CASES:
        experiments = experiments_of(records, case)
        found, plain = estimated(experiments), estimated(experiments, LEAST_SQUARES)
        rows += table(case, "IV, nonlinear ship", found) + table(case, "LS, nonlinear ship", plain)
        ours, theirs = (
            max(100 * abs(e[n] / v - 1) for n, v in truth_of(case).items()) for e in (found, plain)
        )
        what = f"case {case}, nonlinear ship: larger error of m, zbar_m"
        text = f"{ours:.1f} %, least squares {theirs:.1f} %"
        yield Target(what, text, "instruments nearer", ours < theirs)
    out.table("nonlinear", rows)


def study(run: Run) -> Iterator[Target]:
    """All parts in turn."""
    out, extent = run.output, QUICK if run.quick else FULL
    extent = replace(extent, cases=run.options.draws or extent.cases)
    desk = Desk(run.options.jobs, out.folder)
    yield from voyage(out)
    for part in (cases, lighter, split, settings):
        yield from part(desk, extent, out)
    yield from nonlinear(out)
    if not run.options.no_turns:
        from analysis.ship_basin_turns.study import turns

        yield from turns(out, run.quick)


STUDY = Study(
    study,
    quick="20 draws, under a minute",
    out="folder for tables, figures, draws, targets.json",
    options=jobs(2)
    | {
        "--draws": {"type": int, "help": "of the three cases (default 2000, quick 20)"},
        "--no-turns": {"action": "store_true", "help": "leave ship_basin_turns out"},
    },
)
