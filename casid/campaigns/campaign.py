"""Campaigns: one function, many runs, each with its own seed, through joblib.

Monte Carlo, bootstrap, sweeps: what runs where is chosen by the caller's own
`joblib.parallel_config`, from one process to a cluster of Dask workers:

    with joblib.parallel_config(n_jobs=4):                    # local processes (loky)
        campaign(study, 10_000, out="study")
    client = dask.distributed.Client("scheduler:8786")
    with joblib.parallel_config(backend="dask"):
        campaign(study, 10_000, out="study")

The results are the same, bit for bit, whatever is chosen there, and whether or not the campaign was
stopped and continued on the way.
"""

from __future__ import annotations

import contextlib
import itertools
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.campaigns.batches import UNLOADABLE, Done, Function, run_batch
from casid.campaigns.batches import run_seed as run_seed
from casid.campaigns.dask_backend import outliving_workers
from casid.campaigns.manifest import manifest_of
from casid.campaigns.parquet_parts import FAILED, RUN, Parts
from casid.campaigns.progress import reported
from casid.errors import CasidError, DataError, SolveError, UnknownNameError
from casid.model.quantities import are, count_text
from casid.time_limit import seconds_left, wall_clock

if TYPE_CHECKING:
    pass

_SECONDS = 2.0  # that a batch is to take: what a killed campaign loses of each worker
_LARGEST = 1000
_DEATHS = 30  # of workers, one after another with no run finished: nothing will finish


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """The results of a campaign.

    Attributes
    ----------
    name : of the function.
    table : pandas.DataFrame, one row a run in their order: `run`, the results, and `failed`, why a
        run has no results (missing where it has).
    folder : where `results.parquet` lies, None where none was requested.
    found : runs that an earlier call had done.
    deaths : workers that died on the way; their runs were done again.
    not_done : runs that no time was left for; the same call again does them.
    """

    name: str
    seed: int
    table: Any
    folder: Path | None = None
    found: int = 0
    deaths: int = 0
    not_done: int = 0

    @property
    def runs(self) -> int:
        """Number of runs, failed ones included."""
        return len(self.table)

    @property
    def failures(self) -> dict[int, str]:
        """Run number -> why it failed."""
        bad = self.table[self.table[FAILED].notna()]
        return dict(zip(bad[RUN].tolist(), bad[FAILED].tolist(), strict=True))

    def column(self, name: str) -> Array:
        """(n,) the result `name` of the runs that did not fail, in their order.

        Raises
        ------
        UnknownNameError
            If no run has such a result.
        """
        if name not in self.table.columns or name in (RUN, FAILED):
            there = [c for c in self.table.columns if c not in (RUN, FAILED)]
            raise UnknownNameError(f"no result {name!r}; there are {', '.join(there) or 'none'}")
        return np.asarray(self.table.loc[self.table[FAILED].isna(), name].to_numpy())

    def __repr__(self) -> str:
        return (
            f"<Campaign {self.name}: {count_text(self.runs, 'run')}, {len(self.failures)} failed>"
        )

    def __str__(self) -> str:
        failures = self.failures
        lines = [
            f"Campaign {self.name}: {count_text(self.runs, 'run')} with seed "
            f"{self.seed}, {len(failures)} failed"
        ]
        if self.found:
            lines.append(f"  {self.found} were done by an earlier call")
        if self.deaths:
            lines.append(f"  {self.deaths} workers died on the way; their runs were done again")
        if self.not_done:
            lines.append(f"  {self.not_done} were not done: the budget of time ended")
        for message, n in Counter(failures.values()).most_common(5):
            run = next(run for run, text in failures.items() if text == message)
            lines.append(f"  failed        {count_text(n, 'time')}, first in run {run}: {message}")
        return "\n".join(lines)


@names_wrong_types()
def campaign(
    function: Function,
    runs: int,
    *,
    seed: int = 0,
    out: str | Path | None = None,
    resume: bool = True,
    settings: Mapping[str, Any] | None = None,
    progress: bool | Callable[[str], None] = False,
    batch: int | None = None,
    stop_on_failure: bool = False,
    retries: int = 3,
) -> Campaign:
    """Call `function` with the seed of every run, on the workers that joblib is configured to use.

    At a time limit around the call no run begins any more, and one that it ends is not done.

    Parameters
    ----------
    function : takes a `numpy.random.SeedSequence` and returns a flat mapping of names to numbers
        and strings. Run i of a campaign has `run_seed(seed, i)`, which depends on nothing else.
        A worker loads the function once and keeps it for all of its batches, caches included:
        define it at the top of a module, and let it read large data itself.
    runs : number of runs. A campaign continued with more runs does the new ones alone.
    out : folder for the results. Each finished batch is written at once; what is there is not done
        again. None keeps everything in memory.
    resume : False begins anew, and deletes the rows of the campaign that `out` holds.
    settings : what else the results depend on, plain values: kept in `campaign.json`, and held
        against it when a campaign is continued. Those of a `functools.partial` or of a dataclass
        are found by themselves.
    progress : True draws a bar with the time left on standard error; a function gets a line now
        and then.
    batch : runs that a worker does in one go; by default as many as take two seconds.
    stop_on_failure : stop at the first run that raises, instead of recording it as failed.
    retries : how often a run may kill its worker, alone, before it is recorded as failed.

    Raises
    ------
    DataError
        Results that are no flat mapping, a folder of another campaign (with what differs), a full
        disk (with what is kept), a function that cannot be sent to workers.
    SolveError
        A failed run with `stop_on_failure`, or no worker that survives.
    KeyboardInterrupt
        On Ctrl-C, saying what is kept.

    Example
    -------
    >>> import casid
    >>> import numpy as np
    >>> def mean_of_noise(seed):
    ...     return {"mean": float(np.random.default_rng(seed).standard_normal(100).mean())}
    >>> casid.campaign(mean_of_noise, 3)
    <Campaign ...mean_of_noise: 3 runs, 0 failed>
    """
    _require_counts(runs, seed, batch, retries)
    folder = _folder(out)
    manifest = manifest_of(function, seed, settings)
    with _locked(folder):
        parts = Parts(folder, manifest, resume=resume)
        todo = _left_to_do(parts, runs)
        found = runs - len(todo)
        with reported(progress, runs, found) as report:
            work = _Work(function, seed, parts, report, batch, stop_on_failure, retries)
            if todo:
                work.do(todo)
        table = parts.end().to_pandas()
    rows = table[table[RUN] < runs]  # a longer campaign in the folder keeps its rows
    return Campaign(manifest["function"], seed, rows, folder, found, work.deaths, runs - len(rows))


def _require_counts(runs: int, seed: int, batch: int | None, retries: int) -> None:
    for name, value in (("runs", runs), ("seed", seed), ("batch", batch), ("retries", retries)):
        is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if not is_whole and not (name == "batch" and value is None):
            raise DataError(f"{name} = {value!r}; give a whole number, for example {name}=10")
    if runs < 1 or seed < 0 or retries < 1 or (batch is not None and batch < 1):
        raise DataError(
            f"runs = {runs}, seed = {seed}, batch = {batch}, retries = {retries}: give at least "
            "one run, batch and retry, and a seed of zero or more"
        )


def _left_to_do(parts: Parts, runs: int) -> list[int]:
    done = parts.runs
    return [run for run in range(runs) if run not in done]


def _folder(out: str | Path | None) -> Path | None:
    folder = None if out is None else Path(out)
    if folder is not None and folder.exists() and not folder.is_dir():
        raise DataError(f"{folder} is a file, not a folder; name a folder")
    return folder


# ---------------------------------------------------------------------- the work


class _Work:
    """The runs that are left to do, handed to workers and taken back."""

    def __init__(
        self,
        function: Function,
        seed: int,
        parts: Parts,
        report: Callable[[int, int], None],
        batch: int | None,
        stop: bool,
        retries: int,
    ) -> None:
        self.function: Function | bytes = function
        self.seed, self.parts, self.report = seed, parts, report
        self.stop, self.retries = stop, retries
        self.fixed = batch is not None
        self.size = batch or 1
        self.handed: dict[int, Sequence[int]] = {}  # first run -> batch that is with a worker
        self.deaths = 0
        self.in_a_row = 0
        self.ends = wall_clock() + seconds_left()  # other threads, too, hand out runs

    def do(self, todo: list[int]) -> None:
        """Do every run of `todo`; what a worker died with is done again, alone."""
        left = iter(todo)
        self._pickle()
        try:
            while True:
                self._round(self._batches(left))
                if not self.handed:
                    return
                # One of the batches that were with a worker killed it: which one shows when each
                # has all workers to itself. The batches not yet handed out are not suspected.
                suspects = [self.handed.pop(first) for first in sorted(self.handed)]
                for runs in suspects:
                    self._alone(runs)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(self._state()) from None

    def _pickle(self) -> None:
        """Pickle the function where workers are other processes.

        Here and not in joblib: its Dask backend waits for ever for what it cannot pickle, and puts
        larger objects on one worker, which may be the one that dies; it leaves bytes alone.
        """
        import joblib
        from joblib.externals.loky.backend.reduction import dumps

        backend, _ = joblib.parallel.get_active_backend()
        if joblib.effective_n_jobs(None) == 1 or getattr(backend, "supports_sharedmem", False):
            return
        try:
            self.function = bytes(dumps(self.function))
        except CasidError:
            raise
        except Exception as error:
            raise DataError(UNLOADABLE.format(f"{type(error).__name__}: {error}")) from error

    def _batches(self, left: Iterator[int]) -> Iterator[Sequence[int]]:
        while runs := list(itertools.islice(left, self.size)):
            yield runs

    def _alone(self, runs: Sequence[int]) -> None:
        """Do one suspected batch with nothing beside it, halved until the culprit is alone."""
        left = [runs]
        died: Counter[int] = Counter()
        while left:
            runs = left.pop()
            self._round([runs])
            if not self.handed:
                continue
            self.handed.clear()
            if len(runs) > 1:
                middle = len(runs) // 2
                left += [runs[middle:], runs[:middle]]
                continue
            died[runs[0]] += 1
            if died[runs[0]] < self.retries:
                left.append(runs)
            else:
                message = (
                    f"its worker died {count_text(died[runs[0]], 'time')} (killed from outside, "
                    "out of memory, or a crash in compiled code)"
                )
                self._keep(Done([{RUN: runs[0], FAILED: message}], 0.0))

    def _round(self, batches: Iterable[Sequence[int]]) -> None:
        """Hand out batches until none is left or a worker dies; `handed` records what it took."""
        import joblib

        def tasks() -> Iterator[Any]:
            """The batches as tasks, while time is left."""
            for runs in batches:
                left = self.ends - wall_clock()
                if left <= 0.0:
                    return
                self.handed[runs[0]] = runs
                yield joblib.delayed(run_batch)(self.function, self.seed, runs, self.stop, left)

        results = None
        try:
            with outliving_workers():
                pool = joblib.Parallel(return_as="generator_unordered", batch_size=1)
                results = pool(tasks())
                for done in results:
                    self._keep(done)
        except CasidError:
            raise
        except Exception as error:
            if not _is_death(error):
                self._explain(error)
                raise
            self.deaths += 1
            self.in_a_row += 1
            if self.in_a_row >= _DEATHS:
                raise SolveError(
                    f"{self.in_a_row} workers died one after another and no run finished: "
                    f"{self._state()}. Try one run without joblib: "
                    f"function(run_seed({self.seed}, {min(self.handed, default=0)}))"
                ) from error
        finally:
            if results is not None:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # joblib's, that tasks were cancelled
                    results.close()

    def _keep(self, done: Done) -> None:
        if done.rows:
            # Kept before it counts as done: if writing fails, the next call does it again.
            self.parts.add(done.rows)
        if done.fault:
            raise DataError(f"{done.fault}. {self._state()}")
        failed = [row for row in done.rows if FAILED in row]
        if failed and self.stop:
            raise SolveError(
                f"run {failed[0][RUN]} failed: {failed[0][FAILED]}. Repeat it with "
                f"function(run_seed({self.seed}, {failed[0][RUN]})), or go on over failed runs "
                f"with stop_on_failure=False; {self._state()}"
            )
        self.handed.pop(done.rows[0][RUN] if done.rows else done.first, None)
        self.in_a_row = 0
        if done.rows:
            self.report(len(done.rows), len(failed))
        if not self.fixed and done.seconds > 0:
            fitting = int(_SECONDS * len(done.rows) / done.seconds)
            self.size = max(1, min(fitting, 2 * self.size, _LARGEST))

    def _state(self) -> str:
        n, folder = len(self.parts.runs), self.parts.folder
        if folder is None:
            return f"{count_text(n, 'run')} done {are(n)} lost; give a folder to keep them"
        return f"{count_text(n, 'run')} {are(n)} kept in {folder}; the same call again continues"

    def _explain(self, error: Exception) -> None:
        """Raise what joblib means by an error that is no worker's death, where that is known."""
        if "un-serialize" in str(error):  # casid itself, which no worker can import
            raise DataError(UNLOADABLE.format(error)) from error
        if isinstance(error, ValueError) and "return_as" in str(error):
            raise DataError(
                f"{error}; choose loky, threading or dask in joblib.parallel_config"
            ) from error
        names = {kind.__name__ for kind in type(error).__mro__}
        if "NoWorkersError" in names:
            raise SolveError(f"{error}; {self._state()}") from error
        if names & {"CancelledError", "FutureCancelledError", "CommClosedError"}:
            raise SolveError(
                f"the Dask scheduler does not answer any more: start another; {self._state()}"
            ) from error
        error.add_note(self._state())


def _is_death(error: Exception) -> bool:
    """True if a worker died with its runs, as joblib's processes and as Dask's say it."""
    if "un-serialize" in str(error):
        return False
    names = {kind.__name__ for kind in type(error).__mro__}
    return bool(names & {"TerminatedWorkerError", "BrokenProcessPool", "KilledWorker"})


@contextlib.contextmanager
def _locked(folder: Path | None) -> Iterator[None]:
    """Refuse two campaigns at once in one folder; the lock ends with its process.

    Where the system or the file system has no locks, both run, and write the same rows twice.
    """
    if folder is None:
        yield
        return
    try:
        import fcntl
        import os

        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield
        return
    try:
        # A file system without locks, as some network folders are, keeps no second campaign out.
        with contextlib.suppress(OSError):
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise DataError(
                    f"{folder}: a campaign is running there; wait for it, or name another folder"
                ) from None
        yield
    finally:
        os.close(handle)
