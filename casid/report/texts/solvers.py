"""A comparison of solvers as a document."""

from __future__ import annotations

from casid.estimation.nlp.comparison_table import SolverComparison
from casid.report.document import Document, Table


def solver_document(comparison: SolverComparison) -> Document:
    """One row a solver; below, why those that disagree do."""
    c = comparison
    head, *rows = c.cells()
    objective = f", objective {c.objective:.10g}" if c.is_feasible else ""
    return Document(
        f"{c.problem}: {len(c.names)} variables; reference: {c.reference_from}{objective}",
        [
            Table(head, rows, numbers=range(1, 7)),
            f"  {len(c.agreeing)} of {len(c.rows)} agree with the reference within "
            f"{c.tolerance:g} relative",
            *(f"  {row.solver}: {row.reason}" for row in c.rows if row.reason),
        ],
    )
