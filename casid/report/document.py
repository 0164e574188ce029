"""What is displayed of a result, before it is text or HTML: sections, paragraphs, tables, figures.

A result is put together once as a `Document`; `casid.report.terminal` makes text of it,
`casid.report.html` the pages and what notebooks show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # printing a document loads no equations
    from casid.estimation.fitted.equations import ModelEquation


class Code(str):
    """A name from a model or a file, set as code on a page."""

    __slots__ = ()


class Identifier(str):
    """The identifier of what stands beside it in words: small, for those who search a file."""

    __slots__ = ()


class Strong(str):
    """Text set in bold on a page."""

    __slots__ = ()


class Status(str):
    """What became of a candidate, beside a coloured mark on a page."""

    __slots__ = ()


Inline = str | tuple[str, ...]
"""Text of a line, or pieces: each text, `Code`, `Identifier`, `Strong` or `Status`."""


def plain(text: Inline) -> str:
    """The text alone."""
    return text if isinstance(text, str) else "".join(text)


@dataclass(frozen=True)
class Paragraph:
    """Text with a look of its own: "facts"."""

    text: Inline
    look: str = ""


@dataclass(frozen=True)
class Lines:
    """Lines that stay as they are, with their indents: equations, transfer functions."""

    lines: Sequence[str]


@dataclass(frozen=True)
class Bullets:
    """Points below one another; `look` is "notice" for a frame that stands out."""

    items: Sequence[Inline]
    look: str = ""
    is_numbered: bool = False


@dataclass(frozen=True)
class Banner:
    """The answer: a word with what stands beside it, and a sentence.

    `look` is "adequate", "deficient" or "undecided".
    """

    word: str
    beside: str
    sentence: str
    look: str


@dataclass(frozen=True)
class Card:
    """A key number: what it is, its value and unit, and what else is to be said."""

    title: str
    value: str
    unit: str = ""
    rest: str = ""


@dataclass(frozen=True)
class Cards:
    """Key numbers beside one another."""

    cards: Sequence[Card]


@dataclass(frozen=True)
class Figure:
    """A Plotly figure, whose caption is in its layout; `name` is harmless in an address."""

    name: str
    drawing: Any

    @property
    def caption(self) -> str:
        """What the figure shows."""
        meta = self.drawing.layout.meta
        return str((meta or {}).get("caption") or self.drawing.layout.title.text or "")


@dataclass(frozen=True)
class Equations:
    """Equations below one another."""

    equations: Sequence[ModelEquation]


def figure_parts(figures: Mapping[str, Any]) -> dict[str, Figure]:
    """Figures by name, as parts of a document."""
    return {name: Figure(name, drawing) for name, drawing in figures.items()}


@dataclass(frozen=True)
class Table:
    """Cells in columns under a header.

    Attributes
    ----------
    rows : cells, or a text that spans the columns. Without rows, a page shows no table.
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
    rows: Sequence[Sequence[Inline] | str]
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
        longest = self._longest()
        lines = [self._line(row, longest) for row in (self.header, *self.rows)]
        if self.is_ruled:
            lines.insert(1, self._line(["-" * n for n in longest], longest))
        return lines

    def _blocks(self, widest: int) -> list[list[int]]:
        longest = self._longest()
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

    def _longest(self) -> list[int]:
        """Characters of the longest cell of each column."""
        cells = [self.header, *(row for row in self.rows if not isinstance(row, str))]
        return [max(len(plain(cell)) for cell in column) for column in zip(*cells, strict=True)]

    def _of_columns(self, columns: Sequence[int]) -> Table:
        rows = [row if isinstance(row, str) else [row[k] for k in columns] for row in self.rows]
        numbers = [i for i, k in enumerate(columns) if k in self.numbers]
        header = [self.header[k] for k in columns]
        return replace(self, header=header, rows=rows, numbers=numbers, widest=None, joined=())

    def _line(self, row: Sequence[Inline] | str, longest: Sequence[int]) -> str:
        text = " " * self.indent
        if isinstance(row, str):
            return text + row
        for i, cell in enumerate(map(plain, row)):
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
class Section:
    """Parts below a heading; without any content, a page leaves it out.

    `look` is "cause" or "advice" for a frame around a section inside of another, "fold" for one
    that unfolds there. Pages and notebooks fold the sections of a document that are not `is_open`.
    """

    heading: Inline
    parts: Sequence[Part]
    look: str = ""
    is_open: bool = False


Part = (
    str
    | Labelled
    | Paragraph
    | Lines
    | Equations
    | Bullets
    | Banner
    | Cards
    | Figure
    | Table
    | Section
    | None
)
"""Of a document; text alone is a paragraph, None is nothing."""


@dataclass(frozen=True)
class Document:
    """A title with its parts below it.

    Attributes
    ----------
    label : columns that a label takes in a terminal.
    width : characters at which lines of a terminal are cut, tables apart; None: nowhere.
    kind : of a page, such as "Estimate": its title is then the name of what it is about.
    """

    title: str
    parts: Sequence[Part]
    label: int = 14
    width: int | None = None
    kind: str = ""


def labelled(label: str, texts: Sequence[str]) -> list[Labelled]:
    """Texts under one label, which precedes the first."""
    return [(label if not i else "", text) for i, text in enumerate(texts)]


def mapping_table(pairs: Mapping[str, str], header: tuple[str, str]) -> Table:
    """A table of two columns."""
    return Table(header, list(pairs.items()), caption=" and ".join(header))
