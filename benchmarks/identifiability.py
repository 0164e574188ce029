"""Exact rank and verdicts: time beside sympy and symident, and growth with the size of a chain.

    python -m benchmarks.identifiability [--quick] [--models DIR] [--out DIR]

DIR holds the equation files (../shared/identifiability by default). Least time of five, one thread,
files read before: one point (rank and verdicts modulo one prime), and points until the error bound
of 1e-12 holds. Beside them, each in a process of its own: Lie derivatives by sympy with the rank of
their Jacobian in 50 digits, and symident where it is installed, both cut after a minute. Arbitrary
unknown inputs are eliminated first, which is not timed; the other two are then left out. Exit
status 1 when a target is missed.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
for _name in THREADS:
    os.environ.setdefault(_name, "1")

LIMIT = 60.0  # seconds a contender may take
REPEATS = 5
LARGEST = "nfkb_full"
POINT_MS, BOUND_MS, OTHER_MS = 20.0, 40.0, 50.0
FIXING_SECONDS, SENSOR_SECONDS = 1.0, 2.0


def least(call: Callable[[], Any], repeats: int = REPEATS) -> float:
    """Least time of a call [s], garbage collected before."""
    times = []
    for _ in range(repeats):
        gc.collect()
        begin = time.perf_counter()
        call()
        times.append(time.perf_counter() - begin)
    return min(times)


def judged(label: str, value: float, target: float, unit: str) -> bool:
    """Print a number beside its target; True if the target is met."""
    met = value <= target
    word = "met" if met else "MISSED"
    print(f"  {label:<52} {value:8.3g} {unit}   at most {target:g} {unit}   {word}")
    return met


# ---------------------------------------------------------------------- the contenders


def systems_of(path: Path) -> tuple[Any, ...]:
    """The systems of a file, arbitrary unknown inputs eliminated."""
    from casid.identifiability.equations.equation_file import read_equations
    from casid.identifiability.inputs.elimination import eliminate_unknown_inputs

    return tuple(
        eliminate_unknown_inputs(s).system if s.unknown_inputs else s
        for s in read_equations(path).systems
    )


def by_casid(path: Path) -> dict[str, Any]:
    """Milliseconds of a point and of a bounded answer, and the rank."""
    import numpy as np

    from casid.algebra.prime_field import random_prime
    from casid.identifiability.rank.observability import observability, rank_at

    systems = systems_of(path)
    seeds = iter(range(10_000))

    def point() -> None:
        rng = np.random.default_rng(next(seeds))
        found = rank_at(systems, random_prime(rng), rng=rng)
        found.identifiable(), found.observable()

    result = observability(systems)
    return {
        "point": 1e3 * least(point),
        "bound": 1e3 * least(lambda: observability(systems, seed=next(seeds))),
        "rank": result.rank,
        "unknowns": result.unknowns,
        "points": len(result.points),
        "error": result.error_bound,
    }


def by_sympy(path: Path) -> dict[str, Any]:
    """Lie derivatives of the outputs and the rank of their Jacobian at one point, 50 digits."""
    import mpmath
    import sympy as sp

    fields = json.loads(path.read_text())
    names = [*fields["states"], *fields["params"], *fields["known_constants"]]
    inputs = fields["known_inputs"]
    table = {n: sp.Symbol(n) for n in (*names, *inputs)}
    f = [sp.sympify(fields["equations"][x], locals=table) for x in fields["states"]]
    lie = [sp.sympify(y, locals=table) for y in fields["outputs"].values()]
    columns = [table[n] for n in (*fields["states"], *fields["params"])]
    rates = dict(zip(columns, f, strict=False))
    newest = [table[u] for u in inputs]
    numbers = {s: mpmath.mpf(k + 2) / 7 + mpmath.sqrt(k + 2) for k, s in enumerate(table.values())}
    begin = time.perf_counter()
    rows: list[Any] = []
    rank, previous = 0, -1
    with mpmath.workdps(50):
        while rank > previous and rank < len(columns):
            jacobian = sp.Matrix(lie).jacobian(columns)
            point = sp.lambdify(list(numbers), jacobian, "mpmath", cse=True)(*numbers.values())
            rows += point.tolist()
            singular = mpmath.svd_r(mpmath.matrix(rows), compute_uv=False)
            previous, rank = (
                rank,
                sum(1 for v in singular if v > singular[0] * mpmath.mpf(10) ** -35),
            )
            for i, u in enumerate(newest):
                following = sp.Symbol(f"{u}'")
                numbers[following] = mpmath.mpf(len(numbers)) / 9
                rates[u], newest[i] = following, following
            lie = [sum(sp.diff(y, s) * g for s, g in rates.items()) for y in lie]
    return {"seconds": time.perf_counter() - begin, "rank": rank}


def by_symident(path: Path) -> dict[str, Any]:
    """Detection of all symmetries."""
    import symident

    fields = json.loads(path.read_text())
    model = symident.Model(
        fields["equations"],
        fields["outputs"],
        known_inputs=fields["known_inputs"],
        fixed=fields["known_constants"],
        parameters=fields["params"],
    )
    begin = time.perf_counter()
    found = symident.detect(model)
    return {"seconds": time.perf_counter() - begin, "rank": found.rank}


PARTS: dict[str, Callable[[Path], dict[str, Any]]] = {"sympy": by_sympy, "symident": by_symident}


def in_a_process(part: str, path: Path, limit: float) -> dict[str, Any] | None:
    """One contender on one file; None where it is cut."""
    command = [sys.executable, "-m", "benchmarks.identifiability", "--part", part, str(path)]
    environment = {**os.environ, **dict.fromkeys(THREADS, "1")}
    try:
        done = subprocess.run(
            command,
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=limit,
        )
    except subprocess.TimeoutExpired:
        return None
    if done.returncode != 0:
        raise SystemExit(f"{part} on {path.name} failed:\n{done.stderr[-2000:]}")
    result: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return result


def beside(found: dict[str, Any] | None, ours: dict[str, Any], limit: float) -> str:
    """A contender's time, its ratio to ours, and whether the rank is another one."""
    if found is None:
        return f"> {limit:4.0f} s (> {1e3 * limit / ours['bound']:7.0f})"
    other = "" if found["rank"] == ours["rank"] else f" rank {found['rank']}!"
    return f"{found['seconds']:6.2f} s ({1e3 * found['seconds'] / ours['bound']:9.0f}){other}"


def table(folder: Path, *, quick: bool) -> list[bool]:
    """All files; which targets are met."""
    from importlib.util import find_spec

    limit = 5.0 if quick else LIMIT
    parts = ["sympy", *(["symident"] if find_spec("symident") else [])]
    print(
        f"{'':20} rank     ms/point  ms/bound points  error   " + "".join(f"{p:>24}" for p in parts)
    )
    print(f"{'':58}" + f"{'time (ratio to bound)':>24}" * len(parts))
    met: list[bool] = []
    results: dict[str, dict[str, Any]] = {}
    for path in sorted(folder.glob("*.json")):
        ours = results[path.stem] = by_casid(path)
        fields = json.loads(path.read_text())
        line = (
            f"{path.stem:20} {ours['rank']:3}/{ours['unknowns']:<3} {ours['point']:8.2f}  "
            f"{ours['bound']:8.2f} {ours['points']:6}  {ours['error']:<8.1e}"
        )
        if "data_sets" not in fields and not fields["unknown_inputs"]:
            for part in parts:
                line += f"{beside(in_a_process(part, path, limit), ours, limit):>24}"
        print(line, flush=True)
    largest = results.pop(LARGEST)
    print()
    met.append(judged(f"{LARGEST}, one point", largest["point"], POINT_MS, "ms"))
    met.append(judged(f"{LARGEST}, with bound", largest["bound"], BOUND_MS, "ms"))
    slowest = max(results, key=lambda n: results[n]["bound"])
    met.append(
        judged(f"slowest other with bound: {slowest}", results[slowest]["bound"], OTHER_MS, "ms")
    )
    return met


def subsets(folder: Path) -> list[bool]:
    """All minimal fixing sets of one model, all sensor subsets of another."""
    from casid.identifiability.combinations.fixing_sets import fixing_sets
    from casid.identifiability.equations.equation_file import read_equations
    from casid.identifiability.rank.observability import observability
    from casid.identifiability.remedies.sensor_subsets import sensor_subsets

    (akt,) = read_equations(folder / "akt_fujita.json").systems
    (nfkb,) = read_equations(folder / f"{LARGEST}.json").systems
    counts: dict[str, int] = {}

    def fixing() -> None:
        point = observability(akt).points[0]
        counts["fixing"] = fixing_sets(point.information, point.parameters, point.prime).count

    def sensors() -> None:
        counts["sensors"] = len(sensor_subsets(nfkb).subsets)

    seconds = [least(fixing), least(sensors, 2)]
    return [
        judged(
            f"all {counts['fixing']} fixing sets of akt_fujita", seconds[0], FIXING_SECONDS, "s"
        ),
        judged(
            f"all {counts['sensors']} sensor subsets of {LARGEST}", seconds[1], SENSOR_SECONDS, "s"
        ),
    ]


# ---------------------------------------------------------------------- growth


def chain(n: int, *, is_saturated: bool, every: int = 5) -> Any:
    """n states in a row, each with a rate of its own; every so many, one is measured, and the last.

    The rates are linear, or of Michaelis and Menten with one constant K for all.
    """
    from casid.identifiability.equations.equation_text import parse_system

    def flow(i: int) -> str:
        return f"k{i}*x{i}/(K + x{i})" if is_saturated else f"k{i}*x{i}"

    equations = {"x1": f"u - {flow(1)}"}
    equations |= {f"x{i}": f"{flow(i - 1)} - {flow(i)}" for i in range(2, n + 1)}
    measured = sorted({*range(every, n + 1, every), n})
    return parse_system(
        {
            "states": list(equations),
            "params": [*(f"k{i}" for i in range(1, n + 1)), *(["K"] if is_saturated else [])],
            "inputs": ["u"],
            "equations": equations,
            "outputs": {f"y{i}": f"x{i}" for i in measured},
        },
        name=f"chain of {n}",
    )


def one_chain(n: int, *, is_saturated: bool, every: int) -> dict[str, float]:
    """Seconds of a full answer, and peak memory of one more [MB]."""
    import tracemalloc

    from casid.identifiability.rank.observability import observability

    system = chain(n, is_saturated=is_saturated, every=every)
    found = observability(system)
    seconds = least(lambda: observability(system), 3 if n <= 50 else 2)
    tracemalloc.start()
    observability(system)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return {
        "unknowns": found.unknowns,
        "rank": found.rank,
        "order": max(found.orders),
        "seconds": seconds,
        "series_MB": found.bytes / 1e6,
        "peak_MB": peak / 1e6,
    }


def exponent(sizes: list[float], values: list[float]) -> float:
    """Slope of log value over log size, by least squares over the upper half."""
    import numpy as np

    upper = len(sizes) // 2
    return float(np.polyfit(np.log(sizes[upper:]), np.log(values[upper:]), 1)[0])


def growth(out: Path | None, *, quick: bool) -> None:
    """Chains of growing length: time, memory and their exponents; a figure if a folder is given."""
    lengths = [5, 10, 20, 40] if quick else [5, 10, 15, 20, 30, 40, 50, 60, 80, 100]
    series: dict[str, list[dict[str, float]]] = {}
    for label, is_saturated, every in (
        ("linear rates, every fifth measured", False, 5),
        ("Michaelis-Menten rates, every fifth measured", True, 5),
        ("linear rates, the last measured", False, max(lengths)),
        ("Michaelis-Menten rates, every 20th measured", True, 20),
    ):
        print(f"\nchains, {label}")
        print("   states  unknowns   rank  order        time     series       peak")
        series[label] = []
        for n in lengths:
            row = one_chain(n, is_saturated=is_saturated, every=every)
            series[label].append(row)
            print(
                f"{n:9} {row['unknowns']:9.0f} {row['rank']:6.0f} {row['order']:6.0f} "
                f"{1e3 * row['seconds']:8.1f} ms {row['series_MB']:7.2f} MB "
                f"{row['peak_MB']:7.2f} MB",
                flush=True,
            )
        sizes = [row["unknowns"] for row in series[label]]
        for quantity, key in (("time", "seconds"), ("peak memory", "peak_MB")):
            slope = exponent(sizes, [row[key] for row in series[label]])
            print(f"  {quantity} grows as (states + parameters)^{slope:.2f} over the upper half")
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        path = out / "identifiability_growth.html"
        figure(series).write_html(path, include_plotlyjs="cdn")
        print(f"\nfigure: {path}")


def figure(series: dict[str, list[dict[str, float]]]) -> Any:
    """Time over the number of unknowns, logarithmic, with the fitted powers."""
    import plotly.graph_objects as go

    drawn = go.Figure()
    for label, rows in series.items():
        sizes, times = [r["unknowns"] for r in rows], [r["seconds"] for r in rows]
        slope = exponent(sizes, times)
        drawn.add_scatter(x=sizes, y=times, mode="markers", name=label)
        upper = sizes[len(sizes) // 2 :]
        middle = math.exp(
            sum(
                math.log(t) - slope * math.log(s)
                for s, t in zip(sizes, times, strict=True)
                if s in upper
            )
            / len(upper)
        )
        line = [middle * s**slope for s in upper]
        drawn.add_scatter(x=upper, y=line, mode="lines", name=f"exponent {slope:.2f}")
    drawn.update_layout(
        title="Time of an exact rank with all verdicts, chains of up to 100 states",
        xaxis={"title": "states + parameters [1]", "type": "log"},
        yaxis={"title": "time [s]", "type": "log"},
    )
    return drawn


def main() -> int:
    """Run all; 0 if every target is met."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    shared = Path(os.environ.get("CASID_SHARED", ROOT.parent / "shared"))
    parser.add_argument("--models", type=Path, default=shared / "identifiability")
    parser.add_argument("--out", type=Path, help="folder for the figure of the growth")
    parser.add_argument("--quick", action="store_true", help="contenders cut after 5 s, 40 states")
    parser.add_argument("--part", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.part:
        part, path = arguments.part
        print(json.dumps(PARTS[part](Path(path))), flush=True)
        return 0
    if not arguments.models.is_dir():
        raise SystemExit(f"{arguments.models}: no such folder; name the equation files by --models")
    met = [*table(arguments.models, quick=arguments.quick), *subsets(arguments.models)]
    growth(arguments.out, quick=arguments.quick)
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
