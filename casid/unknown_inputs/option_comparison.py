"""The options for one unknown input side by side, as fitted to the same records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casid.errors import UnknownNameError
from casid.estimation.estimate import Estimate
from casid.presentation import Presented


@dataclass(frozen=True, slots=True, eq=False)
class OptionRow:
    """One option: what it estimates, how well it predicts, and whether it can be trusted."""

    option: str
    letter: str  # (A), (B) or (C) of 7.3
    estimate: Estimate | None  # None where the option failed: `remark` says why
    parameters: tuple[str, ...]
    error: Mapping[str, float]  # parameter -> estimate minus truth, empty where no truth is given
    prediction_rms: Mapping[str, float]  # output -> rms of the one-step prediction error
    is_consistent: bool
    remark: str

    def value(self, name: str) -> float:
        """The estimate of a parameter; NaN where the option failed."""
        return float("nan") if self.estimate is None else self.estimate[name]

    def std_error(self, name: str) -> float:
        """Standard error of the estimate; NaN where there is none."""
        found = None if self.estimate is None else self.estimate.parameter(name).std_error
        return float("nan") if found is None else found


@dataclass(frozen=True, slots=True, eq=False)
class UnknownInputComparison(Presented):
    """The options for one unknown input on the same records."""

    model: str
    unknown: str
    parameters: tuple[str, ...]
    units: Mapping[str, str]
    truth: Mapping[str, float]
    outputs: tuple[str, ...]
    rows: tuple[OptionRow, ...]

    def __getitem__(self, option: str) -> OptionRow:
        """The row of an option, by its name."""
        for row in self.rows:
            if row.option == option:
                return row
        raise UnknownNameError(
            f"no option {option!r}; there are {', '.join(r.option for r in self.rows)}"
        )

    def cells(self) -> tuple[list[str], list[list[str]]]:
        """Heads and rows of the table, as text."""
        heads = ["option"]
        for name in self.parameters:
            heads.append(f"{name} [{self.units[name]}]")
            if name in self.truth:
                heads.append("error")
        heads += [f"rms {o}" for o in self.outputs]
        rows = []
        for row in self.rows:
            cells = [f"({row.letter}) {row.option}"]
            for name in self.parameters:
                value, sd = row.value(name), row.std_error(name)
                spread = "(at bound)" if np.isnan(sd) else f"+- {sd:.2g}"
                cells.append("--" if np.isnan(value) else f"{value:.5g} {spread}")
                if name in self.truth:
                    cells.append(f"{row.error[name]:+.2g}" if name in row.error else "--")
            for output in self.outputs:
                rms = row.prediction_rms.get(output)
                cells.append("--" if rms is None else f"{rms:.4g}")
            rows.append(cells)
        return heads, rows

    def __repr__(self) -> str:
        return f"<UnknownInputComparison {self.model}/{self.unknown}: {len(self.rows)} options>"
