"""Settings of the whole test run."""

from __future__ import annotations

import gc
import os
import signal
from collections import Counter

import pytest
from hypothesis import settings

# Threads of a linear-algebra library fight over small matrices; set before NumPy is imported.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# What is found may not depend on the machine: a slow or busy one has as many seconds as it needs.
os.environ.setdefault("CASID_TIME_FACTOR", "50")

# A background job of a shell ignores Ctrl-C, and so does what it starts: tests of interrupts
# would wait for commands that never end.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples in every run, and no clock: a slow machine is no counterexample.
settings.register_profile("casid", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("casid")

# What collecting thousands of tests makes is kept to the end: going through it again and again in
# search of garbage takes a quarter of that time, and some of the tests'.
gc.disable()


def pytest_collection_finish() -> None:
    """From here on garbage is looked for among what the tests make."""
    gc.collect()
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests first: several processes then end with quick ones, at one time."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])  # in files, and among others, as they were
