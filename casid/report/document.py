"""What is displayed of a result, before it is text or HTML: a title, lines and tables.

A result is put together once as a `Document`; `terminal_text` here makes text of it, and
`casid.report.pages.markup.fragment` the HTML that notebooks show.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Table:
    """Cells in columns under a header.

    Attributes
    ----------
    rows : cells, or a text that spans the columns.
    numbers : columns set flush right.
    widths : least widths of the columns in a terminal with the space before a number or behind a
        text; without them, columns are as wide as their cells and stand two spaces apart.
    caption : above the table on a page; a terminal shows none.
    is_ruled : whether a line is drawn below the header in a terminal.
    indent : of the lines in a terminal, in spaces.
    widest : characters of a line; columns that do not fit follow in a table below, beside the
        first column again. None: any number.
    joined : columns that must stand beside the one before.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str] | str]
    numbers: Sequence[int] = ()
    widths: Sequence[int] = ()
    caption: str = ""
    is_ruled: bool = False
    indent: int = 2
    widest: int | None = None
    joined: Sequence[int] = ()

    def lines(self) -> list[str]:
        """The table as aligned lines."""
        if self.widest is not None:
            parts = [self._of_columns(columns).lines() for columns in self._blocks(self.widest)]
            return [line for part in parts for line in ("", *part)][1:]
        cells = [self.header, *(row for row in self.rows if not isinstance(row, str))]
        longest = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = [self._line(row, longest) for row in (self.header, *self.rows)]
        if self.is_ruled:
            lines.insert(1, self._line(["-" * n for n in longest], longest))
        return lines

    def _blocks(self, widest: int) -> list[list[int]]:
        rows = [self.header, *(row for row in self.rows if not isinstance(row, str))]
        longest = [max(map(len, column)) for column in zip(*rows, strict=True)]
        blocks: list[list[int]] = [[0]]
        for i in range(1, len(longest)):
            if i in self.joined:
                continue
            columns = [i, i + 1] if i + 1 in self.joined else [i]
            used = sum(2 + longest[k] for k in [*blocks[-1], *columns]) - 2
            if used > widest and len(blocks[-1]) > 1:
                blocks.append([0])
            blocks[-1] += columns
        return blocks

    def _of_columns(self, columns: Sequence[int]) -> Table:
        rows = [row if isinstance(row, str) else [row[k] for k in columns] for row in self.rows]
        numbers = [i for i, k in enumerate(columns) if k in self.numbers]
        header = [self.header[k] for k in columns]
        return replace(self, header=header, rows=rows, numbers=numbers, widest=None, joined=())

    def _line(self, row: Sequence[str] | str, longest: Sequence[int]) -> str:
        text = " " * self.indent
        if isinstance(row, str):
            return text + row
        for i, cell in enumerate(row):
            is_number, after_number = i in self.numbers, i - 1 in self.numbers
            if i < len(self.widths):
                width = max(self.widths[i], longest[i] + (after_number or not is_number))
                gap = "  " if after_number and not is_number else ""
            else:
                width = longest[i]
                gap = "  " if i and (after_number or not self.widths) else ""
            text += gap + (cell.rjust(width) if is_number else cell.ljust(width))
        return text.rstrip()


Labelled = tuple[str, str]
"""A label and the text beside it; an empty label continues the one above."""


@dataclass(frozen=True)
class Document:
    """A title with its parts below it.

    Attributes
    ----------
    parts : lines as they are, labelled texts, and tables.
    label : columns that a label takes in a terminal.
    width : characters at which lines of a terminal are cut, tables apart; None: nowhere.
    """

    title: str
    parts: Sequence[str | Labelled | Table]
    label: int = 14
    width: int | None = None


def terminal_text(document: Document) -> str:
    """The document as lines of text."""
    lines: list[str] = []
    for part in (*([document.title] if document.title else ()), *document.parts):
        if isinstance(part, Table):
            lines += part.lines()
            continue
        lead, text = (
            ("", part) if isinstance(part, str) else (f"  {part[0]:<{document.label}}", part[1])
        )
        lines += wrapped(text, lead, document.width) if document.width else [lead + text]
    return "\n".join(lines)


def labelled(label: str, texts: Sequence[str]) -> list[Labelled]:
    """Texts under one label, which precedes the first."""
    return [(label if not i else "", text) for i, text in enumerate(texts)]


def wrapped(text: str, lead: str, width: int) -> list[str]:
    """A line after its lead, cut at `width` characters; a row of a table between its columns."""
    if len(lead) + len(text) <= width:
        return [lead + text]
    inner = text.lstrip()
    lead += " " * (len(text) - len(inner))
    head, gap, tail = inner.rstrip().rpartition("  ")
    if gap and "  " in head and len(lead + head.rstrip()) <= width:  # a row of a table
        return [(lead + head).rstrip(), *wrapped(tail.strip(), lead + "  ", width)]
    return textwrap.wrap(
        inner,
        width,
        initial_indent=lead,
        subsequent_indent=" " * len(lead) + "  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
