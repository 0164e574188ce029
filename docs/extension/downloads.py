"""A page of the gallery as a script and as a notebook."""

from __future__ import annotations

import json
from pathlib import Path

from code_runner import Block, split


def write_downloads(text: str, name: str, folder: Path) -> str:
    """Write `name`.py and `name`.ipynb into `folder`; returns the links for the page's end."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = [p for p in split(text) if isinstance(p, Block) or p.strip()]
    (folder / f"{name}.py").write_text(_script(parts), encoding="utf-8")
    (folder / f"{name}.ipynb").write_text(_notebook(parts), encoding="utf-8")
    where = "../_static/gallery"
    return (
        f'<p class="downloads">This page as a <a href="{where}/{name}.py" download>script</a> and '
        f'as a <a href="{where}/{name}.ipynb" download>notebook</a>; run them in a checkout.</p>'
    )


def _is_run(part: str | Block) -> bool:
    return isinstance(part, Block) and part.language == "python"


def _script(parts: list[str | Block]) -> str:
    """Code as it is, prose as comments; a block without its file is left out when it runs."""
    out = []
    for part in parts:
        if not isinstance(part, Block) or not _is_run(part):
            text = part.shown if isinstance(part, Block) else part.strip()
            out.append("\n".join(f"# {line}".rstrip() for line in text.splitlines()))
        elif part.needs is not None:
            inside = "\n".join(f"    {line}".rstrip() for line in part.text.splitlines())
            out.append(f'if __import__("os").path.exists({part.needs!r}):\n{inside}')
        else:
            out.append(part.text)
    return "\n\n".join(out) + "\n"


def _notebook(parts: list[str | Block]) -> str:
    cells = []
    for part in parts:
        if isinstance(part, Block) and _is_run(part):
            cell = {"cell_type": "code", "execution_count": None, "outputs": []}
            cells.append({**cell, "metadata": {}, "source": part.text})
        else:
            text = part.shown if isinstance(part, Block) else part.strip()
            cells.append({"cell_type": "markdown", "metadata": {}, "source": text})
    for i, cell in enumerate(cells):
        cell["id"] = f"cell-{i}"
    book = {"cells": cells, "metadata": {}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(book, indent=1) + "\n"
