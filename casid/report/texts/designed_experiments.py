"""A designed experiment as a document, for the terminal and as parts of its page."""

from __future__ import annotations

from math import isfinite

from scipy.stats import binomtest

from casid.experiment_design.designed_experiment import (
    DesignedExperiment,
    LimitUse,
    Outcome,
    Standard,
    words_of,
)
from casid.experiment_design.thresholds import DESIGN
from casid.report.document import Document, Part, Table, labelled
from casid.report.numbers import number_text, share_text, value_text


def design_document(found: DesignedExperiment) -> Document:
    """What is designed, what it is predicted to show, and what it gains."""
    title = f"Experiment designed for {found.problem}, to {found.aim}"
    parts: list[Part] = [
        found.sentence,
        outcome_table(found),
        learned_table(found),
        standard_table(found),
        limit_table(found),
        *labelled("begins at", [start_text(found)] if any(found.initial.values()) else []),
        *labelled("note", found.notes),
    ]
    return Document(title, [p for p in parts if not isinstance(p, Table) or p.rows])


def outcome_table(found: DesignedExperiment) -> Table:
    """A row a truth and its rival."""
    is_diagnosed = any(o.diagnosed is not None for o in found.outcomes)
    rows = [
        (
            *(
                words_of(found, o.truth) + ("" if o.size is None else f" of {o.size:.3g}"),
                words_of(found, o.rival),
                number_text(o.energy),
                share_text(o.power),
                share_text(o.standard),
            ),
            *([f"{o.right} of {o.runs}"] if o.runs else []),
            *([_diagnosed(o)] if is_diagnosed else []),
        )
        for o in found.outcomes
    ]
    head = ["if the truth is", "rival", "misfit energy", "power", "best standard"]
    head += ["right in simulation"] if any(o.runs for o in found.outcomes) else []
    head += ["right diagnoses"] if is_diagnosed else []
    caption = (
        "Energy in units of the noise that the rival's best fit leaves, and the probability of "
        "the right answer"
    )
    return Table(head, rows, numbers=range(2, len(head)), caption=caption)


def _diagnosed(o: Outcome) -> str:
    """Right diagnoses with the 95 % interval of their share (Clopper and Pearson 1934)."""
    if o.diagnosed is None:
        return ""
    low, high = binomtest(o.diagnosed, o.runs).proportion_ci(0.95)
    return f"{o.diagnosed} of {o.runs} ({100 * low:.3g} .. {100 * high:.3g} %)"


def learned_table(found: DesignedExperiment) -> Table:
    """A row a parameter."""
    rows = [
        (p.name, p.unit, value_text(p.value), _error(p.std_error), _error(p.standard))
        for p in found.parameters
    ]
    head = ("parameter", "unit", "value", "std. error", "best standard")
    return Table(
        head, rows, numbers=(2, 3, 4), caption="Expected standard errors of the parameters"
    )


def standard_table(found: DesignedExperiment) -> Table:
    """A row a kind of standard input."""
    rows = [(s.description, _information(s), _records(s)) for s in found.standards]
    head = ("standard input", "information", "records for the same")
    caption = "The best of each kind under the same limits, relative to the designed input"
    return Table(head, rows, numbers=(1, 2), caption=caption)


def _information(s: Standard) -> str:
    return f"{s.information:.3g}" if s.information > DESIGN.nothing else "none"


def _records(s: Standard) -> str:
    return f"{1 / s.information:.3g}" if s.information > DESIGN.nothing else "never"


def limit_table(found: DesignedExperiment) -> Table:
    """A row a limit."""
    rows = [(u.name, u.unit, _span(u.lower, u.upper), _span_used(u)) for u in found.limits]
    head = ("limit of", "unit", "allowed", "taken")
    return Table(head, rows, caption="Limits, and what the experiment takes of them")


def start_text(found: DesignedExperiment) -> str:
    """The state that the experiment begins at."""
    units = found.units
    return ", ".join(f"{n} = {v:.5g} {units.get(n, '')}".rstrip() for n, v in found.initial.items())


def _span(low: float, high: float) -> str:
    if not isfinite(low):
        return f"up to {number_text(high)}"
    return f"from {number_text(low)}" if not isfinite(high) else f"{low:.6g} .. {high:.6g}"


def _span_used(use: LimitUse) -> str:
    return f"{use.lowest:.5g} .. {use.highest:.5g}"


def _error(error: float | None) -> str:
    return "\u2013" if error is None else f"{error:.2g}"
