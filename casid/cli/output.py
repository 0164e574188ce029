"""How a command ends: its result in a folder, and as text or JSON on standard output."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from casid.cli.terminal import (
    print_json,
    print_text,
    progress_lines,
    quiet_stdout,
    reserved,
    say,
)

T = TypeVar("T")


def taken(kind: type[T], given: dict[str, Any]) -> T:
    """The dataclass `kind` of a command's options, which are taken out of `given`."""
    names = [f.name for f in fields(kind) if f.init]  # type: ignore[arg-type]
    return kind(**{name: given.pop(name) for name in names if name in given})


class Work(NamedTuple):
    """Where a command writes, and how it reports progress."""

    folder: Path
    progress: Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Output:
    """The options --out, --force, --json and --quiet."""

    out: Path | None
    force: bool
    as_json: bool
    quiet: bool

    @contextlib.contextmanager
    def work(self, name: str) -> Iterator[Work]:
        """Reserve the folder of the problem called `name`; nothing but results is printed inside.

        The folder goes again where the work fails.
        """
        with (
            reserved(self.out, name, force=self.force) as folder,
            quiet_stdout(),
            progress_lines(self.quiet) as progress,
        ):
            yield Work(folder, progress)

    def finish(self, result: Any, folder: Path, file: str) -> None:
        """Report where `file` and the page were written, and print the result."""
        if not self.quiet:
            say(f"wrote {folder / 'report.html'} and {folder / file}")
        if self.as_json:
            print_json(result.to_json())
        else:
            print_text(str(result))
