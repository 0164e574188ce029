"""Markup of a page: text is escaped where it enters, and what is markup already says so."""

from __future__ import annotations

import html
from collections.abc import Iterable

from casid.report.figures.style import visible_text


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
