"""A number of a study beside its target."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import SupportsFloat

from casid.errors import CasidError


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


def at_most(what: str, found: SupportsFloat, limit: float, unit: str = "") -> Target:
    """A number that must not exceed a limit."""
    found = float(found)
    return Target(what, f"{found:.4g} {unit}", f"<= {limit:g} {unit}", found <= limit)


def holds(what: str, found: object, wanted: object, is_met: object) -> Target:
    """Anything beside what is wanted of it."""
    return Target(what, str(found), str(wanted), bool(is_met))


def equal(what: str, found: object, wanted: object) -> Target:
    """Something that must be just this."""
    return holds(what, found, wanted, found == wanted)


def near(what: str, found: float, wanted: float, relative: float, unit: str = "") -> Target:
    """A number within a relative distance of another."""
    met = abs(found - wanted) <= relative * abs(wanted)
    return Target(what, f"{found:.5g} {unit}", f"{wanted:g} {unit} +- {100 * relative:g} %", met)


def completed(found: Iterable[Target | str]) -> Iterator[Target | str]:
    """All of `found`; an error of casid ends it with a missed target instead of a traceback."""
    try:
        yield from found
    except CasidError as error:
        yield Target("the study runs to its end", type(error).__name__, str(error), False)


def report(found: Iterable[Target | str], file: Path | None) -> int:
    """Print each target as it comes and write all to `file`; 1 if one is missed, else 0.

    A string among them is a heading: the targets below it are indented.
    """
    targets, indent = [], ""
    for item in found:
        if isinstance(item, str):
            print(item, flush=True)
            indent = "  "
            continue
        print(f"{indent}{item}", flush=True)
        targets.append(item)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps([asdict(t) for t in targets], indent=1) + "\n", encoding="utf-8")
    missed = sum(not t.is_met for t in targets)
    print(f"{len(targets) - missed} of {len(targets)} targets met")
    return 1 if missed else 0
