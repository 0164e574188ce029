"""Names and texts that a formula, a file or another language can hold."""

from __future__ import annotations

import json
import re


def identifier(name: str) -> str:
    """A name of letters, digits and underscores that begins with a letter: `k1`, `step_at_2_s`."""
    text = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")
    text = re.sub(r"_{2,}", "_", text)
    return text if text and text[0].isalpha() else f"s_{text}".rstrip("_")


def made_identifier(name: str) -> str:
    """A name itself where it is an identifier, in whatever letters, or else one made of it."""
    return name if name.isidentifier() else identifier(name)


def quoted(text: str) -> str:
    """A Python string in double quotes, on one line."""
    return json.dumps(text, ensure_ascii=False)


def docstring_text(text: str) -> str:
    """A text on one line that ends no docstring: quotes are single, backslashes slashes."""
    return " ".join(text.replace('"', "'").replace("\\", "/").split())
