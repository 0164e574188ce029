"""The look of every figure: its colours, and names of files made harmless in its texts.

Names come from files: `figure_text` makes them harmless, since Plotly reads part of HTML in text.
"""

from __future__ import annotations

import html
import re
import unicodedata

from casid.model.effects.names import effect_words
from casid.model.quantities import unit_text

# Okabe & Ito (2008), distinct to colour-blind readers; dashes and hatching say the same again.
MEASURED = "#8c8c8c"
BEFORE = "#D55E00"
AFTER = "#0072B2"
FLOOR = "#009E73"
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, Helvetica, Arial, sans-serif"
_BIDI = frozenset("\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")


def visible_text(text: object) -> str:
    """`text` without what a reader cannot see: control and direction marks, lone surrogates."""
    return "".join(
        " "
        if c in "\n\t\r"
        else "\ufffd"
        if c in _BIDI or unicodedata.category(c) in ("Cc", "Cs")
        else c
        for c in str(text)
    )


def figure_text(text: object, longest: int = 40) -> str:
    """`text` as Plotly shows it literally, cut at `longest`: no tag, entity or template works."""
    plain = visible_text(text)
    if len(plain) > longest:
        plain = plain[: longest - 1] + "\u2026"
    # Templates (%{x}) are filled in before entities are read, so the entity hides the sign.
    return html.escape(plain, quote=False).replace("%", "&#37;").replace("$", "&#36;")


def effect_label(kind: str, where: str, description: str = "") -> str:
    """An effect and its place in words, short enough for a tick: `cubic stiffness, torque`."""
    return short_label(effect_words(kind, where, description=description))


def short_label(words: str, longest: int = 34) -> str:
    """The words for an effect and its place, short enough for a tick."""
    return figure_text(re.sub(r" in the (\S+) balance", r", \1", words), longest)


def axis_text(name: str, unit: str, before: str = "") -> str:
    """Axis title: name and unit, on two lines where one would not fit a panel."""
    text = before + figure_text(name, 22)
    if not unit:
        return text
    between = "<br>" if len(name) + len(unit) > 20 else " "
    return f"{text}{between}[{figure_text(unit_text(unit), 22)}]"


def hover_text(x_unit: str, y_unit: str) -> str:
    """What the pointer shows: both coordinates with their units."""
    shown = [figure_text(unit_text(unit)) for unit in (x_unit, y_unit)]
    return f"%{{x:.5g}} {shown[0]}, %{{y:.4g}} {shown[1]}"


def translucent(colour: str, alpha: float) -> str:
    """`#rrggbb` with an opacity, as CSS has it."""
    r, g, b = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},{alpha})"
