"""joblib's Dask backend, made to live with workers that die."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator, Mapping
from typing import Any

PATIENCE = 60.0
"""How long a cluster may be without any worker [s]."""


class NoWorkersError(Exception):
    """The cluster has no worker any more."""


@contextlib.contextmanager
def outliving_workers() -> Iterator[None]:
    """Inside, joblib's Dask backend reports tasks that died; other backends are left alone.

    By itself it calls back for results (those of raising tasks included) and not for a task that
    Dask gave up because its workers died, nor for one that no worker is left to do: `Parallel`
    would wait for ever. And while a single worker is left, joblib would do the work in this
    process, for the culprit to kill. Here work waits for workers that come back, for `PATIENCE`.
    """
    import joblib

    given, _ = joblib.parallel.get_active_backend()
    if type(given).__name__ != "DaskDistributedBackend" or not hasattr(given, "submit"):
        yield
        return
    # A backend of its own: tasks of a round that broke are forgotten with it.
    backend = type(given)(client=given.client, **given.submit_kwargs)
    submit, client = backend.submit, given.client
    pending: dict[Any, Any] = {}  # future -> whom to call

    def reporting(task: Any, callback: Any = None) -> Any:
        """Submit a task, and report to its callback an error that Dask has of it."""
        future = submit(task, callback)
        pending[future] = callback

        def report(done: Any) -> None:
            """Hand the error of a task that failed to its callback."""
            pending.pop(done, None)
            error = done.exception()
            if error is not None and callback is not None:
                callback(error)

        future.add_done_callback(report)
        return future

    backend.submit = reporting
    backend.effective_n_jobs = lambda n_jobs: max(2, sum(client.ncores().values()))
    ended = threading.Event()
    watcher = threading.Thread(
        target=_watch, args=(client, pending, ended), name="casid-workers", daemon=True
    )
    watcher.start()
    try:
        with joblib.parallel_config(backend=backend):
            yield
    finally:
        ended.set()


def _watch(client: Any, pending: Mapping[Any, Any], ended: threading.Event) -> None:
    """Fail all pending tasks once the cluster has had no worker for `PATIENCE`, until `ended`."""
    seen = time.monotonic()
    while not ended.wait(min(2.0, PATIENCE / 4)):
        with contextlib.suppress(Exception):  # a scheduler that does not answer has none
            if sum(client.ncores().values()):
                seen = time.monotonic()
        if time.monotonic() - seen > PATIENCE:
            error = NoWorkersError(
                f"the Dask cluster has had no worker for {PATIENCE:g} s; start workers"
            )
            for callback in list(pending.values()):
                if callback is not None:
                    callback(error)
            return
