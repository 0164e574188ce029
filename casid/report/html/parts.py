"""Parts of a document as HTML, the same on a page and in a notebook but for figures."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import groupby

from casid.estimation.fitted.equations import ModelEquation
from casid.model.quantities import unit_text
from casid.report.document import (
    Banner,
    Bullets,
    Card,
    Cards,
    Code,
    Equations,
    Figure,
    Identifier,
    Inline,
    Lines,
    Paragraph,
    Part,
    Section,
    Status,
    Strong,
    Table,
)
from casid.report.figures.style import visible_text
from casid.report.html.markup import Html, element, join, safe

_STATUSES = ("named", "cannot be rejected", "rejected", "not significant", "undetectable")


class Renderer(ABC):
    """Parts as HTML; a part without content is nothing."""

    @abstractmethod
    def figure(self, figure: Figure) -> Html:
        """The figure with its caption."""

    def parts(self, parts: Iterable[Part]) -> Html:
        """Parts one below another; labelled texts that follow one another are a table."""
        return join(self._groups(parts))

    def _groups(self, parts: Iterable[Part]) -> Iterator[Html]:
        for is_labelled, group in groupby(parts, lambda part: isinstance(part, tuple)):
            if is_labelled:
                rows = (p for p in group if isinstance(p, tuple))
                yield _labelled_table(rows)
            else:
                yield from map(self.part, group)

    def part(self, part: Part) -> Html:
        """One part."""
        match part:
            case str():
                return element("p", inline(part.strip())) if part.strip() else Html("")
            case Paragraph(text, look):
                return element("p", inline(text), **_class(look))
            case Lines(lines):
                return element("pre", Html("\n".join(map(safe, lines)))) if lines else Html("")
            case Equations(equations):
                rows = join(map(_equation, equations))
                return _scrolling(rows, "equations", "Equations") if equations else Html("")
            case Table():
                return _table(part) if part.rows else Html("")
            case Bullets():
                return _bullets(part) if part.items else Html("")
            case Banner():
                return _banner(part)
            case Cards(cards):
                return element("dl", join(map(_card, cards)), class_="cards") if cards else Html("")
            case Figure():
                return self.figure(part)
            case Section():
                return self.section(part)
        return Html("")

    def section(self, section: Section) -> Html:
        """A section inside of another."""
        content = self.parts(section.parts)
        if not content:
            return content
        if section.look == "fold":
            summary = element("summary", inline(section.heading))
            return element("details", summary + content, class_="fold")
        level = "h2" if section.look == "advice" else "h3"
        framed = element(level, inline(section.heading)) + content
        if not section.look:
            return framed
        return element("article" if section.look == "cause" else "div", framed, class_=section.look)


def inline(text: Inline) -> Html:
    """Text of a line, each of its pieces in its element."""
    if isinstance(text, tuple):
        return join(map(inline, text))
    match text:
        case Code():
            return element("code", str(text))
        case Identifier():
            return element("code", str(text), class_="id")
        case Strong():
            return element("b", str(text))
        case Status():
            kind = text.replace(" ", "-") if text in _STATUSES else "other"
            return element("span", str(text), class_=f"status {kind}")
    return safe(unit_text(text))


def _scrolling(content: Html, look: str, label: str) -> Html:
    """What scrolls by itself where it is wider than the page, also by the keyboard."""
    return element("div", content, class_=look, tabindex="0", role="group", aria_label=label)


def _equation(e: ModelEquation) -> Html:
    """The equation in MathML, which browsers draw themselves; as code where it has none."""
    is_named = e.name not in (e.left, f"output {e.left}") and not e.note
    name = element("span", e.name, class_="name") if is_named else ""
    words = [f"[{unit_text(e.unit)}]" if e.unit else "", e.note]
    beside = element("span", " ".join(filter(None, words)), class_="unit") if any(words) else ""
    if not e.left_mathml or not all(term.mathml for term in e.terms):
        return element("div", name + element("code", str(replace(e, unit="", note=""))) + beside)
    content = _marked(e.left_mathml, e.mark * e.left_is_new) + "<mo>=</mo>"
    for i, term in enumerate(e.terms):
        if term.text.startswith("-"):
            content += "<mo>\u2212</mo>" if i else '<mo form="prefix">\u2212</mo>'
        elif i:
            content += "<mo>+</mo>"
        content += _marked(term.mathml, e.mark * term.is_new)
    return element(
        "div", name + element("math", Html(visible_text(content)), displaystyle="true") + beside
    )


def _marked(mathml: str, mark: str) -> str:
    return _MARKED.format(mathml, safe(mark)) if mark else mathml


_MARKED = (
    '<munder class="new"><mrow>{}</mrow><munder><mo stretchy="true">\u23df</mo>'
    "<mtext>{}</mtext></munder></munder>"
)
"""A term with a brace below it that says what it is: new."""


def _class(look: str) -> dict[str, str]:
    return {"class_": look} if look else {}


def _labelled_table(rows: Iterable[tuple[str, str]]) -> Html:
    cells = (element("th", label, scope="row") + element("td", text) for label, text in rows)
    return element("table", element("tbody", join(element("tr", row) for row in cells)))


def _table(table: Table) -> Html:
    """The table under its caption, which scrolls by itself where it is wider than the page."""
    head = join(_heading(h, i in table.numbers) for i, h in enumerate(table.header))
    body = join(element("tr", _cells(row, table)) for row in table.rows)
    caption = table.caption or " ".join(h for h in table.header if h)
    content = element(
        "table",
        element("thead", element("tr", head)) + element("tbody", body),
        aria_label=caption,
    )
    scroll = _scrolling(content, "scroll", caption)
    # The caption is outside of what scrolls: on a phone it must not run off the side.
    above = element("p", table.caption, class_="caption") if table.caption else ""
    return element("div", above + scroll, class_="table")


def _heading(text: str, is_number: bool) -> Html:
    """A column's heading; where it has none, an empty cell, which nobody reads out."""
    look = {"class_": "n" if is_number else ""}
    return element("th", text, **look, scope="col") if text else element("td", "", **look)


def _cells(row: Sequence[Inline] | str, table: Table) -> Html:
    if isinstance(row, str):
        return element("td", row, colspan=str(len(table.header)))
    return join(
        element(
            "td",
            "\u2013" if cell == "--" else inline(cell),
            **_class("n" if i in table.numbers else ""),
        )
        for i, cell in enumerate(row)
    )


def _bullets(bullets: Bullets) -> Html:
    items = join(element("li", inline(item)) for item in bullets.items)
    return element("ol" if bullets.is_numbered else "ul", items, **_class(bullets.look))


def _banner(banner: Banner) -> Html:
    return element(
        "div",
        element("p", element("b", banner.word) + safe(banner.beside), class_="word")
        + element("p", unit_text(banner.sentence), class_="sentence"),
        class_=f"banner {banner.look}",
        role="status",
    )


def _card(card: Card) -> Html:
    unit, rest = unit_text(card.unit), unit_text(card.rest)
    value = safe(f"{card.value} ") + element("small", unit) if unit else card.value
    return element(
        "div",
        element("dt", card.title) + element("dd", value) + element("dd", rest, class_="rest"),
        class_="card",
    )
