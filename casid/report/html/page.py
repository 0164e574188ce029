"""The shell of a page: one self-contained HTML file that opens offline.

The page carries plotly.js once and its figures as JSON; it loads nothing. Two things keep text from
a file from becoming code: every string is escaped where it enters the page, and the page's content
security policy lets only its own two scripts run, named by their SHA-256.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
from typing import Any

from casid.report.document import Document, Figure, Section
from casid.report.figures.style import visible_text
from casid.report.html.drawing import DRAW
from casid.report.html.markup import Html, element, join
from casid.report.html.parts import Renderer, inline
from casid.report.html.style import STYLE


class _Page(Renderer):
    """Figures of a page are places that its script fills from their data."""

    def __init__(self) -> None:
        self.data: list[Html] = []

    def figure(self, figure: Figure) -> Html:
        name, caption = figure.name, figure.caption
        self.data.append(
            Html(
                f'<script type="application/json" id="data-{name}">'
                f"{_figure_json(figure.drawing)}</script>"
            )
        )
        place = (
            f'<div class="plot" id="figure-{name}" role="img" '
            f'style="height:{int(figure.drawing.layout.height)}px" '
            f'aria-label="{html.escape(visible_text(caption))}"></div>'
        )
        return element("figure", Html(place) + element("figcaption", caption))


def html_page(document: Document) -> str:
    """A document of sections as one HTML page; the same document gives the same page."""
    page = _Page()
    sections = [s for s in document.parts if isinstance(s, Section)]
    bodies = [(inline(s.heading), page.parts(s.parts)) for s in sections]
    filled = [(f"s{i}", *body) for i, body in enumerate(b for b in bodies if b[1])]
    links = join(
        element("a", heading, href=f"#{anchor}") for anchor, heading, _ in filled if heading
    )
    main = join(
        element("section", (element("h2", heading) if heading else "") + content, id=anchor)
        for anchor, heading, content in filled
    )
    return _shell(document, links, main, page.data)


def _shell(document: Document, links: Html, main: Html, data: list[Html]) -> str:
    """The page around its sections: head, policy, style, scripts."""
    from plotly.offline import get_plotlyjs

    library = _script(get_plotlyjs())
    drawing = _script(DRAW)
    policy = (
        "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; "
        f"script-src {_hash(library)} {_hash(drawing)}; base-uri 'none'; form-action 'none'"
    )
    kicker = element("p", f"casid \u00b7 {document.kind}", class_="kicker")
    title = f"{document.kind} of {visible_text(document.title)}"
    return "\n".join(
        (
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="referrer" content="no-referrer">',
            element("title", f"{title} - casid"),
            f"<style>{STYLE}</style></head><body>",
            element("header", kicker + element("h1", document.title)),
            element("nav", links, aria_label="Sections") if links else "",
            "<noscript><p>The figures need JavaScript; every number is also in a table."
            "</p></noscript>",
            element("main", main),
            *data,
            f"<script>{library}</script>" if data else "",
            f"<script>{drawing}</script>" if data else "",
            "</body></html>\n",
        )
    )


def _figure_json(figure: Any) -> str:
    """The figure as JSON that cannot end its script block; its title, the caption, taken out."""
    content = json.loads(figure.to_json(engine="json"))
    content["layout"].pop("title", None)
    content["layout"]["margin"]["t"] = 40
    # The mode bar is beside the plot, never on it.
    content["layout"]["margin"]["r"] = max(content["layout"]["margin"].get("r", 0), 44)
    content["layout"]["height"] = figure.layout.height - figure.layout.margin.t + 40
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=True)
    for sign in "<>&":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def _script(text: str) -> str:
    """A script as the page's parser will see it: one kind of line end, no end tag inside."""
    return text.replace("\r\n", "\n").replace("\r", "\n").replace("</script", "<\\/script")


def _hash(script: str) -> str:
    digest = hashlib.sha256(script.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
