"""Transfer functions as a reader writes them: ``0.07 / (q - 0.11)``."""

from __future__ import annotations

from fractions import Fraction

from casid.algebra.polynomial import Coefficient, Polynomial

_LONGEST = 12  # characters of an exact number; a longer one is rounded in print


def fraction_text(numerator: Polynomial, denominator: Polynomial, variable: str) -> str:
    """One line, descending powers."""
    above = polynomial_text(numerator, variable)
    if len(denominator) == 1 and denominator[0] == 1:
        return above
    below = polynomial_text(denominator, variable)
    above = f"({above})" if " + " in above or " - " in above or "/" in above else above
    return f"{above} / {_bracketed(below)}"


def polynomial_text(p: Polynomial, variable: str) -> str:
    """A polynomial, descending."""
    terms = []
    for power, c in zip(range(len(p) - 1, -1, -1), p, strict=True):
        if c != 0:
            name = ("", variable)[power] if power < 2 else f"{variable}^{power}"
            terms.append(_term(c, name))
    return " + ".join(terms).replace("+ -", "- ") if terms else "0"


def number_text(c: Coefficient) -> str:
    """A coefficient: a decimal where it is one, a ratio where short, else rounded."""
    if not isinstance(c, Fraction):
        return str(c).replace("**", "^")
    if c.denominator == 1 and len(str(c)) <= _LONGEST:
        return str(c)
    decimal = f"{float(c):.12g}"
    if "e" not in decimal and Fraction(decimal) == c:
        return decimal
    return str(c) if len(str(c)) <= _LONGEST else f"{float(c):.6g}"


def _term(c: Coefficient, name: str) -> str:
    text = number_text(c)
    if not name:
        return text
    if text in ("1", "-1"):
        return text[:-1] + name
    return f"({text}) {name}" if " " in text or "/" in text else f"{text} {name}"


def _bracketed(text: str) -> str:
    return f"({text})" if " " in text or "/" in text or "*" in text else text
