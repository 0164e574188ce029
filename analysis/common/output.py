"""Where the tables and figures of a study go."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from casid.diagnosis.diagnosis import Diagnosis


@dataclass
class Output:
    """Where tables and figures go, made where it is not there; nothing is written without one."""

    folder: Path | None

    def __post_init__(self) -> None:
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)

    def table(self, name: str, rows: Sequence[Any]) -> None:
        """Write rows, mappings or dataclasses, as CSV."""
        if self.folder is None:
            return
        plain = [dict(r) if isinstance(r, Mapping) else asdict(r) for r in rows]
        with (self.folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(plain[0]))
            writer.writeheader()
            writer.writerows(plain)

    def figure(self, name: str, figure: Any) -> None:
        """Write a Plotly figure as a page."""
        if self.folder is not None:
            figure.write_html(self.folder / f"{name}.html", include_plotlyjs="directory")

    def report(self, name: str, diagnosis: Diagnosis) -> None:
        """Write the report of a diagnosis into a folder."""
        if self.folder is not None:
            (self.folder / name).mkdir(exist_ok=True)
            diagnosis.write(self.folder / name)

    def json(self, name: str, content: Any) -> None:
        """Write plain data as JSON."""
        if self.folder is not None:
            text = json.dumps(content, indent=1) + "\n"
            (self.folder / f"{name}.json").write_text(text, encoding="utf-8")


def aligned(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Lines of aligned columns, the first to the left and all others to the right."""
    lines = [tuple(head), *(tuple(row) for row in rows)]
    if len(lines) == 1:
        return ""
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
