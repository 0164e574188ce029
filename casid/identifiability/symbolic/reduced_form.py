"""A row-reduced observability matrix, and labelled matrices as LaTeX.

Source of the form: Linder (2017), (7.20)-(7.23).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from casid.identifiability.symbolic.symbolic_rank import tidy
from casid.presentation import Presented

Matrix = Any  # a sympy matrix


def derivative_name(name: str, order: int) -> str:
    """How the order-th time derivative of `name` is written: u, u', u'', u''', u^(4), ..."""
    return name + "'" * order if order < 4 else f"{name}^({order})"


@dataclass(frozen=True, eq=False)
class ReducedForm(Presented):
    """Reduced row echelon form of an observability matrix, without its zero rows.

    Attributes
    ----------
    matrix : (r, n) sympy matrix.
    columns : (n,) names.
    pivots : (r,) columns that hold the ones.
    """

    system: str
    matrix: Matrix
    columns: tuple[str, ...]
    pivots: tuple[int, ...]

    @property
    def rank(self) -> int:
        """Number of rows."""
        return len(self.pivots)

    def normalized(self) -> ReducedForm:
        """Every column divided by its first entry that is not zero, as (7.20)-(7.23) are printed.

        Two columns that become the same are linearly dependent.
        """
        matrix = self.matrix.as_mutable()
        for j in range(matrix.shape[1]):
            first = next((e for e in matrix[:, j] if e != 0), None)
            if first is not None:
                matrix[:, j] = (matrix[:, j] / first).applyfunc(tidy)
        return ReducedForm(self.system, matrix.as_immutable(), self.columns, self.pivots)

    def to_latex(self) -> str:
        """The form as a LaTeX array, labelled."""
        return latex_table(self.matrix, self.row_names, self.columns)

    def __repr__(self) -> str:
        return f"<ReducedForm {self.system}: rank {self.rank} of {len(self.columns)} columns>"

    @property
    def row_names(self) -> list[str]:
        """The column of the one in each row."""
        return [self.columns[j] for j in self.pivots]


def latex_table(matrix: Matrix, rows: Sequence[str], columns: Sequence[str]) -> str:
    """A labelled matrix as a LaTeX array; u', u'' and u^(4) become dots and superscripts."""
    import sympy

    names = {s: _latex_name(s.name) for s in matrix.free_symbols}
    head = " & ".join(["", *[_latex_name(c) for c in columns]])
    body = [
        " & ".join([_latex_name(rows[i]), *[sympy.latex(e, symbol_names=names) for e in line]])
        for i, line in enumerate(matrix.tolist())
    ]
    return "\n".join(
        [
            rf"\begin{{array}}{{c|{'c' * len(columns)}}}",
            rf"{head} \\ \hline",
            *[rf"{line} \\" for line in body],
            r"\end{array}",
        ]
    )


def _latex_name(name: str) -> str:
    """LaTeX of a symbol's name: a_y'' is a second derivative, I_xm has a subscript."""
    import sympy

    written = re.fullmatch(r"(?P<name>.*?)(?P<dots>'+|\^\((?P<order>\d+)\))?", name)
    assert written is not None
    plain = sympy.latex(sympy.Symbol(written["name"]))
    if written["order"]:
        return f"{{{plain}}}^{{({written['order']})}}"
    dots = {0: "", 1: "dot", 2: "ddot", 3: "dddot"}[len(written["dots"] or "")]
    return rf"\{dots}{{{plain}}}" if dots else plain
