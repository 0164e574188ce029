"""Markup of a page: text is escaped where it enters, and what is markup already says so."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby

from casid.report.document import Document, Table
from casid.report.figures.look import visible_text


class Html(str):
    """Text that is markup already; everything else is escaped on its way into the page."""

    __slots__ = ()

    def __add__(self, other: str) -> Html:
        return Html(str(self) + str(safe(other)))

    def __radd__(self, other: str) -> Html:
        return Html(str(safe(other)) + str(self))


def safe(text: object) -> Html:
    """Text made harmless; markup as it is."""
    return text if isinstance(text, Html) else Html(html.escape(visible_text(text)))


def join(parts: Iterable[str]) -> Html:
    """Parts one after another, each made harmless."""
    return Html("".join(safe(p) for p in parts))


def element(tag: str, content: object = "", **attributes: str) -> Html:
    """One element; an attribute `class_` loses its underscore, and inner ones become hyphens."""
    text = "".join(
        f' {k.rstrip("_").replace("_", "-")}="{html.escape(visible_text(v))}"'
        for k, v in attributes.items()
    )
    return Html(f"<{tag}{text}>{safe(content)}</{tag}>")


def paragraph(text: str) -> Html:
    """A paragraph, nothing where there is no text."""
    return element("p", text) if text else Html("")


def bullets(items: Sequence[str]) -> Html:
    """A list of points, nothing where there are none."""
    return element("ul", join(element("li", i) for i in items)) if items else Html("")


def table(
    caption: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
) -> Html:
    """A table under its caption, which scrolls by itself where it is wider than the page.

    `numbers` are the columns that hold numbers, set flush right.
    """

    def cell(tag: str, i: int, content: str) -> Html:
        return element(tag, content, class_="n") if i in numbers else element(tag, content)

    head = join(
        element("th", h, class_="n" if i in numbers else "", scope="col")
        for i, h in enumerate(header)
    )
    body = join(element("tr", join(cell("td", i, c) for i, c in enumerate(r))) for r in rows)
    content = element(
        "table",
        element("thead", element("tr", head)) + element("tbody", body),
        aria_label=caption,
    )
    scroll = element(
        "div", content, class_="scroll", tabindex="0", role="region", aria_label=caption
    )
    # The caption is outside of what scrolls: on a phone it must not run off the side.
    return element("div", element("p", caption, class_="caption") + scroll, class_="table")


def fragment(document: Document) -> Html:
    """A document as part of a page, for notebooks: no style, no script."""
    parts = [element("p", element("strong", document.title))] if document.title else []
    for is_labelled, group in groupby(document.parts, lambda part: isinstance(part, tuple)):
        if is_labelled:
            cells = (p for p in group if isinstance(p, tuple))
            rows = (element("th", k, scope="row") + element("td", text) for k, text in cells)
            parts.append(element("table", element("tbody", join(element("tr", r) for r in rows))))
            continue
        for part in group:
            if isinstance(part, Table):
                parts.append(_plain_table(part))
            elif part:
                parts.append(element("p", str(part).strip()))
    return element("div", join(parts))


def _plain_table(part: Table) -> Html:
    head = element("tr", join(element("th", h, scope="col") for h in part.header))
    body = [
        element("td", row, colspan=str(len(part.header)))
        if isinstance(row, str)
        else join(element("td", cell) for cell in row)
        for row in part.rows
    ]
    rows = join(element("tr", row) for row in body)
    return element("table", element("thead", head) + element("tbody", rows))


def mapping_table(pairs: Mapping[str, str], header: tuple[str, str]) -> Html:
    """A table of two columns, nothing where there are no rows."""
    return table(" and ".join(header), header, list(pairs.items())) if pairs else Html("")
