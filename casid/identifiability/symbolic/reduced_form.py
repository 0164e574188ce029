"""A row-reduced observability matrix, and labelled matrices as LaTeX.

Source of the form: Linder (2017), (7.20)-(7.23).
"""

from __future__ import annotations

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

    def __repr__(self) -> str:
        return f"<ReducedForm {self.system}: rank {self.rank} of {len(self.columns)} columns>"

    @property
    def row_names(self) -> list[str]:
        """The column of the one in each row."""
        return [self.columns[j] for j in self.pivots]
