"""Prose and fenced blocks of a page in Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from casid.errors import DataError


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block of a page.

    Attributes
    ----------
    line : of its first line of code, from 1.
    needs : a file without which it is shown, and not run.
    """

    language: str
    text: str
    line: int
    needs: str | None = None

    @property
    def runs(self) -> bool:
        """True if it has what it needs."""
        return self.needs is None or Path(self.needs).exists()

    @property
    def shown(self) -> str:
        """The block as a page without code to run has it."""
        return f"```{self.language}\n{self.text}\n```"


def split(text: str) -> Iterator[str | Block]:
    """Prose and fenced blocks of a page, in order.

    Raises
    ------
    DataError
        If a block is not closed.
    """
    prose: list[str] = []
    lines = text.splitlines()
    i = 0
    while i < len(lines):
        opening = re.fullmatch(r"```(\w+)(?: needs (.+))?", lines[i])
        if opening is None:
            prose.append(lines[i])
            i += 1
            continue
        yield "\n".join(prose)
        prose = []
        start = i = i + 1
        while i < len(lines) and lines[i] != "```":
            i += 1
        if i == len(lines):
            raise DataError(f"line {start}: the block is not closed; end it with ```")
        yield Block(opening[1], "\n".join(lines[start:i]), start + 1, opening[2])
        i += 1
    yield "\n".join(prose)
