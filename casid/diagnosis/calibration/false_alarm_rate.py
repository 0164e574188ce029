"""The false-alarm rate of a diagnosis, measured for its own problem and record.

The requested family-wise level rests on residuals that are stationary and a record that
is long against their memory. Here it is tried: the fitted model draws records as it would give them
(`null_records`), each is diagnosed as the recorded one is, and the share called deficient is the
actual level. With p_b the level at which null record b of B becomes an alarm, and k the whole
part of alpha (B + 1), judging at

    threshold = min(alpha, the k-th smallest p_b)                                              (1)

makes the rate at most alpha: the recorded one's rank among its like is uniform under the null
(G. A. Barnard, J. R. Stat. Soc. B 25 (1963) 294; A. C. Davison, D. V. Hinkley, Bootstrap Methods
and their Application, Cambridge 1997, section 4.2). A rate below alpha is left as it is: the runs
do not show what a search at a looser threshold would name.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from casid.campaigns.campaign import campaign
from casid.campaigns.manifest import manifest_of
from casid.campaigns.parquet_parts import FAILED, Parts
from casid.data.problem import Problem
from casid.diagnosis.calibration.calibration import Calibration
from casid.diagnosis.calibration.interruption import ended_in_time, interruptible
from casid.diagnosis.calibration.null_records import Recipe
from casid.diagnosis.calibration.null_runs import Diagnose, NullRun, can_travel
from casid.diagnosis.thresholds import CALIBRATING
from casid.errors import DataError, SolveError
from casid.time_limit import require_time


def calibrate(
    problem: Problem,
    recipe: Recipe,
    *,
    diagnose_null: Diagnose,
    alpha: float = 0.05,
    runs: int = CALIBRATING.runs,
    seed: int = 0,
    jobs: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Calibration:
    """Measure the false-alarm rate of a diagnosis on records that its model draws.

    Runs where `joblib.parallel_config` says, one process by default; the result does not depend on
    it. Ctrl-C ends the drawing and keeps what is done; a second one ends all.

    Parameters
    ----------
    recipe : what the records are drawn from.
    diagnose_null : what is run on every null record, with the settings of the diagnosis itself: a
        function at the top of a module, or a `functools.partial` of one.
    alpha : the family-wise rate requested.
    runs : null records; the first one is timed, and the time that all need is printed.
    jobs : processes; default as joblib's. A problem that no file defines as it is now cannot
        be sent to other processes and takes one.

    Raises
    ------
    DataError
        For a number of runs or a rate that is none.
    SolveError
        If no null record can be drawn or diagnosed.
    """
    require_runs(runs)
    say = progress or (lambda _: None)
    run = NullRun(problem, recipe, diagnose_null, alpha)
    table, is_interrupted = _table(run, runs, seed, jobs, say)
    done = table[table[FAILED].isna()] if len(table) else table
    if not len(done):
        if is_interrupted:
            raise KeyboardInterrupt("no null record was done; nothing is kept")
        message, n = Counter(table[FAILED].tolist()).most_common(1)[0]
        raise SolveError(
            f"{problem.name}: none of {len(table)} null records could be diagnosed, {n} of them: "
            f"{message}. Diagnose without --calibrate, or another window"
        )
    verdicts = done["verdict"].tolist()
    return Calibration(
        problem=problem.name,
        alpha=alpha,
        requested=runs,
        levels=done["level"].to_numpy(float),
        smallest=done["smallest"].to_numpy(float),
        alarms=np.array([v == "deficient" for v in verdicts]),
        seed=seed,
        undecided=verdicts.count("undecided"),
        failures=dict(Counter(table[FAILED].dropna().tolist())),
        is_interrupted=is_interrupted,
    )


def require_runs(runs: object) -> None:
    """Refuse a number of null records that is none.

    Raises
    ------
    DataError
        Saying what to give.
    """
    is_whole = isinstance(runs, int | np.integer) and not isinstance(runs, bool)
    if not is_whole or int(runs) < 1:  # type: ignore[call-overload]
        raise DataError(
            f"calibrate = {runs!r}: give the number of null records, a whole number from 1 on, "
            f"for example calibrate={CALIBRATING.runs} (--calibrate {CALIBRATING.runs})"
        )


def _table(
    run: NullRun, runs: int, seed: int, jobs: int | None, say: Callable[[str], None]
) -> tuple[Any, bool]:
    """The rows of all runs, and whether Ctrl-C ended them before."""
    import joblib

    workers = joblib.effective_n_jobs(jobs)
    where: dict[str, Any] = {} if jobs is None else {"n_jobs": jobs}
    if workers > 1 and not can_travel(run.problem):
        say(f"calibrate in one process: no file defines problem {run.problem.name} as it is")
        workers, where = 1, {"backend": "sequential"}
    with tempfile.TemporaryDirectory(prefix="casid-calibration-") as scratch:
        folder = Path(scratch) / "runs"
        try:
            with interruptible(run.stop, is_serial=workers == 1), ended_in_time(run.stop):
                start = time.perf_counter()
                with joblib.parallel_config(backend="sequential"):
                    done = campaign(run, 1, seed=seed, out=folder, batch=1)
                one = time.perf_counter() - start
                if runs > 1:
                    rounds = math.ceil((runs - 1) / workers)
                    say(
                        f"calibrate: one null record took {one:.2g} s, all {runs} take about "
                        f"{_time_text(rounds * one)}"
                        + (f" in {workers} processes" if workers > 1 else "")
                        + "; Ctrl-C continues with those done"
                    )
                    with joblib.parallel_config(**where):
                        done = campaign(
                            run,
                            runs,
                            seed=seed,
                            out=folder,
                            batch=1,
                            progress=lambda text: say(f"calibrate: {text}"),
                        )
            return done.table, False
        except KeyboardInterrupt:
            parts = Parts(folder, manifest_of(run, seed))
            n = len(parts.runs)
            if not n:
                require_time("the calibration")
                raise KeyboardInterrupt("no null record was done; nothing is kept") from None
            say(f"interrupted: the diagnosis continues with {n} of {runs} null records")
            return parts.end().to_pandas(), True


def _time_text(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
