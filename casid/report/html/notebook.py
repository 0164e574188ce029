"""A document as a notebook shows it: no script, small still figures, folded sections."""

from __future__ import annotations

from casid.report.document import Document, Figure, Section
from casid.report.html.markup import Html, element, join
from casid.report.html.parts import Renderer, inline
from casid.report.html.thumbnail import thumbnail

_STYLE = """
.casid { max-width: 920px; font-size: 14px; line-height: 1.45; }
.casid p, .casid ul, .casid ol { margin: 6px 0; }
.casid table { border-collapse: collapse; font-size: 13px; margin: 4px 0 8px; }
.casid .scroll { overflow-x: auto; }
.casid th, .casid td { padding: 3px 9px; text-align: left; vertical-align: top;
  border-top: 1px solid #8884; }
.casid .n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
.casid .caption, .casid figcaption, .casid .facts, .casid .unit, .casid .rest { opacity: .75;
  font-size: 13px; }
.casid .banner { border-left: 6px solid #5f6073; padding: 4px 12px; margin: 8px 0; }
.casid .adequate { border-color: #00795a; }
.casid .deficient { border-color: #b84f00; }
.casid .banner b { margin-right: 10px; text-transform: capitalize; }
.casid .cards { display: flex; flex-wrap: wrap; gap: 8px 28px; margin: 8px 0; }
.casid .card dd { margin: 0; font-weight: 600; }
.casid .card .rest { font-weight: 400; }
.casid .cause, .casid .advice { border-left: 3px solid #0072b2; padding: 0 0 0 12px;
  margin: 8px 0; }
.casid h3, .casid .advice h2 { font-size: 14px; margin: 8px 0 2px; }
.casid details { margin: 4px 0; }
.casid summary { cursor: pointer; font-weight: 600; }
.casid figure { margin: 8px 0; }
.casid svg { max-width: 100%; height: auto; }
.casid .equations { overflow-x: auto; }
.casid .equations > div { margin: 8px 0; }
.casid .equations .name { display: inline-block; min-width: 9ch; margin-right: 12px; }
.casid .equations .unit { margin-left: 18px; }
.casid math { font-size: 1.1em;
  font-family: 'Latin Modern Math', 'STIX Two Math', 'Cambria Math', 'DejaVu Math TeX Gyre', math; }
.casid .new { color: #0072b2; }
.casid pre { background: none; }
"""


class _Notebook(Renderer):
    """Figures are thumbnails; those in a folded section are left to the report."""

    def __init__(self) -> None:
        self.is_folded = False

    def figure(self, figure: Figure) -> Html:
        if self.is_folded:
            return Html("")
        picture = thumbnail(figure.drawing, figure.caption)
        return element("figure", picture + element("figcaption", figure.caption))

    def outer(self, section: Section) -> Html:
        """A section of the document itself: folded, unless it is open."""
        self.is_folded = not section.is_open
        content = self.parts(section.parts)
        self.is_folded = False
        if not content or not section.heading:
            return content
        summary = element("summary", inline(section.heading))
        opened = {"open": ""} if section.is_open else {}
        return element("details", summary + content, **opened)


def notebook_html(document: Document) -> str:
    """The document as a part of a page, with a style that touches nothing else."""
    notebook = _Notebook()
    words = f"{document.kind}: {document.title}" if document.kind else document.title
    title = element("p", element("strong", words)) if words else Html("")
    sections = [p for p in document.parts if isinstance(p, Section)]
    above = notebook.parts(p for p in document.parts if not isinstance(p, Section))
    content = title + above + join(map(notebook.outer, sections))
    return element("div", Html(f"<style>{_STYLE}</style>") + content, class_="casid")
