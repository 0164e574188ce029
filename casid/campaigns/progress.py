"""How far a campaign is: a bar where standard error is a terminal, else a line now and then."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def reported(
    progress: bool | Callable[[str], None], runs: int, found: int
) -> Iterator[Callable[[int, int], None]]:
    """How far the campaign is: called with the runs done and failed since the last call."""
    is_terminal = sys.stderr is not None and sys.stderr.isatty()
    if progress is True and is_terminal:
        with _bar(runs, found) as report:
            yield report
        return
    say = progress if callable(progress) else _say if progress else None
    start = last = time.monotonic()
    done = failures = 0

    def line(n: int, failed: int) -> None:
        """Count runs; print a line of progress at most every five seconds."""
        nonlocal done, failures, last
        done, failures = done + n, failures + failed
        now = time.monotonic()
        if say is None or (now - last < 5.0 and found + done < runs):
            return
        last = now
        left = (runs - found - done) * (now - start) / done
        text = f"{found + done} of {runs} runs"
        text += f", {failures} failed" if failures else ""
        say(text + (f", {_duration(left)} left" if found + done < runs else ""))

    if say is not None and found:
        say(f"{found} of {runs} runs were done before")
    yield line


@contextlib.contextmanager
def _bar(runs: int, found: int) -> Iterator[Callable[[int, int], None]]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("in"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    failures = 0
    with Progress(*columns, console=Console(stderr=True), speed_estimate_period=120) as shown:
        task = shown.add_task("runs", total=runs, completed=found)

        def report(n: int, failed: int) -> None:
            """Count runs, and move the bar."""
            nonlocal failures
            failures += failed
            text = f"runs, {failures} failed" if failures else "runs"
            shown.update(task, advance=n, description=text)

        yield report


def _say(line: str) -> None:
    with contextlib.suppress(OSError):
        print(line, file=sys.stderr, flush=True)


def _duration(seconds: float) -> str:
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
