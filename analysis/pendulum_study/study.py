"""The simulation study of Linder (2017), section 7.5.1: 10 000 runs of two long records.

    python -m analysis.pendulum_study [--quick] [--timing] [--out DIR] [--jobs 2] [--resume]

Instrumental variables and constrained least squares in two stages (Approach 7.1), see
`analysis.pendulum_study.runs`. The thesis gives neither the reference nor the weighting Q nor the
numbers of lags. Here the reference is a random telegraph of amplitude A with a mean hold of 1 s;
Q = I with four lags of each simulated signal has the thesis's shares of mass estimates at A = 0.2,
and casid's default, the projection on the instruments, has a twentieth of that spread.

Printed: time and memory of the 10 000 runs at A = 0.3 beside the floor, the bare work of drawing,
filtering and summing; mean, spread, coverage at every amplitude; what the map (7.38) does where
little is excited, and intervals that cover all the same; from what amplitude the nonlinear truth
shows. --quick: fewer and shorter runs, and no verdict on time. Exit 1 where a target is missed.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from analysis.common.output import Output
from analysis.common.runner import Run, Study, jobs
from analysis.common.targets import Target, at_most, near
from analysis.pendulum_study import figures
from analysis.pendulum_study.records import TS, PendulumRecords, low_pass
from analysis.pendulum_study.runs import Bench, Estimator, Floor, Profiles, Runs, bench
from analysis.pendulum_study.statistics import HEADER, Line, lines, load_by_formula, shares
from casid.arrays import Array
from casid.campaigns.campaign import Campaign, campaign
from casid.linear.linear_model import linearise
from casid.linear.sampled.discretisation_bias import bias_table
from problems.pendulum import (
    CART_LAG,
    TABLE_7_2,
    indirect_model,
    linear_model,
    motion,
    telegraph,
)

AMPLITUDES = (0.15, 0.2, 0.3, 1.0)
SHOWN = 0.3
"""The amplitude of the 10 000 runs [m/s^2]."""

RESONANCE, INDIRECT = 6.68, 13.25
"""Undamped frequencies of the nominal pendulum and of its indirect model [rad/s]."""


@dataclass(frozen=True)
class Extent:
    """How much is done."""

    runs: int  # at A = 0.3, least squares and default instruments
    others: int  # at every amplitude, all estimators
    profiles: int
    floor: int
    N: int
    N_nonlinear: int
    every: int
    is_full: bool  # else no verdict on time, nor on what depends on the records' length


FULL = Extent(10_000, 1500, 150, 200, 150_000, 30_000, 1, True)
QUICK = Extent(120, 60, 12, 10, 30_000, 6_000, 1, False)


@dataclass(frozen=True)
class Desk:
    """Where campaigns run, and where their results are kept."""

    jobs: int
    output: Output
    resume: bool

    def do(self, name: str, function: Any, runs: int, seed: int = 0) -> tuple[Campaign, float]:
        """A campaign and its seconds, workers' start included."""
        import joblib

        folder = None if self.output.folder is None else self.output.folder / "runs" / name
        began = perf_counter()
        with joblib.parallel_config(n_jobs=self.jobs):
            done = campaign(function, runs, seed=seed, out=folder, resume=self.resume)
        seconds = perf_counter() - began
        print(
            f"  {name}: {done.runs} runs in {seconds:.1f} s, {len(done.failures)} failed",
            flush=True,
        )
        return done, seconds


# -- time and memory -------------------------------------------------------------------------------


def timing(desk: Desk, extent: Extent) -> Generator[Target, None, Any]:
    """The 10 000 runs against the clock and the floor; returns their table."""
    runs = Runs(SHOWN, N=extent.N, every=extent.every)
    done, seconds = desk.do(f"{extent.runs} runs at A = {SHOWN:g}", runs, extent.runs)
    floor, _ = desk.do("floor", Floor(runs), extent.floor, seed=99)
    ms = {k: floor.column(k) for k in floor.table.columns if k.endswith("_ms")}
    normal, tap = (float(np.median(floor.column(k))) for k in ("ns_normal", "ns_tap"))
    bare = float(ms["floor_ms"].mean())
    print(
        f"  floor {bare:.2f} ms a run ({float(ms['moments_ms'].mean()):.2f} of it sums of "
        f"products), in turn with whole runs of {float(ms['run_ms'].mean()):.2f} ms; processor "
        "time\n"
        f"  a normal {normal:.2f} ns (ziggurat, published: 5-10 ns), a filter tap {tap:.3f} ns "
        "(vector units, published: 0.1-0.3 ns)"
    )
    if not done.found:
        spent = 1e3 * seconds * desk.jobs / extent.runs
        print(
            f"  the campaign took {spent:.2f} ms by the clock a run and process, start and files "
            f"included: {spent / bare:.2f} times the floor where nothing else ran"
        )
    yield at_most("peak memory of a process", float(floor.column("peak_MB").max()), 1000.0, "MB")
    if not extent.is_full or done.found:
        print("  no verdict on time: " + ("resumed" if done.found else "a quick study"))
        return done.table
    yield at_most(f"{extent.runs} runs on {desk.jobs} processes", seconds / 60, 5.0, "min")
    ratio = float(ms["run_ms"].sum() / ms["floor_ms"].sum())
    yield at_most("a run against the floor, in turn", ratio, 2.5, "times")
    yield at_most("a normal (the floor is not slow)", normal, 10.0, "ns")
    yield at_most("a filter tap (the floor is not slow)", tap, 0.3, "ns")
    return done.table


# -- numbers ---------------------------------------------------------------------------------------


def verdicts(
    found: dict[tuple[float, str, str], Line], table: dict[float, Any], large: Any, *, is_full: bool
) -> Iterator[Target]:
    """The study's claims on bias, spread, shares and coverage; `large` are the 10 000 runs."""
    for A in (SHOWN, 1.0):
        m = (large if A == SHOWN else table[A])["iv.m"].to_numpy()
        text = f"{np.mean(m > 0):.2%} of {len(m)}"
        yield Target(f"A = {A:g}: default, mass > 0", text, "100 %", (m > 0).all())
        for p in ("d", "m", "z_m"):
            yield covers(found[A, "iv", p])
        yield covers(found[A, "iv", "I_x"], noise_free=True)
    for A in (0.15, SHOWN, 1.0):
        line = found[A, "identity", "m"]
        assert line.published_spread is not None
        what = f"A = {A:g}: Q = I, spread of m as re-created"
        if is_full:
            yield near(what, line.spread, line.published_spread, 0.35, "kg")
        line = found[A, "ls", "m"]
        assert line.published_mean is not None
        what = f"A = {A:g}: least squares, mean of m as re-created"
        yield near(what, line.mean, line.published_mean, 0.03, "kg")
        gain = found[A, "identity", "m"].spread / found[A, "iv", "m"].spread
        what = f"A = {A:g}: spread of m, Q = I against the default"
        yield Target(what, f"{gain:.1f} times", ">= 10 times", gain >= 10)
    for A in (0.15, SHOWN):
        ls, iv = found[A, "ls", "m"], found[A, "iv", "m"]
        yield Target(
            f"A = {A:g}: least squares: less spread, more bias in m",
            f"spread {ls.spread / iv.spread:.2f}, bias {ls.bias / ls.spread:+.0f} spreads",
            "< 1 and beyond 3 spreads",
            bool(ls.spread < iv.spread and abs(ls.bias) > 3 * ls.spread),
        )
    thesis = {"> 0": (1.0, 0.0), "+-0.1": (0.85, 0.06), "> 0.1": (0.95, 0.04)}
    for key, share in shares(table[0.2]["identity.m"].to_numpy()).items():
        wanted, room = thesis[key]
        if is_full:
            what, text = f"A = 0.2: Q = I, share of masses {key} kg", f"{share:.1%}"
            within = f"{wanted:.0%} in the thesis, +- {room:.0%}"
            yield Target(what, text, within, abs(share - wanted) <= room)
    for A in AMPLITUDES:
        print(f"  A = {A:g}: shares of masses > 0, within 0.1 kg, above 0.1 kg:")
        for name in ("identity", "iv", "ls"):
            values = shares(table[A][f"{name}.m"].to_numpy()).values()
            print(f"    {name:<9}" + ", ".join(f"{v:.1%}" for v in values))
    line = found[SHOWN, "iv", "I_x"]
    found_offset, theory = line.noise_free / line.truth - 1, bilinear_prediction()["I_x"]
    print(
        f"  I_x without noise is off by {found_offset:+.2e} = {found_offset * line.truth:+.1e} "
        f"kg m^2; (w T)^2/12 is {(RESONANCE * TS) ** 2 / 12:.1e} at the resonance of the pendulum, "
        f"{RESONANCE} rad/s, and {(INDIRECT * TS) ** 2 / 12:.1e} at that of the indirect model, "
        f"{INDIRECT} rad/s"
    )
    yield near("relative offset of I_x by the bilinear map", found_offset, theory, 0.1, "")
    apart, chance = line.mean - line.noise_free, 4 * line.spread / np.sqrt(line.n)
    within = f"within {chance:.1e} (4 errors of the mean)"
    what = "A = 0.3: mean of I_x at its noise-free value"
    yield Target(what, f"{apart:+.1e}", within, abs(apart) <= chance)


def bilinear_prediction() -> dict[str, float]:
    """Relative offsets of I_x and d by the bilinear map, in the limit of many samples.

    From the spectrum of a_s alone: the telegraph's 4/(4 + w^2) through F_delta, the direct model
    and the low-pass.
    """
    free = {n: TABLE_7_2[n] for n in ("I_x", "d", "k")}
    transfer = linearise(linear_model().with_known(**free)).transfer("accel")
    a, rows = transfer.evaluate({})
    taps = low_pass().taps

    def spectrum(w: Array) -> Array:
        s = 1j * w
        gain = np.abs(np.polyval(rows[0][0], s) / np.polyval(a, s) / (CART_LAG * s + 1))
        wave = np.abs(np.exp(-1j * np.outer(w * TS, np.arange(len(taps)))) @ taps)
        return np.asarray(4 / (4 + w**2) * gain**2 * wave**2)

    model = indirect_model().with_known(k=TABLE_7_2["k"])
    true = {n: TABLE_7_2[n] for n in ("I_x", "d")}
    table = bias_table(
        model, [TS], ("I_x", "d"), true, methods=("bilinear",), truth="continuous",
        spectrum=spectrum, points=20_000,
    )  # fmt: skip
    return dict(table.rows[0].bias)


def covers(line: Line, *, noise_free: bool = False) -> Target:
    """Coverage between 93 and 97 %, with what chance does to so many runs."""
    share = line.covers_noise_free if noise_free else line.covers
    assert share is not None
    room = 2 * (0.95 * 0.05 / line.intervals) ** 0.5
    low, high = min(0.93, 0.95 - room), max(0.97, 0.95 + room)
    about = "noise-free value" if noise_free else "truth"
    return Target(
        f"A = {line.amplitude:g}: {line.estimator}, {line.parameter}: 95 % intervals, {about}",
        f"{share:.2%} of {line.intervals}",
        f"{low:.1%} to {high:.1%}",
        bool(low <= share <= high),
    )


def bilinear_offsets(found: dict[tuple[float, str, str], Line]) -> None:
    """Where the offset of the bilinear map is comparable with the standard error, say so."""
    for (A, name, p), line in found.items():
        if name == "iv" and line.mean_std_error is not None:
            offset = (line.noise_free - line.truth) / line.mean_std_error
            if abs(offset) > 0.2:
                print(
                    f"  A = {A:g}: {p} carries a noise-free offset of {offset:+.2f} standard "
                    f"errors: {line.covers:.1%} of the intervals hold the truth, "
                    f"{line.covers_noise_free:.1%} the noise-free value"
                )


def stages_apart(found: dict[tuple[float, str, str], Line]) -> Iterator[Target]:
    """How much the intervals of m and z_m lack that take the first stage as exact."""
    for name in ("iv", "identity"):
        for p in ("m", "z_m"):
            line = found[SHOWN, name, p]
            assert line.own_ratio is not None
            assert line.own_covers is not None
            assert line.covers is not None
            print(
                f"  A = {SHOWN:g}: {name}, {p}: without the first stage's error intervals are "
                f"{1 - line.own_ratio:.1%} too narrow and cover {line.own_covers:.1%}"
            )
            if p == "m":
                yield Target(
                    f"A = {SHOWN:g}: {name}, m: first stage taken as exact",
                    f"{line.own_ratio:.3f} of the width, {line.own_covers:.1%}",
                    "< 1, covers less",
                    bool(line.own_ratio < 1 and line.own_covers < line.covers),
                )


def little_excitation(desk: Desk, extent: Extent, table: Any) -> Iterator[Target]:
    """A = 0.15: what the map (7.38) does, and the profile's intervals."""
    A = 0.15
    print(f"A = {A:g}: what (7.38) does")
    for name in ("identity", "iv"):
        m, z_m = load_by_formula(table, name)
        lost = ~(np.isfinite(m) & (m > 0) & (m < 5.0) & (z_m > -2.0) & (z_m < 0.0))
        seen = m[~lost]
        skewness = float(np.mean((seen - seen.mean()) ** 3) / seen.std() ** 3)
        error = table[f"{name}.m.std_error"]
        inside = (np.abs(table[f"{name}.m"] - TABLE_7_2["m"]) < 1.96 * error)[error.notna()]
        print(
            f"  {name:<9} m: mean {seen.mean():.4f}, median {np.median(seen):.4f}, skewness "
            f"{skewness:+.2f}; outside 0 .. 5 kg or -2 .. 0 m in {lost.mean():.2%} of the runs; "
            f"delta-method intervals cover {inside.mean():.1%}"
        )
    done, _ = desk.do("profiles at A = 0.15", Profiles(A, N=extent.N), extent.profiles)
    kept = done.table[done.table["failed"].isna()]
    for p in ("m", "z_m"):
        truth = TABLE_7_2[p]
        held = {
            k: float(((kept[f"{p}{k}.lower"] < truth) & (truth < kept[f"{p}{k}.upper"])).mean())
            for k in ("", ".delta", ".sampled", ".identity.delta")
        }
        room = 2.5 * (0.95 * 0.05 / len(kept)) ** 0.5
        for what, key, delta in (
            (f"default, {p}: profile", "", ".delta"),
            (f"Q = I, {p}: sampled", ".sampled", ".identity.delta"),
        ):
            text = f"{held[key]:.1%} of {len(kept)} (delta {held[delta]:.1%})"
            met = abs(held[key] - 0.95) <= room
            yield Target(f"A = {A:g}: {what} intervals cover", text, f"95 % +- {room:.1%}", met)


# -- the nonlinear truth ---------------------------------------------------------------------------


def nonlinear(extent: Extent, errors: dict[float, float]) -> list[dict[str, float]]:
    """Relative error of linear models fitted to the noise-free nonlinear pendulum (7.9).

    The direct model (7.10) with a_y known is regressed on the motion itself; the indirect model
    (7.24) on the study's records, in excess of what it has on the linear pendulum.
    """
    rows = []
    slope = float(np.median([e * A for A, e in errors.items()]))  # errors fall with 1/A
    for A in (0.15, 0.3, 0.5, 1.0, 2.0, 3.0):
        indirect = {
            truth: Bench(PendulumRecords(A, N=extent.N_nonlinear, truth=truth, seed=2))
            for truth in ("nonlinear", "linear")
        }
        found, plain = (own.noise_free(("iv",))["iv"] for own in indirect.values())
        direct = direct_regression(A, extent.N_nonlinear)
        row = {"amplitude": A, "largest angle [deg]": direct.pop("angle")}
        row |= {f"direct {name}": error for name, error in direct.items()}
        row |= {"indirect I_x": float(found[0] / plain[0] - 1)}
        row |= {"indirect m": float(found[2] / plain[2] - 1), "standard error": slope / A}
        rows.append(row)
    return rows


def direct_regression(amplitude: float, N: int) -> dict[str, float]:
    """Relative errors of I_x, k and d of (7.10) on the motion of (7.9), a_y known exactly."""
    v = TABLE_7_2
    ref = telegraph(N, TS, amplitude=amplitude, rng=np.random.default_rng(0))
    phi, p, a_y, p_dot = motion(ref, TS, 5, k=v["k"], d=v["d"], I_x=v["I_x"], m=0.0, d_2=0.0)
    S = v["M"] * v["z_g"]
    theta = np.linalg.lstsq(np.stack([-phi, -p, S * a_y], axis=1), p_dot, rcond=None)[0]
    I_1 = 1 / theta[2]
    return {
        "angle": float(np.rad2deg(np.abs(phi).max())),
        "I_x": (I_1 - v["M"] * v["z_g"] ** 2) / v["I_x"] - 1,
        "k": (theta[0] * I_1 - 9.81 * S) / v["k"] - 1,
        "d": theta[1] * I_1 / v["d"] - 1,
    }


def print_nonlinear(rows: Sequence[dict[str, float]]) -> Iterator[Target]:
    """The sweep, and from where the direct model is biased by more than its standard error."""
    print("Nonlinear truth, relative error of linear models, no noise")
    print(
        "      A   angle  direct I_x    direct k    direct d  indirect I_x  indirect m   error I_x"
    )
    for r in rows:
        print(
            f"  {r['amplitude']:>5g}{r['largest angle [deg]']:>6.1f}deg{r['direct I_x']:>+11.1e}"
            f"{r['direct k']:>+12.1e}{r['direct d']:>+12.1e}{r['indirect I_x']:>+14.1e}"
            f"{r['indirect m']:>+12.1e}{r['standard error']:>12.1e}"
        )
    # Bias grows with A^2, the standard error falls with 1/A: they meet at the cube root.
    small = rows[1]
    meet = small["amplitude"] * (small["standard error"] / abs(small["direct I_x"])) ** (1 / 3)
    angle = small["largest angle [deg]"] * meet / small["amplitude"]
    print(
        f"  the direct model's bias in I_x passes the study's standard error from A = {meet:.2f} "
        f"m/s^2 on, at {angle:.0f} deg; the indirect model leaves nothing to pass it"
    )
    worst = max(abs(r["indirect I_x"]) for r in rows)
    direct = max(abs(r["direct I_x"]) for r in rows)
    yield Target(
        "nonlinear truth: the indirect model stays exact",
        f"I_x {worst:.1e}, the direct one {direct:.1e}",
        "a hundredth of the direct one's",
        bool(worst <= 0.01 * direct),
    )


# -- everything ------------------------------------------------------------------------------------


def study(desk: Desk, extent: Extent) -> Iterator[Target]:
    """All targets; prints the tables on the way."""
    tables: dict[float, Any] = {}
    rows: list[Line] = []
    everything: tuple[Estimator, ...] = ("ls", "iv", "identity")
    print("Campaigns")
    large = yield from timing(desk, extent)
    large = large[large["failed"].isna()]
    for A in AMPLITUDES:
        function = Runs(A, N=extent.N, estimators=everything)
        done, _ = desk.do(f"all estimators at A = {A:g}", function, extent.others, seed=1)
        tables[A] = done.table[done.table["failed"].isna()]
    print(HEADER)
    for A in AMPLITUDES:
        limit = bench(A, extent.N, 1, 0.01).noise_free(everything)
        if A == SHOWN:  # the 10 000 runs for what they have
            fresh = lines(A, large, ("ls", "iv"), limit)
            fresh += lines(A, tables[A], ("identity",), limit)
        else:
            fresh = lines(A, tables[A], everything, limit)
        rows += fresh
        print(*fresh, sep="\n")
    found = {(r.amplitude, r.estimator, r.parameter): r for r in rows}
    bilinear_offsets(found)
    yield from verdicts(found, tables, large, is_full=extent.is_full)
    yield from stages_apart(found)
    yield from little_excitation(desk, extent, tables[0.15])
    errors = {A: (found[A, "iv", "I_x"].mean_std_error or 0.0) / TABLE_7_2["I_x"] for A in tables}
    sweep = nonlinear(extent, errors)
    yield from print_nonlinear(sweep)
    output = desk.output
    output.table("estimates", rows)
    if output.folder is not None:
        output.figure("figure_7_10_signals", figures.signals(bench(SHOWN, extent.N, 1, 0.01)))
        for number, case in (("7_11", "nominal"), ("7_12", "loaded")):
            name = f"figure_{number}_{case}"
            output.figure(name, figures.histograms(large, case, ("iv", "ls"), SHOWN))
            thesis = figures.histograms(tables[0.2], case, ("identity", "ls"), 0.2)
            output.figure(f"{name}_as_in_the_thesis", thesis)
        output.figure("nonlinear_truth", figures.amplitudes(sweep))


def found(run: Run) -> Iterator[Target]:
    """The targets of the whole study, or of its timing alone."""
    options = run.options
    extent = QUICK if run.quick else FULL
    if options.runs is not None:
        extent = replace(extent, runs=options.runs)
    desk = Desk(options.jobs, run.output, options.resume)
    yield from timing(desk, extent) if options.timing else study(desk, extent)


STUDY = Study(
    found,
    quick="fewer and shorter runs, not timed",
    out="folder for tables, figures and all runs",
    options=jobs(2)
    | {
        "--timing": {"action": "store_true", "help": "the large campaign and floor alone"},
        "--runs": {"type": int, "help": "runs at A = 0.3 (default 10 000)"},
        "--resume": {"action": "store_true", "help": "continue what --out holds, untimed"},
    },
)
