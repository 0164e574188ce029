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

import _thread
import contextlib
import math
import signal
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from scipy.stats import binomtest

from casid.arrays import Array
from casid.campaigns.campaign import campaign
from casid.campaigns.manifest import manifest_of
from casid.campaigns.parquet_parts import FAILED, Parts
from casid.campaigns.problem_origin import ProblemOrigin
from casid.data.problem import Problem
from casid.deprecation import renamed
from casid.diagnosis.calibration.null_records import NullNoise, NullRecords, null_noise
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.thresholds import CALIBRATING
from casid.diagnosis.verdict.cause import Cause, Ranked, Verdict
from casid.errors import CasidError, DataError, SolveError
from casid.estimation.holdout import Split
from casid.estimation.simulation.minimization import Fit
from casid.presentation import Presented, present
from casid.time_limit import require_time, seconds_left, time_factor

if TYPE_CHECKING:
    from numpy.random import SeedSequence


class Diagnosed(Protocol):
    """What a calibration reads of the diagnosis of a null record."""

    @property
    def verdict(self) -> Verdict:
        """What was decided."""
        ...

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What was named."""
        ...

    @property
    def ranking(self) -> tuple[Ranked, ...]:
        """The first round's candidates."""
        ...


Diagnose = Callable[..., Diagnosed]
"""Called with problem and experiments, and `hold_out` and `false_alarm_rate` by name."""

SOURCES = (
    "G. A. Barnard, J. R. Stat. Soc. B 25 (1963) 294: Monte Carlo tests",
    "A. C. Davison, D. V. Hinkley, Bootstrap Methods and their Application, Cambridge 1997",
    "C. J. Clopper, E. S. Pearson, Biometrika 26 (1934) 404-413: interval of a share",
)
"""Papers behind a calibration."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration(Presented):
    """The actual rate of a false-alarm level on one record.

    Attributes
    ----------
    alpha : the family-wise rate that was requested.
    requested : null records requested; `runs` are those diagnosed.
    levels : (runs,) the level at which each null record becomes an alarm: its cause's p-value, or
        the smallest adjusted p, but no less than `alpha`, where there was none.
    smallest : (runs,) smallest adjusted p of each record's first table of scores, 1 without one.
    alarms : (runs,) bool, called deficient at `alpha`.
    seed : of all drawings.
    undecided : null records that could not support an answer.
    failures : message -> null records whose diagnosis failed with it; they count for nothing.
    is_interrupted : True if fewer were done than requested.
    """

    problem: str
    alpha: float
    requested: int
    levels: Array
    smallest: Array
    alarms: Array
    seed: int = 0
    undecided: int = 0
    failures: Mapping[str, int] = field(default_factory=dict)
    is_interrupted: bool = False

    asked = renamed("asked", "requested")

    @property
    def runs(self) -> int:
        """Null records that were diagnosed."""
        return len(self.levels)

    @property
    def rate(self) -> float:
        """Share of the null records that were called deficient at `alpha`."""
        return float(np.mean(self.alarms))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the rate (Clopper and Pearson 1934), exact for a binomial count."""
        found = binomtest(int(np.sum(self.alarms)), self.runs).proportion_ci(0.95, "exact")
        return float(found.low), float(found.high)

    @property
    def threshold(self) -> float:
        """The level (1) to judge the record at; `alpha` where the runs are too few to say."""
        k = self._rank
        return min(self.alpha, float(np.sort(self.levels)[k - 1])) if k else self.alpha

    @property
    def is_corrected(self) -> bool:
        """True if the threshold is stricter than the level requested."""
        return self.threshold < self.alpha

    @property
    def quantile(self) -> float:
        """The alpha-quantile of `smallest`: alpha, if scores alone decided and were exact."""
        k = self._rank
        return float(np.sort(self.smallest)[k - 1]) if k else math.nan

    @property
    def _rank(self) -> int:
        """k of (1)."""
        return math.floor(self.alpha * (self.runs + 1) * (1 + 1e-12))

    def p_value(self, level: float) -> float:
        """The calibrated p-value of an alarm at `level`: its rank among the null records.

        (1 + number of null records at that level or below) / (runs + 1).
        """
        return float((1 + np.sum(self.levels <= level)) / (self.runs + 1))

    @property
    def sentence(self) -> str:
        """What was found, in words."""
        low, high = (100 * x for x in self.interval)
        text = (
            f"Of {self.runs} null records (this one simulated with the fitted model), "
            f"{int(np.sum(self.alarms))} ({100 * self.rate:.3g} %, 95 % interval {low:.2g} to "
            f"{high:.2g} %) were called deficient, where {100 * self.alpha:g} % was requested"
        )
        if not self._rank:
            needed = math.ceil(1 / self.alpha - 1e-9) - 1
            return (
                f"{text}; the threshold is unchanged, since correcting it needs at least {needed} "
                "null records"
            )
        if self.is_corrected:
            return f"{text}; judged at the stricter level {self.threshold:.2g} instead"
        return f"{text}; the threshold is unchanged"

    @property
    def notes(self) -> tuple[str, ...]:
        """What bears on the trust in it."""
        out = []
        if self.is_interrupted:
            out.append(f"interrupted: {self.runs} of {self.requested} null records were done")
        if self.undecided:
            out.append(f"undecided null records, not counted as alarms: {self.undecided}")
        out += [f"{n} null records failed: {message}" for message, n in self.failures.items()]
        return tuple(out)

    def to_json(self) -> dict[str, Any]:
        """Every number, for `diagnosis.json`."""
        return {
            "alpha": self.alpha,
            "asked": self.requested,
            "runs": self.runs,
            "alarms": int(np.sum(self.alarms)),
            "rate": self.rate,
            "interval": list(self.interval),
            "threshold": self.threshold,
            "is_corrected": self.is_corrected,
            "levels": self.levels.tolist(),
            "smallest_adjusted_p": self.smallest.tolist(),
            "quantile": None if math.isnan(self.quantile) else self.quantile,
            "seed": self.seed,
            "undecided": self.undecided,
            "failures": dict(self.failures),
            "is_interrupted": self.is_interrupted,
            "sentence": self.sentence,
        }

    def __repr__(self) -> str:
        return (
            f"<Calibration {self.problem}: {self.runs} runs, rate {self.rate:.3g} at "
            f"{self.alpha:g}, threshold {self.threshold:.2g}>"
        )

    def plot(self) -> Any:
        """Histogram of the smallest adjusted p against the uniform, as a Plotly figure."""
        return present(self, "figure")

    def references(self) -> tuple[str, ...]:
        """The papers behind the method."""
        return SOURCES


@dataclass(frozen=True, slots=True, eq=False)
class Null:
    """The hypothesis that nothing is missing, for one problem and its records.

    Attributes
    ----------
    split : what was recorded, fitted and held out, with what is to be left out marked missing.
    at : the fitted model and its noise.
    base_fit : the fit of the model as it is.
    """

    split: Split
    at: Weighted
    base_fit: Fit


def calibrate(
    problem: Problem,
    null: Null,
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
    null : what the records are drawn from.
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
    run = NullRun(problem, _recipe(null), diagnose_null, alpha)
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


def _share(split: Split) -> float:
    """The share held out at the end of every record; the same number of samples comes of it."""
    return float(np.mean(split.held[0])) if split.held and not split.apart else 0.0


# -- one run --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Recipe:
    """What null records are drawn from, without anything of CasADi: it goes to other processes."""

    whole: tuple[Any, ...]
    apart: tuple[Any, ...]
    hold_out: float
    values: Mapping[str, float]
    noise: NullNoise
    own: tuple[str, ...]
    weights: Array
    substeps: int


def _recipe(null: Null) -> _Recipe:
    at, split, c = null.at, null.split, null.base_fit.criterion
    return _Recipe(
        whole=tuple(split.whole),
        apart=tuple(split.apart),
        hold_out=_share(split),
        values=(at.unbiased or at.fit).values,
        noise=null_noise(at.full, at.criterion.outputs, at.input_sd),
        own=tuple(c.own),
        weights=c.weights,
        substeps=c.substeps,
    )


class NullRun:
    """One run of a calibration: draw a null record with a seed, and diagnose it."""

    def __init__(
        self, problem: Problem, recipe: _Recipe, diagnose_null: Diagnose, alpha: float
    ) -> None:
        self.problem, self.recipe = problem, recipe
        self.diagnose_null, self.alpha = diagnose_null, alpha
        self.stop = threading.Event()
        self._records: NullRecords | None = None

    @property
    def records(self) -> NullRecords:
        """What draws the null records."""
        if self._records is None:
            r = self.recipe
            self._records = NullRecords(
                self.problem.model,
                r.whole,
                r.apart,
                r.values,
                r.noise,
                own=r.own,
                weights=r.weights,
                substeps=r.substeps,
            )
        return self._records

    def __call__(self, seed: SeedSequence) -> dict[str, Any]:
        """Verdict, level of alarm and smallest adjusted p of one null record."""
        if self.stop.is_set():
            raise KeyboardInterrupt
        whole, apart = self.records.draw(np.random.default_rng(seed))
        d = self.diagnose_null(
            self.problem,
            whole,
            hold_out=apart or self.recipe.hold_out,
            false_alarm_rate=self.alpha,
        )
        if seconds_left() <= 0.0:
            raise KeyboardInterrupt  # ended in the middle: no answer
        smallest = min((r.adjusted for r in d.ranking), default=1.0)
        level = max(smallest, self.alpha)
        if d.verdict == "deficient":
            # An alarm at alpha, whatever p its causes have.
            level = min(
                min((c.p_value for c in d.causes), default=0.0), CALIBRATING.alarm * self.alpha
            )
        elif d.verdict == "undecided":
            level = 1.0
        return {"verdict": d.verdict, "level": float(level), "smallest": float(smallest)}

    def __reduce__(self) -> Any:
        origin = ProblemOrigin.of(self.problem)
        return _run_again, (origin, self.recipe, self.diagnose_null, self.alpha)


def _run_again(origin: ProblemOrigin, *rest: Any) -> NullRun:
    return NullRun(origin.problem(), *rest)


def _can_travel(problem: Problem) -> bool:
    """True if another process gets the same problem from its file."""
    try:
        ProblemOrigin.of(problem).problem()
    except CasidError:
        return False
    return True


# -- all runs -------------------------------------------------------------------------------------


def _table(
    run: NullRun, runs: int, seed: int, jobs: int | None, say: Callable[[str], None]
) -> tuple[Any, bool]:
    """The rows of all runs, and whether Ctrl-C ended them before."""
    import joblib

    workers = joblib.effective_n_jobs(jobs)
    where: dict[str, Any] = {} if jobs is None else {"n_jobs": jobs}
    if workers > 1 and not _can_travel(run.problem):
        say(f"calibrate in one process: no file defines problem {run.problem.name} as it is")
        workers, where = 1, {"backend": "sequential"}
    with tempfile.TemporaryDirectory(prefix="casid-calibration-") as scratch:
        folder = Path(scratch) / "runs"
        try:
            with _interruptible(run.stop, is_serial=workers == 1), _ended_in_time(run.stop):
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
                            run, runs, seed=seed, out=folder, batch=1, progress=_labelled(say)
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


def _labelled(say: Callable[[str], None]) -> Callable[[str], None]:
    def line(text: str) -> None:
        if not text.endswith("were done before"):
            say(f"calibrate: {text}")

    return line


@contextlib.contextmanager
def _ended_in_time(stop: threading.Event) -> Iterator[None]:
    """Do at the time limit what Ctrl-C does."""
    seconds = seconds_left()
    if not math.isfinite(seconds):
        yield
        return
    is_main = threading.current_thread() is threading.main_thread()
    timer = threading.Timer(
        seconds * time_factor(), _thread.interrupt_main if is_main else stop.set
    )
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextlib.contextmanager
def _interruptible(stop: threading.Event, *, is_serial: bool) -> Iterator[None]:
    """The first Ctrl-C ends the runs, the next one whatever it ended before.

    In one process the current run is finished: compiled solvers swallow an exception.
    """
    before: Any = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return

    def once(number: int, frame: Any) -> None:
        if stop.is_set():
            before(number, frame)
            return
        stop.set()
        if not is_serial:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, once)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
