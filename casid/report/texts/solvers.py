"""Solutions of nonlinear programs, and a comparison of solvers, as documents."""

from __future__ import annotations

from casid.estimation.nlp.comparison_table import SolverComparison
from casid.estimation.nlp.solution import Solution
from casid.model.quantities import count_text
from casid.report.document import Document, Part, Table


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


def solution_document(solution: Solution) -> Document:
    """Status, every variable, what the optimum rests on, and what to try where there is none."""
    s, active = solution, solution.active
    parts: list[Part] = [
        (name, f"= {value:.8g}" + (f"  at its {active[name]} bound" if name in active else ""))
        for name, value in zip(s.names, s.x, strict=True)
    ]
    parts.append(f"  value {s.value:.8g}, scaled gradient {s.scaled_gradient:.1e}")
    count = len(s.constraint_jacobian)
    if count:
        largest = f"largest violation {s.constraint_violation:.1e}"
        parts.append(f"  {count_text(count, 'constraint')}, {largest}")
    if not s.is_converged:
        parts.append(f"  remedy: {s.remedy}")
    title = f"{'Converged' if s.is_converged else 'Not converged'}: {s.account}"
    return Document(title, parts, label=max(map(len, s.names), default=0) + 1)
