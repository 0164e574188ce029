"""Kill -9 of the main process, of a worker and of the scheduler: the same table, bit for bit."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from casid.cli.main import main
from tests.support.dask_cluster import WAIT, Cluster, killed
from tests.support.fleet_records import write_fleet, write_problem
from tests.support.shared import ROOT

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

ASSETS, RECORDS = 2, 4
TABLES = ("causes.parquet", "parameters.parquet")


@pytest.fixture(scope="module")
def heaters(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("heaters")
    write_problem(folder)
    write_fleet(folder, ASSETS, RECORDS)
    return folder


def command(folder: Path, out: Path, *options: str) -> list[str]:
    """`casid fleet` of the heaters."""
    files = (str(folder / "heater.py"), str(folder / "records"))
    return ["fleet", *files, "--asset", "{asset}_{time}.csv", "--out", str(out), *options]


@pytest.fixture(scope="module")
def undisturbed(heaters: Path) -> list[object]:
    done(command(heaters, heaters / "out", "--jobs", "1", "--quiet"))
    return contents(heaters / "out")


def done(arguments: list[str]) -> None:
    """A command to its end, in this process."""
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code in (0, None)


def contents(out: Path) -> list[object]:
    """The tables bit for bit, and the findings without how many records the last call has done."""
    found: list[object] = [(out / name).read_bytes() for name in TABLES]
    content = json.loads((out / "fleet.json").read_text())
    return [*found, {k: v for k, v in content.items() if k != "new"}]


def started(arguments: list[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", "from casid.cli.main import main; main()", *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )


def wait_for(process: subprocess.Popen[bytes], out: Path, parts: int) -> bool:
    """Wait until so many batches of records are kept; False where the process has ended before."""
    ends = time.monotonic() + WAIT
    while process.poll() is None and time.monotonic() < ends:
        if (out / "records.json").exists() and len(list(out.glob("records/parts/*"))) >= parts:
            return True
        time.sleep(0.005)
    return False


@pytest.mark.slow
def test_the_main_process_is_killed_at_random_moments(
    heaters: Path, undisturbed: list[object], tmp_path: Path
) -> None:
    rng, out = np.random.default_rng(7), tmp_path / "out"
    for _ in range(2):
        there = len(list(out.glob("records/parts/*")))
        running = started(command(heaters, out, "--jobs", "2"))
        wait_for(running, out, there + int(rng.integers(0, 3)))
        time.sleep(float(rng.uniform(0.0, 0.3)))
        os.kill(running.pid, signal.SIGKILL)  # alone: its workers are left without it
        running.wait()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
    done(command(heaters, out, "--jobs", "1", "--quiet"))
    assert contents(out) == undisturbed


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1])
def test_a_worker_of_a_cluster_is_killed_at_a_random_moment(
    heaters: Path, undisturbed: list[object], tmp_path: Path, seed: int
) -> None:
    """Its records are done by the other one; the command goes on."""
    pytest.importorskip("distributed")
    rng, out = np.random.default_rng(seed), tmp_path / "out"
    with Cluster(tmp_path / "cluster") as cluster:
        dask = ("--engine", "dask", "--scheduler", cluster.address)
        running = started(command(heaters, out, *dask, "--quiet"))
        wait_for(running, out, int(rng.integers(0, 5)))
        killed(cluster.workers[int(rng.integers(2))])
        assert running.wait(WAIT) == 0, running.communicate()[1]
    assert contents(out) == undisturbed


@pytest.mark.slow
def test_the_scheduler_is_killed_and_another_cluster_goes_on(
    heaters: Path, undisturbed: list[object], tmp_path: Path
) -> None:
    pytest.importorskip("distributed")
    out = tmp_path / "out"
    with Cluster(tmp_path / "first") as cluster:
        dask = ("--engine", "dask", "--scheduler", cluster.address)
        running = started(command(heaters, out, *dask, "--quiet"))
        assert wait_for(running, out, 2)
        killed(cluster.scheduler)
        _, said = running.communicate(timeout=WAIT)
    assert running.returncode != 0
    assert "error: the Dask scheduler does not answer any more" in said.decode()
    assert "the same call again continues" in said.decode()
    with Cluster(tmp_path / "second") as cluster:
        dask = ("--engine", "dask", "--scheduler", cluster.address)
        assert started(command(heaters, out, *dask, "--quiet")).wait(WAIT) == 0
    assert contents(out) == undisturbed
