"""The shell of a page: one self-contained HTML file that opens offline.

The page carries plotly.js once and its figures as JSON; it loads nothing. Two things keep text from
a file from becoming code: every string is escaped where it enters the page, and the page's content
security policy lets only its own two scripts run, named by their SHA-256.
"""

from __future__ import annotations

import base64
import hashlib
from functools import cache

from casid.report.document import Document, Figure, Section
from casid.report.figures.style import visible_text
from casid.report.html import drawing
from casid.report.html.markup import Html, element, join
from casid.report.html.parts import Renderer, inline
from casid.report.html.style import STYLE


class _Page(Renderer):
    """Figures of a page are places that its script fills from their data."""

    def __init__(self) -> None:
        self.data: list[Html] = []

    def figure(self, figure: Figure) -> Html:
        self.data.append(Html(drawing.data_html(figure)))
        place = Html(drawing.place_html(figure))
        return element("figure", place + element("figcaption", figure.caption))

    def outer(self, i: int, section: Section) -> Html:
        """A section of the document itself: folded, unless it is open."""
        content = self.parts(section.parts)
        if not content:
            return content
        heading = element("h2", inline(section.heading)) if section.heading else Html("")
        if section.is_open or not section.heading:
            return element("section", heading + content, id=f"s{i}")
        return element("details", element("summary", heading) + content, id=f"s{i}", class_="part")


def html_page(document: Document) -> str:
    """A document as one HTML page; the same document gives the same page.

    What decides stands open: what is in no section, and the sections that are open. The others are
    folded, in their order.
    """
    page = _Page()
    sections = [s for s in document.parts if isinstance(s, Section)]
    main = page.parts(p for p in document.parts if not isinstance(p, Section))
    main += join(page.outer(i, section) for i, section in enumerate(sections))
    return _shell(document, main, page.data)


def _shell(document: Document, main: Html, data: list[Html]) -> str:
    """The page around its sections: head, policy, style, scripts."""
    script = _script(drawing.DRAW)
    policy = (
        "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; "
        f"script-src {_library_hash()} {_hash(script)}; base-uri 'none'; form-action 'none'"
    )
    kicker = element("p", f"casid \u00b7 {document.kind}", class_="kicker")
    title = f"{document.kind} of {visible_text(document.title)}"
    return "\n".join(
        (
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="color-scheme" content="light dark">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="referrer" content="no-referrer">',
            element("title", f"{title} - casid"),
            f"<style>{STYLE}</style></head><body>",
            element("header", kicker + element("h1", document.title)),
            "<noscript><p>The figures need JavaScript; every number is also in a table."
            "</p></noscript>",
            element("main", main),
            *data,
            _packed_library() if data else "",
            f"<script>{script}</script>",
            "</body></html>\n",
        )
    )


def _packed_library() -> str:
    return f'<script type="text/plain" id="library">{drawing.packed_library()}</script>'


def _script(text: str) -> str:
    """A script as the page's parser will see it: one kind of line end, no end tag inside."""
    return text.replace("\r\n", "\n").replace("\r", "\n").replace("</script", "<\\/script")


@cache
def _library_hash() -> str:
    return _hash(_script(drawing.library()))


def _hash(script: str) -> str:
    digest = hashlib.sha256(script.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
