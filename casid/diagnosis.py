"""The diagnosis: verdict, causes, alternatives, gain, and everything a report shows of them."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from casid.estimate import Estimate, Estimated, RecordView

Array = np.ndarray[Any, Any]
Verdict = Literal["adequate", "deficient", "undecided"]


@dataclass(frozen=True, slots=True)
class Alternative:
    """A kind that this record cannot reject against the named one."""

    kind: str
    where: str
    p_value: float
    why: str

    def to_json(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        return {"kind": self.kind, "where": self.where, "p_value": self.p_value, "why": self.why}


@dataclass(frozen=True, slots=True)
class Cause:
    """An effect that the data require and the model lacked."""

    kind: str
    where: str
    p_value: float  # family-wise
    parameters: tuple[Estimated, ...]
    alternatives: tuple[Alternative, ...] = ()
    share: float = 0.0  # of the misfit removed, 0..1
    sentence: str = ""

    def to_json(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        return {
            "kind": self.kind,
            "where": self.where,
            "p_value": self.p_value,
            "parameters": {
                p.name: {"value": p.value, "std_error": p.std_error, "unit": p.unit}
                for p in self.parameters
            },
            "alternatives": [a.to_json() for a in self.alternatives],
            "share": self.share,
            "sentence": self.sentence,
        }


@dataclass(frozen=True, slots=True)
class Ranked:
    """One candidate of the catalogue as the first round saw it."""

    kind: str
    where: str
    p_value: float  # of this candidate alone
    adjusted: float  # family-wise
    gain: float | None  # fall of the criterion after a refit, None where it was not refitted
    status: str  # "named", "cannot be rejected", "rejected", "not significant", "invisible"
    why: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis:
    """What the simulation gets wrong, why, and what naming the cause gains."""

    problem: str
    verdict: Verdict
    sentence: str
    causes: tuple[Cause, ...]
    ranking: tuple[Ranked, ...]
    baseline: Estimate
    extended: Estimate | None
    records: tuple[RecordView, ...]
    fitted: Mapping[str, Mapping[str, float]]  # baseline_rmse, extended_rmse -> output -> value
    held_out: Mapping[str, Mapping[str, float]]  # ... and noise_floor
    advice: str
    noise: Mapping[str, str] = field(default_factory=dict)  # channel -> sentence
    false_alarm_rate: float = 0.05
    notes: tuple[str, ...] = ()
    provenance: tuple[str, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    sources: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The content of `diagnosis.json` (schema casid.diagnosis/1)."""
        return {
            "schema": "casid.diagnosis/1",
            "problem": self.problem,
            "verdict": self.verdict,
            "sentence": self.sentence,
            "causes": [c.to_json() for c in self.causes],
            "fitted": {k: dict(v) for k, v in self.fitted.items()},
            "held_out": {k: dict(v) for k, v in self.held_out.items()},
            "advice": self.advice,
            "ranking": [
                {
                    "kind": r.kind,
                    "where": r.where,
                    "p_value": r.p_value,
                    "adjusted_p_value": r.adjusted,
                    "gain": r.gain,
                    "status": r.status,
                    "why": r.why,
                }
                for r in self.ranking
            ],
            "baseline": self.baseline.to_json(),
            "extended": self.extended.to_json() if self.extended is not None else None,
            "noise": dict(self.noise),
            "false_alarm_rate": self.false_alarm_rate,
            "notes": list(self.notes),
            "provenance": list(self.provenance),
            "settings": dict(self.settings),
            "versions": dict(self.versions),
        }

    def __repr__(self) -> str:
        named = ", ".join(f"{c.kind}({c.where})" for c in self.causes) or "no cause"
        return f"<Diagnosis {self.problem}: {self.verdict}, {named}>"

    def __str__(self) -> str:
        lines = [f"Diagnosis of {self.problem}: {self.verdict}", f"  {self.sentence}"]
        for i, c in enumerate(self.causes, 1):
            values = ", ".join(
                f"{p.name} = {p.value:.4g}"
                + (f" +- {p.std_error:.2g}" if p.std_error is not None else "")
                + f" {p.unit}"
                for p in c.parameters
            )
            lines.append(f"  {i}. {c.kind} in {c.where} (p = {c.p_value:.1e}): {values}")
            for a in c.alternatives:
                lines.append(f"     or {a.kind} in {a.where} (p = {a.p_value:.2g}): {a.why}")
        lines.append(
            f"  {'rms error':<22}{'output':<14}{'before':>12}{'after':>12}{'noise floor':>13}"
        )
        for label, part in (("fitted", self.fitted), ("held out", self.held_out)):
            for output, before in part.get("baseline_rmse", {}).items():
                after = part.get("extended_rmse", {}).get(output)
                floor = part.get("noise_floor", {}).get(output)
                lines.append(
                    f"  {label:<22}{output:<14}{before:>12.4g}"
                    f"{'' if after is None else format(after, '.4g'):>12}"
                    f"{'' if floor is None else format(floor, '.4g'):>13}"
                )
        lines += [f"  noise         {k}: {v}" for k, v in self.noise.items()]
        lines += [f"  note          {n}" for n in self.notes]
        lines.append(f"  advice        {self.advice}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"

    def plot(self) -> Any:
        """Measured against simulated, before and after, as a Plotly figure."""
        from casid.plotting import simulation_figure

        return simulation_figure(self)

    def figures(self) -> Mapping[str, Any]:
        """Every figure of the report by name."""
        from casid.plotting import diagnosis_figures

        return diagnosis_figures(self)

    def references(self) -> tuple[str, ...]:
        """The papers behind the methods used."""
        return self.sources

    def write(self, folder: Path) -> Path:
        """Write `diagnosis.json` and `report.html` into `folder`; returns the report's path."""
        from casid.report import diagnosis_page
        from casid.writing import write_json, write_text

        page = diagnosis_page(self)  # before anything is written: both files or none
        write_json(folder / "diagnosis.json", self.to_json())
        return write_text(folder / "report.html", page)
