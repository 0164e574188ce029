"""What a command says on the terminal, where it writes, and what it works on."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from casid.errors import DataError

_UNSEEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


def visible(text: str) -> str:
    """Text whose control characters, as names in a file may hold them, are shown and not obeyed."""
    return _UNSEEN.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def say(text: str) -> None:
    """Write to standard error, where there is one."""
    text = visible(text)
    # Not click.echo: it writes UTF-8 to an ASCII stream all the same.
    with contextlib.suppress(OSError):
        if sys.stderr is not None:
            print(text, file=sys.stderr, flush=True)


def print_text(text: str) -> None:
    """Write to standard output."""
    _print(visible(text))


def _print(text: str) -> None:
    """Write to standard output; a reader that has gone away (`| head`) is no error."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        # What is left in the buffer would raise once more when Python closes the stream.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_json(content: Any) -> None:
    """Write a result to standard output as JSON."""
    from casid.data.files import plain

    _print(json.dumps(plain(content), indent=1, allow_nan=False))


@contextlib.contextmanager
def quiet_stdout() -> Iterator[None]:
    """Send what a problem file or a solver prints to standard error: results alone go out."""
    with contextlib.redirect_stdout(sys.stderr):
        yield


@contextlib.contextmanager
def progress_lines(quiet: bool) -> Iterator[Callable[[str], None]]:
    """A moving line where standard error is a terminal, else a line a step."""
    if quiet:
        yield lambda line: None
    elif sys.stderr is not None and sys.stderr.isatty():
        from rich.console import Console

        with Console(stderr=True).status("", spinner="line") as status:
            yield lambda line: status.update(_plain(line))
    else:
        yield lambda line: say(line)


def _plain(line: str) -> Any:
    from rich.text import Text

    return Text(visible(line))  # a record's name in brackets is no markup


def _folder_name(name: str) -> str:
    return re.sub(r"[^\w.-]+", "-", name).strip("-.") or "problem"


@contextlib.contextmanager
def reserved(out: Path | None, name: str, *, force: bool) -> Iterator[Path]:
    """The folder to write to, refused at once or kept only if the work succeeds."""
    from casid.data.files import output_folder

    probe = out if out is not None else Path("reports")
    new = [p for p in (probe, *probe.parents) if not p.exists()]
    folder = output_folder(out, _folder_name(name), force=force)
    if out is None:
        new.insert(0, folder)
    try:
        if not os.access(folder, os.W_OK | os.X_OK):
            raise DataError(f"{folder} cannot be written to; name another folder with --out")
        yield folder
    except BaseException:
        for path in new:
            with contextlib.suppress(OSError):  # holds something after all: not ours to remove
                path.rmdir()
        raise


@contextlib.contextmanager
def study_folder(
    out: Path | None, name: str, manifest: dict[str, Any], *, force: bool
) -> Iterator[Path]:
    """The folder that holds this very study, else a reserved one."""
    from casid.campaigns.manifest import continues, read_manifest

    name = f"{_folder_name(name)}-montecarlo"
    folders = [out] if out is not None else list(Path("reports").glob(f"{name}-*"))
    held = [f for f in folders if read_manifest(f) is not None]
    if out is None:
        held = [f for f in held if continues(f, manifest)]
    if held and not force:
        # One with another study is refused by the campaign, which says what differs.
        yield max(held, key=lambda f: f.stat().st_mtime_ns)
        return
    with reserved(out, name, force=force) as folder:
        yield folder


_JOBS_A_CORE = 4  # more processes than that only wait for each other, and hold memory


@contextlib.contextmanager
def workers(jobs: int | None, dask: str | None) -> Iterator[None]:
    """Run campaigns on so many processes, which end with the command, or on a Dask cluster."""
    import joblib

    if dask is None:
        cores = joblib.cpu_count()
        used = min(jobs or cores, _JOBS_A_CORE * cores)
        if jobs is not None and used < jobs:
            say(f"--jobs {jobs}: {used} processes work, {_JOBS_A_CORE} for every core")
        with joblib.parallel_config(n_jobs=used), _ended_together():
            yield
        return
    if jobs is not None:
        raise DataError("--jobs and --dask contradict each other; the cluster has its own workers")
    try:
        distributed = importlib.import_module("distributed")  # an extra
    except ImportError:
        raise DataError(
            "--dask needs the extra `dask`; install it with: pip install 'casid[dask]'"
        ) from None
    try:
        client = distributed.Client(dask, timeout="10s")
    except (OSError, ValueError) as error:
        raise DataError(
            f"no Dask scheduler answers at {dask} ({error}); start one with `dask scheduler`, or "
            "leave --dask out"
        ) from error
    with client, joblib.parallel_config(backend="dask"):
        yield


@contextlib.contextmanager
def _ended_together() -> Iterator[None]:
    """End the worker processes where the work is ended, by Ctrl-C or by SIGTERM alike."""
    import signal
    import threading

    def interrupt(number: int, frame: Any) -> None:
        raise KeyboardInterrupt

    is_main = threading.current_thread() is threading.main_thread()
    before: Any = signal.signal(signal.SIGTERM, interrupt) if is_main else None
    try:
        yield
    except KeyboardInterrupt:
        executor = importlib.import_module("joblib.externals.loky.reusable_executor")
        if (pool := executor._executor) is not None:
            pool.shutdown(wait=True, kill_workers=True)
        raise
    finally:
        if is_main:
            signal.signal(signal.SIGTERM, before)
