"""How results reach their text, figures and page, which `casid.report` makes.

Results do not know what they look like: they say only that they can be displayed. This module has
the one step upward to `casid.report`, taken by name when something is displayed, since a result
that is never displayed must load neither pages nor figures, and since no module of the packages
below may import `casid.report`. What is displayed how is one table, `casid.report.renderers`.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any


def present(result: object, form: str, *arguments: Any, **settings: Any) -> Any:
    """`result` in a form that `casid.report.renderers` lists for its class.

    Parameters
    ----------
    form : "text", "html" (a part of a page, for notebooks), "figure", "figures" (by name), "page".
    arguments, settings : passed on to the renderer.

    Raises
    ------
    LookupError
        If results of this class have no such form.
    """
    renderers = importlib.import_module("casid.report.renderers")
    return renderers.renderer(type(result), form)(result, *arguments, **settings)


class Viewed:
    """A result that notebooks display by the view that `casid.report` makes of it."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return str(present(self, "html"))


class Presented(Viewed):
    """A result that `print` and notebooks display with what `casid.report` makes of it."""

    __slots__ = ()

    def __str__(self) -> str:
        return str(present(self, "text"))


def write(result: object, folder: str | Path) -> Path:
    """Write the JSON content of a result and its page `report.html`; returns the page's path."""
    path: Path = present(result, "files", Path(folder))
    return path
