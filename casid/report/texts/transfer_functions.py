"""Transfer functions as a reader writes them: polynomials in s, symbolic coefficients."""

from __future__ import annotations

from typing import Any

from casid.algebra.factoring import factored
from casid.errors import ModelError
from casid.linear.linear_model import TransferMatrix
from casid.report.document import Document, Lines

Algebra = Any  # a sympy expression

_PRINTED = 400  # operations beyond which transfer functions are no reading


def transfer_document(transfer: TransferMatrix) -> Document:
    """One line for each transfer function, common factors cancelled; large ones are left out."""
    size = transfer.function.n_instructions()
    if size > _PRINTED:
        why = f"{size} operations, too many to print; evaluate(values) has numbers"
        return Document(f"{transfer!r}: {why}", [])
    try:
        return Document(repr(transfer), [Lines(_lines(transfer))])
    except ModelError as reason:  # an operation that algebra does not know
        return Document(f"{transfer!r}: {reason}", [])


def _lines(transfer: TransferMatrix) -> list[str]:
    import sympy

    from casid.algebra.symbolic import to_sympy

    s = sympy.Symbol(next(n for n in ("s", "p", "d/dt") if n not in transfer.parameters))

    def polynomial(coefficients: Any) -> Algebra:
        column = to_sympy(coefficients, exact_numbers=True)
        return sum(c * s ** (len(column) - 1 - k) for k, c in enumerate(column))

    entries = []
    for output, row in zip(transfer.outputs, transfer.numerators, strict=True):
        for name, numerator in zip(transfer.inputs, row, strict=True):
            ratio = sympy.cancel(polynomial(numerator) / polynomial(transfer.denominator))
            above, below = (_written(part, s) for part in sympy.fraction(ratio))
            entries.append((f"  {output} / {name} =", above, below))
    shared = {below for _, _, below in entries if below != "1"}
    is_common = len(entries) > 1 and len(shared) == 1 and "D" not in transfer.parameters
    lines = []
    for left, above, below in entries:
        above = f"({above})" if " " in above and below != "1" else above
        below = "" if below == "1" else " / D" if is_common else f" / ({below})"
        lines.append(f"{left} {above}{below}")
    return lines + [f"  D = {below}" for below in shared if is_common]


def _written(polynomial: Algebra, s: Algebra) -> str:
    """A sympy polynomial as text, descending in s, each coefficient factored."""
    import sympy

    terms = []
    for (power,), coefficient in sympy.Poly(polynomial, s).terms():
        made = factored(coefficient)
        letter = ("", str(s))[power] if power < 2 else f"{s}^{power}"
        text = f"({made})" if made.is_Add and letter else str(made)
        text = text[:-1] + letter if letter and text in ("1", "-1") else f"{text} {letter}".strip()
        terms.append(text)
    return " + ".join(terms).replace("**", "^").replace("+ -", "- ")
