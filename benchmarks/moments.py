"""Constrained least squares from cross moments, beside its bare sums and a statistics package.

    python -m benchmarks.moments [--quick | --repeats N]

One record of 150 000 samples, three coefficients, one linear constraint: moments and a prebuilt
Ipopt solve, beside the dot products alone and beside statsmodels' constrained GLM, in one process
on one thread. Then streams of growing length in fresh processes, for their peak memory. Exit
status 1 when a target is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

N, TS = 150_000, 0.01  # samples, sample time [s]
THETA = np.array([-1.96487, 0.982202, 0.033088])  # a1, a2, b0 of Linder (2017), section 7.5.1
SPRING, MOMENT = 10.39, 22.04 * -0.018  # k [N m/rad], S = M z_g [kg m]
B = np.array([[-MOMENT / SPRING, -MOMENT / SPRING, -2 * TS]])  # (7.41): I_x and d unknown
RHS = np.array([MOMENT / SPRING])
NOISE = 0.01  # standard deviation of the measurement noise on both signals
EQUAL = 1e-7  # relative agreement of the estimates
CHUNK = 100_000  # samples a chunk of a stream


# ---------------------------------------------------------------------- the record


def record(seed: int = 1) -> dict[str, np.ndarray]:
    """y_t = -a1 y_{t-1} - a2 y_{t-2} + b0 (u_t - u_{t-2}), u a telegraph, noise on both."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(seed)
    switched = np.where(np.cumsum(rng.random(N) < TS) % 2, 0.3, -0.3)
    u = lfilter([0.05], [1.0, -0.95], switched)
    y = lfilter(THETA[2] * np.array([1.0, 0.0, -1.0]), [1.0, *THETA[:2]], u)
    return {
        "y": y + NOISE * rng.standard_normal(N),
        "u": u + NOISE * rng.standard_normal(N),
    }


# ---------------------------------------------------------------------- the contenders


def bare(signals: dict[str, np.ndarray]) -> Callable[[], list[float]]:
    """The eleven dot products on views that the moments of two channels at lags 0 to 2 need."""
    y, u = signals["y"], signals["u"]
    pairs = [
        *((x[2:], x[2 - lag : N - lag]) for x in (y, u) for lag in range(3)),
        *((y[2:], u[2 - lag : N - lag]) for lag in range(3)),
        *((u[2:], y[2 - lag : N - lag]) for lag in (1, 2)),
    ]
    return lambda: [float(np.dot(a, b)) for a, b in pairs]


def through_ipopt(signals: dict[str, np.ndarray]) -> tuple[Callable[[], Any], Callable[[], Any]]:
    """Moments alone; moments and the prebuilt solve, which returns theta (3,)."""
    import casadi as ca

    from casid.estimation.cross_moments.moments import moments
    from casid.estimation.nlp.nlp import Nlp
    from casid.linear.sampled.lagged_columns import Column, lagged

    columns = (*lagged("y", range(1, 3), -1.0), Column("u", (("u", 0, 1.0), ("u", 2, -1.0))))
    all_columns = (*columns, *lagged("y", range(1)))
    nlp = Nlp("constrained least squares")
    theta = ca.vertcat(*[nlp.variable(f"theta{i}", 0.0, scale=1.0) for i in range(3)])
    Phi, Y = nlp.parameter("Phi", 3, 3), nlp.parameter("Y", 3)
    rows, rhs = nlp.parameter("B", 1, 3), nlp.parameter("b")
    nlp.minimize(theta.T @ Phi @ theta / 2 - theta.T @ Y)
    nlp.equality(rows @ theta, rhs)
    compiled = nlp.compile()

    def estimate() -> Any:
        gram = moments(signals, 2).between(columns, all_columns)
        return compiled.solve({"Phi": gram[:, :3], "Y": gram[:, 3], "B": B, "b": RHS}).x

    return lambda: moments(signals, 2), estimate


def on_samples(signals: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The regression written out: (N - 2, 3) regressors and (N - 2,) outputs."""
    y, u = signals["y"], signals["u"]
    return np.column_stack([-y[1:-1], -y[:-2], u[2:] - u[:-2]]), y[2:]


def null_space(Phi: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """The exact answer: the constraint eliminated, QR on the samples."""
    Q, _ = np.linalg.qr(B.T, mode="complete")
    particular = np.linalg.lstsq(B, RHS, rcond=None)[0]
    free = np.linalg.lstsq(Phi @ Q[:, 1:], Y - Phi @ particular, rcond=None)[0]
    return np.asarray(particular + Q[:, 1:] @ free)


def statistics_package(Phi: np.ndarray, Y: np.ndarray) -> Callable[[], Any]:
    """statsmodels' constrained GLM, Gaussian family; returns theta (3,)."""
    import statsmodels.api as sm

    return lambda: np.asarray(sm.GLM(Y, Phi).fit_constrained((B, RHS)).params)


def constrained(repeats: int) -> dict[str, Any]:
    """Time all contenders in turns; their least and median seconds, and estimates.

    Ratios are taken of the least times: what else the machine does is no contender's own.
    """
    signals = record()
    Phi, Y = on_samples(signals)
    sums = bare(signals)
    only_moments, estimate = through_ipopt(signals)
    glm = statistics_package(Phi, Y)
    tasks: dict[str, tuple[Callable[[], Any], int]] = {
        "bare": (sums, 20),
        "moments": (only_moments, 20),
        "casid": (estimate, 20),
        "statsmodels": (glm, 1),
    }
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    answers: dict[str, Any] = {}
    for turn in range(repeats + 1):
        for name, (task, times) in tasks.items():
            for _ in range(times):
                start = time.perf_counter()
                answers[name] = task()
                taken = time.perf_counter() - start
                if turn:  # the first turn warms up
                    seconds[name].append(taken)
    return {
        "seconds": {name: min(values) for name, values in seconds.items()},
        "medians": {name: statistics.median(values) for name, values in seconds.items()},
        "theta": {name: answers[name].tolist() for name in ("casid", "statsmodels")}
        | {"null space, QR": null_space(Phi, Y).tolist()},
    }


# ---------------------------------------------------------------------- memory


def peak_megabytes() -> float:
    """Peak resident memory of this process alone [MB]."""
    status = Path("/proc/self/status")
    if status.exists():  # a child's ru_maxrss begins with its parent's
        line = next(x for x in status.read_text().splitlines() if x.startswith("VmHWM"))
        return float(line.split()[1]) * 1024 / 1e6
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1e6 if sys.platform == "darwin" else 1e6 / 1024)


def streamed(samples: int) -> dict[str, Any]:
    """Moments of two generated channels behind a filter of 21 taps, a chunk at a time."""
    from casid.data.fir_filter import equiripple
    from casid.estimation.cross_moments.moments import Accumulator

    rng = np.random.default_rng(1)
    stream = Accumulator(("y", "u"), 2, prefilter=equiripple(0.5, TS, stop_hz=6.0))
    chunk = {"y": np.empty(CHUNK), "u": np.empty(CHUNK)}
    start = time.perf_counter()
    for first in range(0, samples, CHUNK):
        for values in chunk.values():
            rng.standard_normal(out=values)
        n = min(CHUNK, samples - first)
        stream.add({name: values[:n] for name, values in chunk.items()})
    result = stream.moments
    return {
        "megabytes": peak_megabytes(),
        "seconds": time.perf_counter() - start,
        "N": result.N,
    }


def written(path: Path, samples: int) -> None:
    """Write two channels to a Parquet file, a row group at a time."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    rng = np.random.default_rng(1)
    schema = pa.schema([("y", pa.float64()), ("u", pa.float64())])
    with pq.ParquetWriter(path, schema) as writer:
        for _ in range(0, samples, CHUNK):
            table = {name: rng.standard_normal(CHUNK) for name in ("y", "u")}
            writer.write_table(pa.table(table, schema=schema))


def read(path: Path) -> dict[str, Any]:
    """Moments of a file."""
    from casid.estimation.cross_moments.moments import of_file

    start = time.perf_counter()
    result = of_file(path, {"y": "y", "u": "u"}, 2)
    return {
        "megabytes": peak_megabytes(),
        "seconds": time.perf_counter() - start,
        "N": result.N,
    }


# ---------------------------------------------------------------------- the run


def in_a_fresh_process(*arguments: str) -> dict[str, Any]:
    """Run one part of this file on one thread; its result."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.moments", *arguments],
        cwd=ROOT,
        env={**os.environ, **dict.fromkeys(THREADS, "1")},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(arguments)} failed:\n{done.stderr[-2000:]}")
    result: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return result


def judged(label: str, value: float, target: float) -> bool:
    """Print a number beside its target; True if the target is met."""
    met = value <= target
    print(f"  {label:<46} {value:9.3g}   at most {target:<7.3g} {'met' if met else 'MISSED'}")
    return met


def judge_times(result: dict[str, Any]) -> list[bool]:
    """Print times, estimates and ratios of `constrained`; which targets are met."""
    seconds, theta = result["seconds"], result["theta"]
    print(f"least squares, {N} samples, 3 coefficients, 1 constraint; one thread; least (median)")
    labels = {
        "bare": "11 dot products on views",
        "moments": "casid.estimation.cross_moments.moments.moments",
        "casid": "moments and prebuilt Ipopt solve",
        "statsmodels": "statsmodels GLM.fit_constrained",
    }
    for name, label in labels.items():
        medians = result["medians"]
        print(f"  {label:<46} {1e3 * seconds[name]:9.3f} ms  ({1e3 * medians[name]:.3f})")
    for name, values in theta.items():
        print(f"  {name:<20}" + "".join(f"{v:18.12f}" for v in values))
    reference = np.array(theta["null space, QR"])
    apart = {
        name: float(np.max(np.abs(np.array(values) / reference - 1)))
        for name, values in theta.items()
    }
    return [
        judged("casid / dot products", seconds["casid"] / seconds["bare"], 6.0),
        judged("casid / statsmodels", seconds["casid"] / seconds["statsmodels"], 1 / 100),
        judged("casid's estimate, relative to the exact one", apart["casid"], EQUAL),
        judged("statsmodels' estimate, relative", apart["statsmodels"], EQUAL),
    ]


def judge_memory(label: str, short: dict[str, Any], long: dict[str, Any]) -> bool:
    """Print peak memories of a short and a long stream; True if they are alike."""
    for result in (short, long):
        print(
            f"  {label}, {result['N']:>11} terms"
            f" {result['megabytes']:9.1f} MB {result['seconds']:8.2f} s"
        )
    return judged("peak memory, long / short", long["megabytes"] / short["megabytes"], 1.1)


def main() -> int:
    """Run the benchmark; 0 if every target is met."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=10, help="turns of the contenders (10)")
    parser.add_argument("--quick", action="store_true", help="3 turns, streams of 1e7 samples")
    parser.add_argument("--part", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.part:
        kind, value = arguments.part
        parts: dict[str, Callable[[str], dict[str, Any]]] = {
            "constrained": lambda text: constrained(int(text)),
            "stream": lambda text: streamed(int(text)),
            "read": lambda text: read(Path(text)),
        }
        print(json.dumps(parts[kind](value)), flush=True)
        return 0
    repeats = 3 if arguments.quick else arguments.repeats
    met = judge_times(in_a_fresh_process("--part", "constrained", str(repeats)))
    longest = 10_000_000 if arguments.quick else 100_000_000
    print("\nstreams of two channels, 21 taps, lags 0 to 2, in fresh processes")
    streams = [in_a_fresh_process("--part", "stream", str(n)) for n in (1_000_000, longest)]
    met.append(judge_memory("generated", *streams))
    with tempfile.TemporaryDirectory() as folder:
        files = []
        for n in (1_000_000, longest // 10):
            path = Path(folder) / f"{n}.parquet"
            written(path, n)
            files.append(in_a_fresh_process("--part", "read", str(path)))
        if not arguments.quick:
            met.append(judge_memory("Parquet  ", *files))
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
