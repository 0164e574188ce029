"""Documents as lines of text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from casid.report.document import (
    Banner,
    Bullets,
    Cards,
    Document,
    Equations,
    Figure,
    Lines,
    Paragraph,
    Part,
    Section,
    Table,
    plain,
)


def terminal_text(document: Document) -> str:
    """The document as lines of text."""
    title = f"{document.kind} of {document.title}" if document.kind else document.title
    lines = _wrapped(title, "", document.width) if title else []
    for part in document.parts:
        lines += _lines(part, document)
    return "\n".join(lines)


def _lines(part: Part, document: Document) -> Iterator[str]:
    match part:
        case str() | Paragraph():
            text = part if isinstance(part, str) else plain(part.text)
            yield from _wrapped(text, "", document.width)
        case (label, text):
            yield from _wrapped(text, f"  {label:<{document.label}}", document.width)
        case Table() | Lines():
            yield from part.lines() if isinstance(part, Table) else part.lines
        case Equations(equations):
            yield from (f"  {equation}" for equation in equations)
        case Bullets(items):
            for i, item in enumerate(items, 1):
                lead = f"  {i}. " if part.is_numbered else "  - "
                yield from _wrapped(plain(item), lead, document.width)
        case Banner():
            yield from _wrapped(f"{part.word}: {part.beside}", "", document.width)
            yield from _wrapped(part.sentence, "", document.width)
        case Cards(cards):
            for card in cards:
                texts = (f"{card.title}:", card.value, card.unit, card.rest and f"({card.rest})")
                yield from _wrapped(" ".join(filter(None, texts)), "  ", document.width)
        case Figure():
            yield from _wrapped(f"[figure: {part.caption}]", "  ", document.width)
        case Section(heading, parts):
            below = [line for inner in parts for line in _lines(inner, document)]
            if below:
                yield from ("", plain(heading), *below)


def _wrapped(text: str, lead: str, width: int | None) -> list[str]:
    """A line after its lead, cut at `width` characters; a row of a table between its columns."""
    if width is None or len(lead) + len(text) <= width:
        return [lead + text]
    inner = text.lstrip()
    lead += " " * (len(text) - len(inner))
    head, gap, tail = inner.rstrip().rpartition("  ")
    if gap and "  " in head and len(lead + head.rstrip()) <= width:  # a row of a table
        return [(lead + head).rstrip(), *_wrapped(tail.strip(), lead + "  ", width)]
    return textwrap.wrap(
        inner,
        width,
        initial_indent=lead,
        subsequent_indent=" " * len(lead) + "  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
