"""A document as a notebook shows it."""

from __future__ import annotations

from casid.report.document import Document, Figure
from casid.report.html.markup import Html, element
from casid.report.html.parts import Renderer


class _Notebook(Renderer):
    def figure(self, figure: Figure) -> Html:
        return element("p", figure.caption)


def notebook_html(document: Document) -> str:
    """A part of a page: no script."""
    title = element("p", element("strong", document.title)) if document.title else Html("")
    return element("div", title + _Notebook().parts(document.parts))
