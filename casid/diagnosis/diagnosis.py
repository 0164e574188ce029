"""The diagnosis: verdict, causes, alternatives, gain, and everything a report shows of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from casid.diagnosis.verdict.remainder import Moved, Remaining
from casid.estimation.estimate import Estimate, Estimated, RecordView
from casid.presentation import Presented, present, write

if TYPE_CHECKING:
    from casid.diagnosis.advice.isolability import Isolability
    from casid.diagnosis.advice.next_experiment import Proposal
    from casid.diagnosis.advice.undetectable import Invisible
    from casid.diagnosis.calibration.false_alarm_rate import Calibration
    from casid.diagnosis.unexplained.description import Unexplained

Verdict = Literal["adequate", "deficient", "undecided"]


@dataclass(frozen=True, slots=True)
class Alternative:
    """A kind that this record cannot reject against the named one."""

    kind: str
    where: str
    p_value: float
    why: str
    description: str = ""  # what it is like where the catalogue has no name: kind "unknown"

    @property
    def name(self) -> str:
        """Kind and place; what has no name, with its description."""
        like = f" ({self.description})" if self.kind == "unknown" and self.description else ""
        return f"{self.kind} in {self.where}{like}"

    def to_json(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        return {
            "kind": self.kind,
            "where": self.where,
            "p_value": self.p_value,
            "why": self.why,
            "description": self.description,
        }


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
    description: str = ""  # what is known of it where the catalogue has no name: kind "unknown"
    by_record: Mapping[str, Mapping[str, Estimated]] = field(default_factory=dict, hash=False)
    # record -> parameter -> value; empty where one value explains all records

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
            "description": self.description,
            "by_record": {
                record: {
                    n: {"value": p.value, "std_error": p.std_error, "unit": p.unit}
                    for n, p in values.items()
                }
                for record, values in self.by_record.items()
            },
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
class Diagnosis(Presented):
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
    moved: tuple[Moved, ...] = ()  # parameters that the missing causes had biased
    remaining: Remaining | None = None
    unexplained: Unexplained | None = None  # what a cause of kind "unknown" looks like
    isolability: Isolability | None = None
    invisible: tuple[Invisible, ...] = ()
    proposals: tuple[Proposal, ...] = ()  # next experiments, the best first
    calibration: Calibration | None = None  # false alarms counted on simulated records

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
            "moved": [m.to_json() for m in self.moved],
            "remaining": _plain(self.remaining),
            "unexplained": _plain(self.unexplained),
            "isolability": _plain(self.isolability),
            "invisible": [i.to_json() for i in self.invisible],
            "proposals": [p.to_json() for p in self.proposals],
            "calibration": _plain(self.calibration),
        }

    def __repr__(self) -> str:
        named = ", ".join(f"{c.kind}({c.where})" for c in self.causes) or "no cause"
        return f"<Diagnosis {self.problem}: {self.verdict}, {named}>"

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The fits by label: baseline alone, or before and after."""
        if self.extended is None:
            return {"baseline": self.baseline}
        return {"before": self.baseline, "after": self.extended}

    @property
    def output_units(self) -> dict[str, str]:
        """Unit of every output that a record or the baseline names."""
        units = {str(k): str(v) for k, v in self.baseline.units.items()}
        for v in self.records:
            units |= dict(zip(v.outputs, v.output_units, strict=True))
        return units

    def plot(self) -> Any:
        """Measured against simulated, before and after, as a Plotly figure."""
        return present(self, "figure")

    def figures(self) -> Mapping[str, Any]:
        """Every figure of the report by name."""
        found: Mapping[str, Any] = present(self, "figures")
        return found

    def references(self) -> tuple[str, ...]:
        """The papers behind the methods used."""
        return self.sources

    def write(self, folder: str | Path) -> Path:
        """Write `diagnosis.json` and `report.html` into `folder`; returns the report's path."""
        return write(self, folder)


def _plain(part: Any) -> Any:
    return None if part is None else part.to_json()
