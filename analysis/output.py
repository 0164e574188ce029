"""Where the tables and figures of a study go."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass
class Output:
    """Where tables and figures go, made where it is not there; nothing is written without one."""

    folder: Path | None

    def __post_init__(self) -> None:
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)

    def table(self, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """Write rows as CSV."""
        if self.folder is None:
            return
        with (self.folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)

    def figure(self, name: str, figure: Any) -> None:
        """Write a Plotly figure as a page."""
        if self.folder is not None:
            figure.write_html(self.folder / f"{name}.html", include_plotlyjs="directory")


def titled(figure: Any, title: str, height: int) -> Any:
    """A Plotly figure with its title, which is its caption too, `height` pixels high."""
    figure.update_layout(
        title={"text": title, "font": {"size": 15}},
        height=height,
        width=1100,
        template="plotly_white",
        meta={"caption": title},
    )
    return figure
