"""Campaigns: the same results on any workers, in any order, after any interruption."""

from __future__ import annotations

import contextlib
import errno
import functools
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest

from casid.campaigns import dask_backend
from casid.campaigns import parquet_parts as parts
from casid.campaigns.campaign import campaign, run_seed
from casid.errors import DataError, SolveError
from tests.support.shared import ROOT


def draw(seed: np.random.SeedSequence) -> dict[str, Any]:
    """Two numbers and a string; every seventh run has an integer and a further result."""
    rng = np.random.default_rng(seed)
    run = int(seed.spawn_key[0])
    row: dict[str, Any] = {"x": rng.standard_normal(), "word": "abc"[run % 3]}
    if run % 7 == 3:
        row |= {"x": run, "rare": np.float64(rng.random()), "flag": np.bool_(run % 2)}
    return row


def noisy(seed: np.random.SeedSequence, scale: float = 1.0) -> dict[str, float]:
    return {"x": scale * np.random.default_rng(seed).standard_normal()}


def faulty(seed: np.random.SeedSequence) -> dict[str, float]:
    if seed.spawn_key[0] % 5 == 2:
        raise ZeroDivisionError("no such run")
    return noisy(seed)


@dataclass(frozen=True)
class Deadly:
    """Kills its worker in one run: `times` times, counted by files in `folder`."""

    folder: str
    run: int
    times: int
    pause: float = 0.0

    def __call__(self, seed: np.random.SeedSequence) -> dict[str, float]:
        time.sleep(self.pause)
        if seed.spawn_key[0] == self.run:
            before = len(os.listdir(self.folder))
            if before < self.times:
                Path(self.folder, str(before)).touch()
                os._exit(3)
        return noisy(seed)


def same(a: Any, b: Any) -> bool:
    return bool(a.table.equals(b.table))  # bit for bit, missing values and types included


# ---------------------------------------------------------------------- seeds and results


def test_a_run_has_its_own_seed_whatever_the_number_of_runs() -> None:
    """SeedSequence.spawn appends the child's number to the spawn key: the number alone decides."""
    for n in (3, 50):
        spawned = np.random.SeedSequence(9).spawn(n)
        for run in (0, 2):
            a, b = (np.random.default_rng(s).random(4) for s in (spawned[run], run_seed(9, run)))
            np.testing.assert_array_equal(a, b)


@pytest.fixture(scope="module")
def serial() -> Any:
    return campaign(draw, 40, seed=5)


@pytest.mark.parametrize("batch", [1, 7, 40, None])
@pytest.mark.parametrize("backend", ["sequential", "threading"])
def test_results_do_not_depend_on_the_division_of_the_work(
    serial: Any, backend: str, batch: int | None, tmp_path: Path
) -> None:
    with joblib.parallel_config(backend=backend, n_jobs=1 if backend == "sequential" else 3):
        other = campaign(draw, 40, seed=5, batch=batch, out=tmp_path / "out")
    assert same(serial, other)
    assert list(other.table["run"]) == list(range(40))
    assert not same(serial, campaign(draw, 40, seed=6))


def test_results_do_not_depend_on_the_process_they_come_from(serial: Any) -> None:
    with joblib.parallel_config(backend="loky", n_jobs=2):
        assert same(serial, campaign(draw, 40, seed=5, batch=3))


def test_a_table_has_one_column_a_result_and_nothing_where_a_run_has_none(serial: Any) -> None:
    assert list(serial.table.columns) == ["run", "x", "word", "rare", "flag", "failed"]
    assert serial.table["x"].dtype == float  # integers in some runs, fractions in others
    assert serial.table["rare"].notna().sum() == 6
    assert serial.column("x").shape == (40,)
    assert serial.failures == {}
    with pytest.raises(KeyError, match="no result 'y'; there are x, word, rare, flag"):
        serial.column("y")


@pytest.mark.parametrize(
    ("result", "words"),
    [
        ([1.0], "returned list, not a mapping.*return for example"),
        ({"x": np.zeros(3)}, "x = array.*give each entry of an array a name"),
        ({"x": {"y": 1}}, "neither a number of 64 bits nor a string"),
        ({"run": 1}, "named 'run'; use a string other than"),
        ({3: 1}, "named 3; use a string"),
        ({"x": 2**70}, "64 bits"),
    ],
)
def test_results_that_fit_no_table_are_refused(result: Any, words: str) -> None:
    with pytest.raises(DataError, match=words):
        campaign(lambda seed: result, 2)


def test_a_result_is_a_number_or_a_string_not_both() -> None:
    with pytest.raises(DataError, match="'x' is a number in some runs.*different names"):
        campaign(lambda seed: {"x": 1.0 if seed.spawn_key[0] else "one"}, 2, batch=1)


@pytest.mark.parametrize("wrong", [{"runs": 0}, {"seed": -1}, {"batch": 0}, {"retries": 0}])
def test_numbers_that_mean_no_campaign_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(DataError, match="give at least"):
        campaign(draw, **{"runs": 3, **wrong})


# ---------------------------------------------------------------------- runs that fail


def test_a_run_that_raises_is_recorded_and_the_others_go_on(tmp_path: Path) -> None:
    result = campaign(faulty, 20, out=tmp_path)
    assert result.failures == dict.fromkeys([2, 7, 12, 17], "ZeroDivisionError: no such run")
    assert result.column("x").size == 16
    assert "20 runs with seed 0, 4 failed" in str(result)
    assert "4 times, first in run 2: ZeroDivisionError" in str(result)
    # Failed once, failed for ever: its seed is the same.
    assert campaign(faulty, 20, out=tmp_path).failures == result.failures


def test_a_campaign_can_stop_at_the_first_failed_run(tmp_path: Path) -> None:
    with pytest.raises(SolveError, match=r"run 2 failed.*run_seed\(0, 2\).*3 runs are kept"):
        campaign(faulty, 20, out=tmp_path, batch=10, stop_on_failure=True)


def test_a_run_that_ends_the_program_fails_alone() -> None:
    def leaves(seed: Any) -> dict[str, float]:
        if seed.spawn_key[0] == 1:
            sys.exit("enough")
        return {"x": 1.0}

    assert campaign(leaves, 3).failures == {1: "SystemExit: enough"}


# ---------------------------------------------------------------------- stopping and continuing


class Stop(BaseException):
    """Stands for what ends a process."""


def stopped_after(batches: int) -> Any:
    """A `_write` that ends the process behind so many parts."""
    write, left = parts._write, [batches + 1]  # the manifest is one

    def written(path: Path, content: bytes) -> None:
        if not left[0]:
            raise Stop
        write(path, content)
        left[0] -= 1

    return written


@pytest.mark.parametrize("batches", [0, 1, 5, 14])
def test_a_continued_campaign_is_the_uninterrupted_one_bit_for_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, batches: int
) -> None:
    whole = campaign(draw, 40, seed=5, out=tmp_path / "whole", batch=40)
    with monkeypatch.context() as patch:
        patch.setattr(parts, "_write", stopped_after(batches))
        with pytest.raises(Stop):
            campaign(draw, 40, seed=5, out=tmp_path / "cut", batch=3)
    there = sum(parts._read(p).num_rows for p in (tmp_path / "cut/parts").glob("*.parquet"))
    assert there == min(3 * batches, 40)
    again = campaign(draw, 40, seed=5, out=tmp_path / "cut", batch=4)
    assert again.found == there
    assert same(whole, again)
    files = [sorted(p.name for p in (tmp_path / n).iterdir()) for n in ("whole", "cut")]
    assert files == [["campaign.json", "results.parquet"]] * 2
    for name in files[0]:
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "cut" / name).read_bytes()


def test_a_finished_campaign_is_read_and_a_longer_one_does_the_new_runs_alone(
    tmp_path: Path,
) -> None:
    calls = []

    def counted(seed: Any) -> dict[str, float]:
        calls.append(seed.spawn_key[0])
        return noisy(seed)

    first = campaign(counted, 10, out=tmp_path)
    assert same(first, campaign(counted, 10, out=tmp_path))
    assert calls == list(range(10))
    longer = campaign(counted, 15, out=tmp_path)
    assert calls == list(range(15))
    assert longer.found == 10
    assert same(first, campaign(counted, 10, out=tmp_path))  # the folder keeps all fifteen
    assert same(longer, campaign(counted, 15, out=tmp_path))
    assert same(longer, campaign(counted, 15))
    assert campaign(counted, 10, out=tmp_path, resume=False).found == 0


def test_a_folder_of_another_campaign_is_refused_with_what_differs(tmp_path: Path) -> None:
    run = functools.partial(noisy, scale=2.0)
    campaign(run, 3, out=tmp_path, settings={"T": 1.0, "at": Path("a")})
    other: dict[str, dict[str, Any]] = {
        "seed is 0 there and 1 now": {"seed": 1},
        "settings T is 1.0 there and 2.0 now": {"settings": {"T": 2.0, "at": "a"}},
        "settings T is 1.0 there and not given now": {"settings": {"at": "a"}},
        f"function is {__name__}.noisy there and {__name__}.draw now": {"function": draw},
        "settings scale is 2.0 there and 3.0 now": {
            "function": functools.partial(noisy, scale=3.0)
        },
    }
    for words, change in other.items():
        call = {"function": run, "settings": {"T": 1.0, "at": "a"}, **change}
        with pytest.raises(DataError, match=words) as refusal:
            campaign(runs=3, out=tmp_path, **call)
        assert "Name another folder" in str(refusal.value)
    manifest = json.loads((tmp_path / "campaign.json").read_text())
    manifest["versions"]["numpy"] = "0.1"
    (tmp_path / "campaign.json").write_text(json.dumps(manifest))
    with pytest.raises(DataError, match=r"versions numpy is 0\.1 there"):
        campaign(run, 3, out=tmp_path, settings={"T": 1.0, "at": "a"})


def test_folders_that_are_none_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(DataError, match="is a file, not a folder; name a folder"):
        campaign(noisy, 3, out=tmp_path / "file")
    (tmp_path / "results.parquet").touch()
    with pytest.raises(DataError, match=r"no campaign\.json.*name another folder"):
        campaign(noisy, 3, out=tmp_path)
    with pytest.raises(DataError, match="setting 'f' is function; give numbers"):
        campaign(noisy, 3, settings={"f": noisy})


def test_a_part_that_cannot_be_read_is_named_with_the_mend(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parts, "_write", stopped_after(2))
    with pytest.raises(Stop):
        campaign(noisy, 9, out=tmp_path, batch=3)
    monkeypatch.undo()
    part = tmp_path / "parts/000000003.parquet"
    part.write_bytes(part.read_bytes()[:40])
    with pytest.raises(DataError, match=r"000000003\.parquet cannot be read.*delete it"):
        campaign(noisy, 9, out=tmp_path)
    part.unlink()
    assert campaign(noisy, 9, out=tmp_path).found == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_disk_says_what_is_kept_and_how_to_continue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, left = tempfile.mkstemp, [3]  # the manifest and two parts

    def opened(**where: Any) -> tuple[int, str]:
        handle, name = make(**where)
        if not left[0]:
            os.dup2(os.open("/dev/full", os.O_WRONLY), handle)
        left[0] = max(0, left[0] - 1)
        return handle, name

    with monkeypatch.context() as patch:
        patch.setattr(tempfile, "mkstemp", opened)
        with pytest.raises(DataError, match="the disk is full; 6 runs are kept") as refusal:
            campaign(noisy, 12, out=tmp_path, batch=3)
    assert "make room and repeat the same call" in str(refusal.value)
    assert isinstance(refusal.value.__cause__, OSError)
    assert refusal.value.__cause__.errno == errno.ENOSPC
    assert not list((tmp_path / "parts").glob(".*"))
    again = campaign(noisy, 12, out=tmp_path)
    assert again.found == 6
    assert same(again, campaign(noisy, 12))


def test_a_disk_that_fills_at_the_end_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = parts._write

    def full(path: Path, content: bytes) -> None:
        if path.name == "results.parquet":
            raise OSError(errno.ENOSPC, "No space left on device")
        write(path, content)

    with monkeypatch.context() as patch:
        patch.setattr(parts, "_write", full)
        with pytest.raises(DataError, match="all 12 runs are kept there in parts"):
            campaign(noisy, 12, out=tmp_path)
    assert campaign(noisy, 12, out=tmp_path).found == 12


def test_two_campaigns_in_one_folder_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")

    def inside(seed: Any) -> dict[str, float]:
        campaign(noisy, 2, out=tmp_path)
        return {"x": 1.0}

    result = campaign(inside, 1, out=tmp_path)
    assert "a campaign is running there; wait for it" in result.failures[0]


PROGRAM = """
import sys, time
import joblib
import numpy as np
from casid.campaigns.campaign import campaign

def slow(seed):
    time.sleep(0.05)
    return {"x": float(np.random.default_rng(seed).standard_normal())}

if __name__ == "__main__":
    with joblib.parallel_config(n_jobs=int(sys.argv[1])):
        print(campaign(slow, 400, out="out", batch=2, progress=True))
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("jobs", "sign"),
    [(1, "SIGINT"), pytest.param(2, "SIGINT", marks=pytest.mark.slow), (2, "SIGKILL")],
)
def test_what_was_finished_when_a_process_is_stopped_is_kept(
    tmp_path: Path, jobs: int, sign: str
) -> None:
    (tmp_path / "program.py").write_text(PROGRAM)
    there = tmp_path / "out" / "parts"
    with (tmp_path / "stderr").open("w") as stderr:
        running = subprocess.Popen(
            [sys.executable, "program.py", str(jobs)],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            start_new_session=True,
        )
    try:
        while running.poll() is None and len(list(there.glob("*.parquet"))) < 3:
            time.sleep(0.02)
        running.send_signal(signal.Signals[sign])
        running.wait(timeout=600)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)  # its workers would wait for work for minutes
    kept = sum(parts._read(p).num_rows for p in there.glob("*.parquet"))
    assert 6 <= kept < 400
    if sign == "SIGINT":
        said = re.search(
            r"KeyboardInterrupt: (\d+) runs are kept in out; the same call again",
            (tmp_path / "stderr").read_text(),
        )
        assert said
        # Each of two workers may still write its part, of two runs, after the count is said.
        assert kept - (4 if jobs == 2 else 0) <= int(said[1]) <= kept


def test_an_interrupt_that_a_solver_swallows_ends_the_campaign_all_the_same(tmp_path: Path) -> None:
    """CasADi's solvers end with an error of their own at Ctrl-C: that run has not failed."""

    def solver(seed: Any) -> dict[str, float]:
        if seed.spawn_key[0] == 4:
            try:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1)
            except KeyboardInterrupt:
                raise RuntimeError("stopped by the user") from None
        return noisy(seed)

    with pytest.raises(KeyboardInterrupt, match="4 runs are kept"):
        campaign(solver, 9, out=tmp_path, batch=2)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


# ---------------------------------------------------------------------- workers that die


def test_a_worker_that_dies_once_costs_nothing(tmp_path: Path) -> None:
    (tmp_path / "deaths").mkdir()
    run = Deadly(str(tmp_path / "deaths"), run=9, times=1)
    with joblib.parallel_config(n_jobs=2):
        result = campaign(run, 20, out=tmp_path / "out", batch=4)
    assert result.deaths == 1
    assert same(result, campaign(noisy, 20))


@pytest.mark.slow
def test_a_run_that_always_kills_its_worker_is_found_and_the_others_are_done(
    tmp_path: Path,
) -> None:
    (tmp_path / "deaths").mkdir()
    run = Deadly(str(tmp_path / "deaths"), run=9, times=99)
    with joblib.parallel_config(n_jobs=2):
        result = campaign(run, 20, batch=4, retries=2)
    assert list(result.failures) == [9]
    assert "its worker died 2 times" in result.failures[9]
    expected = campaign(noisy, 20).table
    assert result.table["x"].drop(index=9).equals(expected["x"].drop(index=9))


@pytest.mark.slow
def test_the_same_call_runs_on_a_dask_cluster_and_survives_a_killed_worker(tmp_path: Path) -> None:
    """Dask gives the dead worker's tasks to another; the seeds are the runs', not the workers'."""
    distributed = pytest.importorskip("distributed")
    (tmp_path / "deaths").mkdir()
    run = Deadly(str(tmp_path / "deaths"), run=25, times=1, pause=0.01)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config(backend="dask"),
    ):
        result = campaign(run, 60, out=tmp_path / "out", batch=3)
    assert len(os.listdir(tmp_path / "deaths")) == 1  # one was killed in the middle
    assert result.failures == {}
    assert same(result, campaign(noisy, 60))


class Leaving:
    """Takes the last worker away in one run, as an operator would."""

    def __call__(self, seed: np.random.SeedSequence) -> dict[str, float]:
        if seed.spawn_key[0] == 7:
            import distributed

            worker = distributed.get_worker()
            worker.loop.add_callback(worker.close, nanny=True)
            time.sleep(60)
        return noisy(seed)


@pytest.mark.slow
def test_a_cluster_that_loses_its_last_worker_ends_the_campaign_resumably(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(dask_backend, "PATIENCE", 1.0)
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config(backend="dask"),
    ):
        with pytest.raises(SolveError, match="no worker for 1 s; start workers; [1-7] runs are"):
            campaign(Leaving(), 12, out=tmp_path / "out", batch=1)


@dataclass
class Unloadable:
    """Can be pickled, and not be loaded."""

    def __call__(self, seed: np.random.SeedSequence) -> dict[str, float]:
        return {}

    def __reduce__(self) -> Any:
        return int, ("no number",)


def test_a_function_that_no_worker_can_have_is_refused() -> None:
    lock = functools.partial(noisy, scale=threading.Lock())  # type: ignore[arg-type]
    for function, why in ((lock, "cannot pickle"), (Unloadable(), "no number")):
        with joblib.parallel_config(n_jobs=2), pytest.raises(DataError, match=why) as refusal:
            campaign(function, 4)
        assert "top of a module" in str(refusal.value)
    assert campaign(Unloadable(), 4).runs == 4  # one process needs no pickle


@dataclass
class Counting:
    """Counts its own calls."""

    n: int = 0

    def __call__(self, seed: np.random.SeedSequence) -> dict[str, int]:
        self.n += 1
        return {"call": self.n}


def test_a_worker_keeps_the_function_and_what_it_has_built() -> None:
    """Two workers, ten batches: had each batch a copy of its own, no count would pass two."""
    with joblib.parallel_config(n_jobs=2):
        result = campaign(Counting(), 20, batch=2)
    assert result.column("call").max() >= 10


# ---------------------------------------------------------------------- how far it is


def test_lines_tell_how_far_it_is(tmp_path: Path) -> None:
    lines: list[str] = []
    campaign(faulty, 5, out=tmp_path, progress=lines.append)
    assert lines == ["5 of 5 runs, 1 failed"]
    campaign(faulty, 8, out=tmp_path, progress=lines.append)
    assert lines[1:] == ["5 of 8 runs were done before", "8 of 8 runs, 1 failed"]


def test_a_bar_stands_on_a_terminal(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    campaign(faulty, 5, progress=True)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "5/5" in captured.err
    assert "1 failed" in captured.err
