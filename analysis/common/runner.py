"""The one runner of the studies: arguments, tables and figures, targets, exit status."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

from analysis.common.output import Output
from analysis.common.targets import Target, report

QUICK = "fewer and shorter runs"
OUT = "folder for tables, figures and targets.json"


class AbsentError(Exception):
    """A folder of shared data that a study needs does not exist."""


def shared_folder(path: str) -> Path:
    """A folder of the shared data.

    Raises
    ------
    AbsentError
        If it does not exist: the study then ends with status 2.
    """
    root = Path(os.environ.get("CASID_SHARED", Path(__file__).resolve().parents[3] / "shared"))
    folder = root / path
    if not folder.is_dir():
        raise AbsentError(f"{folder} is absent; set CASID_SHARED to the folder of shared data")
    return folder


@dataclass(frozen=True, slots=True)
class Run:
    """One call of a study: its options, and where its tables and figures go."""

    options: Any  # argparse.Namespace: `quick`, `out` and the study's own
    output: Output

    @property
    def quick(self) -> bool:
        return bool(self.options.quick)

    @property
    def folder(self) -> Path | None:
        return self.output.folder

    def runs(self, full: int, quick: int) -> int:
        """The number of `--runs`, by default that of a full or of a quick study."""
        return int(self.options.runs or (quick if self.quick else full))


@dataclass(frozen=True, slots=True)
class Study:
    """What `python -m analysis.<name>` computes and shows.

    `found` makes the targets, one by one as they are computed, with headings (strings) between
    them; its module describes the study. It writes its tables and figures to the output of the run,
    which is empty without `--out`.
    """

    found: Callable[[Run], Iterable[Target | str]]
    quick: str = QUICK  # help of --quick
    out: str = OUT  # help of --out
    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # flag -> add_argument
    file: str = "targets.json"

    @property
    def name(self) -> str:
        """That of the folder."""
        return self.found.__module__.split(".")[1]

    def run(self) -> NoReturn:
        """End the process with the status of the study."""
        sys.exit(self.main())

    def main(self, arguments: list[str] | None = None) -> int:
        """Print each number beside its target; 1 if one is missed, 2 if shared data are absent."""
        parser = argparse.ArgumentParser(
            prog=f"python -m analysis.{self.name}",
            description=sys.modules[self.found.__module__].__doc__,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        parser.add_argument("--quick", action="store_true", help=self.quick)
        parser.add_argument("--out", type=Path, help=self.out)
        for flag, how in self.options.items():
            parser.add_argument(flag, **how)
        options = parser.parse_args(arguments)
        folder: Path | None = options.out
        try:
            found = self.found(Run(options, Output(folder)))
            return report(found, None if folder is None else folder / self.file)
        except AbsentError as error:
            print(error, file=sys.stderr)
            return 2


def runs(full: int, quick: int) -> dict[str, dict[str, Any]]:
    """The option `--runs` of a Monte Carlo study."""
    text = f"Monte Carlo runs (default {full}, quick {quick})"
    return {"--runs": {"type": int, "help": text}}


def jobs(default: int) -> dict[str, dict[str, Any]]:
    """The option `--jobs`."""
    return {"--jobs": {"type": int, "default": default, "help": f"processes (default {default})"}}


def sections(
    table: Mapping[str, Callable[..., Iterable[Target]]], *arguments: Any
) -> Iterator[Target | str]:
    """The targets of each section of a study below its title."""
    for title, section in table.items():
        yield title
        yield from section(*arguments)
