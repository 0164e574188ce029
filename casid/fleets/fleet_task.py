"""The runs of a fleet's campaigns: the fits that references are made of, and the records."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import threading
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from multiprocessing import current_process
from multiprocessing.util import Finalize
from typing import TYPE_CHECKING, Any

from casid.fleets.fleet_settings import REFUSED, Reference
from casid.fleets.record_list import FleetRecord
from casid.fleets.supervision import StoppedError, Supervised, end_with_parent
from casid.fleets.thresholds import RECORD_BUDGET

if TYPE_CHECKING:
    from numpy.random import SeedSequence


@dataclass(frozen=True, slots=True)
class Budget:
    """What one record may use: seconds, and megabytes beside the libraries."""

    seconds: float = RECORD_BUDGET.seconds
    memory: float = RECORD_BUDGET.memory


@dataclass(frozen=True, slots=True)
class ReferenceTask:
    """Run i fits the record i of those that references are made of.

    Attributes
    ----------
    work : a pickled problem with its settings.
    records : packed by `packed`.
    """

    work: bytes
    records: bytes
    budget: Budget

    def __call__(self, seed: SeedSequence) -> dict[str, Any]:
        """The parameters of one record, or why it has none."""
        record = FleetRecord(**_unpacked(self.records)[int(seed.spawn_key[0])])
        try:
            return _supervised(self.budget, _REFERENCE, self.work, record)
        except StoppedError as error:
            return {"refusal": str(error)}


@dataclass(frozen=True, slots=True)
class RecordTask:
    """Run i is record i of the fleet.

    Attributes
    ----------
    references : asset -> its reference, packed.
    """

    work: bytes
    records: bytes
    references: bytes
    budget: Budget

    def __call__(self, seed: SeedSequence) -> dict[str, Any]:
        """The row of one record."""
        record = FleetRecord(**_unpacked(self.records)[int(seed.spawn_key[0])])
        known = _unpacked(self.references).get(record.asset)
        reference = None if known is None else Reference(known[0], tuple(map(tuple, known[1])))
        try:
            return _supervised(self.budget, _ROW, self.work, record, reference, self.budget.seconds)
        except StoppedError as error:
            return {**REFUSED, "refusal": str(error)}


def packed(content: Any) -> bytes:
    """Plain data in few bytes: every batch of a campaign carries them."""
    return zlib.compress(json.dumps(content).encode())


def packed_records(records: Sequence[FleetRecord]) -> bytes:
    """Records in few bytes."""
    return packed([asdict(r) for r in records])


@lru_cache(maxsize=4)
def _unpacked(content: bytes) -> Any:
    return json.loads(zlib.decompress(content))


_processes = threading.local()


# By their names: the diagnosis is loaded in the process that runs them alone.
_REFERENCE = "casid.fleets.record_work:do_reference"
_ROW = "casid.fleets.record_work:do_row"


def _supervised(budget: Budget, function: str, *arguments: Any) -> dict[str, Any]:
    """The value of a function, given by its name, from this thread's own process."""
    process: Supervised | None = getattr(_processes, "process", None)
    if process is None or (process.seconds, process.memory) != (budget.seconds, budget.memory):
        end_process()
        _end_with_main()
        process = _processes.process = Supervised(budget.seconds, budget.memory)
    try:
        found: dict[str, Any] = process(function, *arguments)
    except Exception:
        raise
    except BaseException:  # Ctrl-C: its answer would come to the next record
        process.end()
        raise
    return found


@lru_cache(maxsize=1)
def _end_with_main() -> None:
    """End a worker of joblib with the main process; called once in a process.

    Not a Dask worker, which may outlive the shell that started it.
    """
    if current_process().name.startswith("LokyProcess"):
        end_with_parent(os.getppid())
        Finalize(None, end_process, exitpriority=0)  # waited for: its time counts as the worker's


def end_process() -> None:
    """End this thread's process, if it has one."""
    process: Supervised | None = getattr(_processes, "process", None)
    if process is not None:
        with contextlib.suppress(OSError):
            process.end()
        _processes.process = None


def pickled_work(problem: Any, settings: Any) -> bytes:
    """Problem and settings for other processes; the same bytes for the same content."""
    return pickle.dumps((problem, settings))
