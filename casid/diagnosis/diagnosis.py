"""The diagnosis: verdict, causes, alternatives, gain, and everything a report shows of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

from casid.deprecation import renamed
from casid.diagnosis.advice.isolability import Isolability
from casid.diagnosis.advice.next_experiment import Proposal
from casid.diagnosis.advice.undetectable import Undetectable
from casid.diagnosis.calibration.calibration import Calibration
from casid.diagnosis.evidence.disturbances import Disturbance
from casid.diagnosis.unexplained.description import Unexplained
from casid.diagnosis.verdict.cause import Alternative, Cause, Ranked, Verdict
from casid.diagnosis.verdict.remainder import Moved, Remaining
from casid.estimation.estimate import Estimate, Origin, RecordView, measure_in
from casid.estimation.fitted.fitted_model import FittedModel
from casid.grouping import Grouped
from casid.model.effects.effect import OF_SAMPLES
from casid.presentation import Presented, present, write
from casid.saving.saved import Saved

__all__ = [
    "Alternative",
    "Cause",
    "Diagnosis",
    "Disturbance",
    "Evidence",
    "Gain",
    "Limits",
    "Ranked",
    "Verdict",
]


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The fits before and after, and the noise found."""

    baseline: Estimate
    extended: Estimate | None
    records: tuple[RecordView, ...]
    noise: Mapping[str, str] = field(default_factory=dict)  # channel -> sentence
    disturbances: tuple[Disturbance, ...] = ()  # random forces that nobody recorded


@dataclass(frozen=True, slots=True, eq=False)
class Gain:
    """The errors before and after including the causes, and the remainder."""

    fitted: Mapping[str, Mapping[str, float]]  # baseline_rmse, extended_rmse -> output -> value
    held_out: Mapping[str, Mapping[str, float]]  # ... and noise_floor
    moved: tuple[Moved, ...] = ()  # parameters that the missing causes had biased
    remaining: Remaining | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Limits:
    """Limits of a diagnosis: reasons for doubt, and effects that the records cannot show."""

    false_alarm_rate: float = 0.05
    notes: tuple[str, ...] = ()
    unexplained: Unexplained | None = None  # what a cause of kind "unknown" looks like
    isolability: Isolability | None = None
    undetectable: tuple[Undetectable, ...] = ()
    calibration: Calibration | None = None  # false alarms counted on simulated records
    not_done: tuple[str, ...] = ()  # what the budget of time left no room for
    not_accepted: tuple[str, ...] = ()  # the notes on effects that are significant, and no causes
    invisible = renamed("invisible", "undetectable")


@dataclass(frozen=True, slots=True, eq=False)
class Diagnosis(Presented, Saved):
    """What the simulation gets wrong, why, and what including the cause gains.

    Every field of `evidence`, `gain`, `limits` and `origin` is an attribute of the diagnosis, too.
    """

    problem: str
    verdict: Verdict
    sentence: str
    causes: tuple[Cause, ...]
    ranking: tuple[Ranked, ...]
    evidence: Evidence
    gain: Gain
    advice: str
    remainders: tuple[Cause, ...] = ()  # significant, but too small a share of the misfit to matter
    proposals: tuple[Proposal, ...] = ()  # next experiments, the best first
    limits: Limits = Limits()
    origin: Origin = Origin()
    settings: Mapping[str, str] = field(default_factory=dict)  # of the diagnosis, in words

    baseline: ClassVar[Grouped[Estimate]] = Grouped("evidence")  # Fit of the model as it is
    extended: ClassVar[Grouped[Estimate | None]] = Grouped("evidence")
    records: ClassVar[Grouped[tuple[RecordView, ...]]] = Grouped("evidence")
    noise: ClassVar[Grouped[Mapping[str, str]]] = Grouped("evidence")
    disturbances: ClassVar[Grouped[tuple[Disturbance, ...]]] = Grouped("evidence")
    fitted: ClassVar[Grouped[Mapping[str, Mapping[str, float]]]] = Grouped("gain")
    held_out: ClassVar[Grouped[Mapping[str, Mapping[str, float]]]] = Grouped("gain")
    moved: ClassVar[Grouped[tuple[Moved, ...]]] = Grouped("gain")
    remaining: ClassVar[Grouped[Remaining | None]] = Grouped("gain")
    false_alarm_rate: ClassVar[Grouped[float]] = Grouped("limits")
    notes: ClassVar[Grouped[tuple[str, ...]]] = Grouped("limits")  # What bears on the trust in it
    unexplained: ClassVar[Grouped[Unexplained | None]] = Grouped("limits")
    isolability: ClassVar[Grouped[Isolability | None]] = Grouped("limits")
    undetectable: ClassVar[Grouped[tuple[Undetectable, ...]]] = Grouped("limits")
    invisible = renamed("invisible", "undetectable")
    calibration: ClassVar[Grouped[Calibration | None]] = Grouped("limits")
    not_done: ClassVar[Grouped[tuple[str, ...]]] = Grouped("limits")
    not_accepted: ClassVar[Grouped[tuple[str, ...]]] = Grouped("limits")
    provenance: ClassVar[Grouped[tuple[str, ...]]] = Grouped("origin")
    versions: ClassVar[Grouped[Mapping[str, str]]] = Grouped("origin")
    sources: ClassVar[Grouped[tuple[str, ...]]] = Grouped("origin")

    def in_units(self, units: Mapping[str, str]) -> Diagnosis:
        """The diagnosis with every number of what `units` names in that unit.

        Parameters
        ----------
        units : parameter, state, input or output -> unit of its dimension.
        """
        if not units:
            return self
        before = self.output_units
        after = {name: units.get(name, unit) for name, unit in before.items()}
        extended = None if self.extended is None else self.extended.in_units(units)
        return replace(
            self,
            causes=tuple(c.in_units(units) for c in self.causes),
            remainders=tuple(c.in_units(units) for c in self.remainders),
            evidence=replace(
                self.evidence,
                baseline=self.baseline.in_units(units),
                extended=extended,
                records=tuple(r.in_units(units) for r in self.records),
                disturbances=tuple(d.in_units(units) for d in self.disturbances),
            ),
            gain=replace(
                self.gain,
                fitted=measure_in(self.fitted, before, after),
                held_out=measure_in(self.held_out, before, after),
                moved=tuple(m.in_unit(units.get(m.name, m.unit)) for m in self.moved),
            ),
        )

    def to_json(self) -> dict[str, Any]:
        """The content of `diagnosis.json` (schema casid.diagnosis/1)."""
        return {
            "schema": "casid.diagnosis/1",
            "problem": self.problem,
            "verdict": self.verdict,
            "sentence": self.sentence,
            "causes": [c.to_json() for c in self.causes],
            "remainders": [c.to_json() for c in self.remainders],
            "disturbances": [d.to_json() for d in self.disturbances],
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
            "invisible": [i.to_json() for i in self.undetectable],
            "proposals": [p.to_json() for p in self.proposals],
            "calibration": _plain(self.calibration),
            "not_done": list(self.not_done),
        }

    def __repr__(self) -> str:
        named = ", ".join(f"{c.kind}({c.where})" for c in self.causes) or "no cause"
        return f"<Diagnosis {self.problem}: {self.verdict}, {named}>"

    @property
    def model(self) -> FittedModel | None:
        """The extended model with its fitted values; where nothing was added, the model as it is.

        Spoilt samples (`outliers`, `saturation`) were left out of the fit and are no part of it.
        """
        return (self.extended or self.baseline).model

    @property
    def extends_by_nearest(self) -> bool:
        """True where the extended model has the nearest effect of the catalogue, and none is named.

        The cause is then `unknown`, and what the model has stands among its alternatives.
        """
        kinds = [c.kind for c in self.causes if c.kind not in OF_SAMPLES]
        return self.extended is not None and bool(kinds) and set(kinds) == {"unknown"}

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
