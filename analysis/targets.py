"""A number of a study beside its target."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Target:
    """What was found, what was wanted, and whether that is met."""

    what: str
    found: str
    wanted: str
    is_met: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "is_met", bool(self.is_met))  # JSON knows no numpy

    def __str__(self) -> str:
        return (
            f"{'ok  ' if self.is_met else 'MISS'} {self.what:<58}{self.found:>34}   {self.wanted}"
        )


def shared_folder(path: str) -> Path | None:
    """A folder of the shared data, or None with a message where it is absent."""
    root = Path(os.environ.get("CASID_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    folder = root / path
    if not folder.is_dir():
        print(f"{folder} is absent; set CASID_SHARED to the folder of shared data", file=sys.stderr)
        return None
    return folder


def at_most(what: str, found: float, limit: float, unit: str) -> Target:
    """A number that must not exceed a limit."""
    return Target(what, f"{found:.4g} {unit}", f"<= {limit:g} {unit}", found <= limit)


def near(what: str, found: float, wanted: float, relative: float, unit: str) -> Target:
    """A number within a relative distance of another."""
    met = abs(found - wanted) <= relative * abs(wanted)
    return Target(what, f"{found:.5g} {unit}", f"{wanted:g} {unit} +- {100 * relative:g} %", met)


def conclude(targets: Sequence[Target], file: Path | None) -> int:
    """Write the targets where a file is named; 0 if all are met, else 1."""
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps([asdict(t) for t in targets], indent=1) + "\n", encoding="utf-8")
    missed = sum(not t.is_met for t in targets)
    print(f"{len(targets) - missed} of {len(targets)} targets met")
    return 1 if missed else 0


def report(found: Iterable[Target], folder: Path | None) -> int:
    """Print every target as it comes, and conclude with targets.json in the folder.

    The folder is made before the first of `found` is asked for: a study may write into it.
    """
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    targets = []
    for target in found:
        print(target, flush=True)
        targets.append(target)
    return conclude(targets, None if folder is None else folder / "targets.json")
