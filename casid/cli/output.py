"""How a command ends: its result in a folder, and as text or JSON on standard output."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from casid.cli.terminal import (
    print_json,
    print_text,
    progress_lines,
    quiet_stdout,
    reserved,
    say,
)
from casid.errors import DataError

if TYPE_CHECKING:
    from casid.data.experiment import Experiment

T = TypeVar("T")
_DIGEST = re.compile(r" \(sha256 \w+\)")


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

    def print_provenance(self, experiments: Iterable[Experiment]) -> None:
        """Write on standard error what was read from the files of these experiments, and how."""
        for experiment in () if self.quiet else experiments:
            steps = experiment.record.provenance
            if steps and steps[0].startswith("read "):
                say("\n  ".join(_DIGEST.sub("", step) for step in steps))

    def keep(self, result: Any, folder: Path, write: Callable[[Path], Any]) -> None:
        """Write the result's page and numbers, and save it for `casid export` and `casid simulate`.

        All of them replace those of an earlier run together, or none does.
        """
        from casid.data.files import staged
        from casid.saving.archive import RESULT_FILE

        with staged(folder) as temporary:
            write(temporary)
            try:
                result.save(temporary / RESULT_FILE)
            except DataError as error:
                if isinstance(error.__cause__, OSError):
                    raise
                say(f"{RESULT_FILE} was not written: {error}")
                (folder / RESULT_FILE).unlink(missing_ok=True)  # that of another run

    def finish(self, result: Any, folder: Path, file: str) -> None:
        """Report where `file` and the page were written, and print the result."""
        if not self.quiet:
            say(f"wrote {folder / 'report.html'} and {folder / file}")
        if self.as_json:
            print_json(result.to_json())
        else:
            print_text(str(result))
