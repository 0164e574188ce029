"""An investigation as a document, for the terminal and as parts of its page."""

from __future__ import annotations

from casid.diagnosis.investigation import Investigation
from casid.model.quantities import count_text
from casid.report.document import Code, Document, Part, Table, labelled


def investigation_document(found: Investigation) -> Document:
    """What each diagnosis said, what was designed after it, and why it ended."""
    parts: list[Part] = []
    for i, diagnosis in enumerate(found.diagnoses):
        parts += labelled(_records(found, i), [diagnosis.sentence])
        if i < len(found.designs):
            parts += labelled("designed", [found.designs[i].sentence])
    return Document(f"Investigation of {found.problem}: {found.ending}", parts)


def step_table(found: Investigation) -> Table:
    """A row a diagnosis or design, with its folder."""
    rows: list[tuple[str, str, Code]] = []
    for i, diagnosis in enumerate(found.diagnoses):
        folder = Code(f"diagnosis-{i + 1}")
        rows.append((f"diagnosis of {_records(found, i)}", diagnosis.sentence, folder))
        if i < len(found.designs):
            design = found.designs[i]
            rows.append((f"design to {design.aim}", design.sentence, Code(f"design-{i + 1}")))
    return Table(("step", "answer", "folder"), rows)


def _records(found: Investigation, step: int) -> str:
    count = len(found.records) - len(found.diagnoses) + 1 + step
    return count_text(count, "record")
