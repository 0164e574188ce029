"""A designed experiment: the input, what it is predicted to show, and what it gains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite, sqrt
from pathlib import Path
from types import MappingProxyType
from typing import Any

from scipy.optimize import brentq
from scipy.stats import binomtest, chi2, ncx2, norm

from casid.data.files import plain, plain_fields
from casid.data.reading.columns import ColumnSpec
from casid.data.record import Record
from casid.data.record_files import write_record
from casid.experiment_design.aim import Aim
from casid.experiment_design.thresholds import DESIGN
from casid.model.effects.names import effect_words
from casid.presentation import Presented, present, write
from casid.saving.saved import Saved

SOURCES = (
    "A. C. Atkinson and V. V. Fedorov, The design of experiments for discriminating between two "
    "rival models, Biometrika 62 (1975) 57-70",
    "G. C. Goodwin and R. L. Payne, Dynamic System Identification: Experiment Design and Data "
    "Analysis, Academic Press 1977",
    "J. Kiefer, General equivalence theory for optimum designs, Ann. Statist. 2 (1974) 849-879",
    "H. G. Bock and K. J. Plitt, A multiple shooting algorithm for direct solution of optimal "
    "control problems, IFAC World Congress 1984",
    "Q. H. Vuong, Likelihood ratio tests for model selection and non-nested hypotheses, "
    "Econometrica 57 (1989) 307-333",
)


def probability_of_right_name(energy: float, alone: float = inf) -> float:
    """Probability that the truth fits better than a rival whose best fit misses by this energy.

    Parameters
    ----------
    energy : lambda, left of the truth where the rival is fitted, noise of unit variance.
    alone : left where no cause is fitted at all; large where the rival imitates the truth well.

    With theta the angle between what the two causes do (all other parameters fitted), lambda is
    `alone` sin^2 theta, and the difference of the sums of squares is a product of two independent
    normal numbers of mean sqrt(lambda) and variances 2 (1 -+ cos theta). The truth is named where
    both have one sign. For small angles this is Phi(sqrt(lambda) / 2) (Vuong 1989).
    """
    root = sqrt(max(energy, 0.0))
    cosine = sqrt(max(1.0 - energy / alone, 0.0)) if alone > 0 else 0.0
    wide = float(norm.cdf(root / sqrt(2 * (1 + cosine))))
    narrow = float(norm.cdf(root / sqrt(2 * (1 - cosine)))) if cosine < 1 else 1.0
    return wide * narrow + (1 - wide) * (1 - narrow)


def probability_of_detection(energy: float, false_alarm_rate: float) -> float:
    """Power of the likelihood-ratio test of one parameter, noncentral chi^2 with one degree."""
    limit = chi2.isf(false_alarm_rate, 1)
    return float(ncx2.sf(limit, 1, max(energy, 0.0)))


def energy_for_name(power: float) -> float:
    """The energy at which the right name has this probability."""
    return float((2 * norm.ppf(power)) ** 2)


def energy_for_detection(power: float, false_alarm_rate: float) -> float:
    """The energy at which a detection has this power."""
    top = (norm.isf(0.5 * false_alarm_rate) + norm.ppf(power) + 1.0) ** 2
    return float(brentq(lambda e: probability_of_detection(e, false_alarm_rate) - power, 0.0, top))


_TIMES = {"s": (1.0, 1e4), "h": (3600.0, 172_800.0), "days": (86_400.0, 3.2e9)}
# Unit -> its length, and up to where times are given in it [s]: two days, a century.


def time_text(seconds: float) -> str:
    """A duration in words: seconds, hours or days."""
    for unit, (length, longest) in _TIMES.items():
        if seconds < longest:
            return f"{seconds / length:.4g} {unit}"
    return "more than a century" if isfinite(seconds) else "never"


FITTED = ", fitted to "
"""Between a rival and the truth that its predicted record is fitted to."""


def hypothesis_words(name: str, laws: Mapping[str, str] = MappingProxyType({})) -> str:
    """A hypothesis in words: `cubic_damping in force, fitted to ...`, as records are named.

    Parameters
    ----------
    laws : cause, named likewise -> what it is called by beside its kind (`law_of`).
    """
    return FITTED.join(_cause_words(part, laws.get(part, "")) for part in name.split(FITTED))


def _cause_words(name: str, law: str) -> str:
    kind, _, at = name.partition(" in ")
    return effect_words(kind, at, description=law) if at else kind


def words_of(found: DesignedExperiment, name: str) -> str:
    """A hypothesis of a design in words, by its name in records and outcomes."""
    return hypothesis_words(name, found.details.get("laws", {}))


@dataclass(frozen=True, slots=True)
class Outcome:
    """A cause as the truth, and the rival that would be fitted to its record.

    Attributes
    ----------
    energy : sum of squares, in units of the noise, that the rival's best fit leaves.
    alone : the same of a fit without any cause; 0 of a detection, whose rival that is.
    power : probability that the record names the truth (of a detection: an alarm).
    standard : the same probability in the best standard input.
    right, runs : of so many simulated records, those that the truth fits better than the rival (of
        a detection: with an alarm); 0 of 0 where none were simulated.
    diagnosed : of these, those whose whole diagnosis names the truth before the rival; None where
        none was diagnosed.
    size : value of the truth's first parameter, SI, where the design counts on several.
    """

    truth: str
    rival: str
    energy: float
    power: float
    standard: float
    right: int = 0
    runs: int = 0
    alone: float = 0.0
    diagnosed: int | None = None
    size: float | None = None

    @property
    def counted(self) -> int:
        """Records in which the truth was named: by diagnoses, where these were made, or by fits."""
        return self.right if self.diagnosed is None else self.diagnosed

    @property
    def agreement(self) -> float | None:
        """p-value of the count against the predicted power: that of diagnoses, else of fits."""
        if not self.runs:
            return None
        return float(binomtest(self.counted, self.runs, min(self.power, 1.0)).pvalue)

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return plain_fields(self)


@dataclass(frozen=True, slots=True)
class Learned:
    """What the experiment is expected to determine of one parameter, in `unit`.

    Attributes
    ----------
    std_error, standard : expected in the designed and in the best standard input; None where the
        record does not determine it.
    """

    name: str
    unit: str
    value: float
    std_error: float | None
    standard: float | None

    @property
    def is_determined(self) -> bool:
        """True where the standard error is smaller than the value."""
        return self.std_error is not None and self.std_error <= (abs(self.value) or inf)

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return plain_fields(self)


@dataclass(frozen=True, slots=True)
class LimitUse:
    """A limit and how far it is used at ten times the sampling rate, in `unit`."""

    name: str
    unit: str
    lower: float
    upper: float
    lowest: float
    highest: float

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return plain_fields(self)


@dataclass(frozen=True, slots=True)
class Standard:
    """The best of one kind of standard inputs under the same limits.

    Attributes
    ----------
    information : relative to the designed input's; of misfits, the ratio of energies, rivals fitted
        to what each would show.
    seconds : of it that decide as much as the designed record, in repeated records of that length.
        One record that long may decide sooner: in short ones most goes into nuisance parameters.
    """

    kind: str
    description: str
    information: float
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return plain_fields(self)


@dataclass(frozen=True, slots=True)
class SolverEvidence:
    """How the design was found.

    Attributes
    ----------
    seconds : of the processor, for all of it.
    steps : Runge-Kutta steps an interval of the program.
    """

    begun_from: str
    candidates: int
    iterations: int
    steps: int
    seconds: float
    seed: int

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return plain_fields(self)


@dataclass(frozen=True, slots=True, eq=False)
class DesignedExperiment(Presented, Saved):
    """An input under limits, with the outputs and the power that are predicted of it.

    Attributes
    ----------
    records : name of a hypothesis -> what it would record without noise: inputs, outputs, SI. The
        first is what is written to CSV.
    inputs : names of the designed inputs.
    initial : state -> initial value, in its declared unit; those released are chosen.
    noise : output -> standard deviation, SI.
    outcomes : of causes; `parameters` : of what is estimated.
    gain : information over that of the best standard input: the same decision takes so many records
        of that one, each of this duration.
    units : channel -> declared unit.
    """

    problem: str
    aim: Aim
    duration: float
    records: Mapping[str, Record]
    inputs: tuple[str, ...]
    initial: Mapping[str, float]
    noise: Mapping[str, float]
    outcomes: tuple[Outcome, ...]
    parameters: tuple[Learned, ...]
    standards: tuple[Standard, ...]
    gain: float
    limits: tuple[LimitUse, ...]
    solver: SolverEvidence
    units: Mapping[str, str] = field(default_factory=dict)
    details: Mapping[str, Any] = field(default_factory=dict)  # notes, hold, laws, versions

    @property
    def record(self) -> Record:
        """Inputs and predicted outputs of the first hypothesis, SI."""
        return next(iter(self.records.values()))

    @property
    def power(self) -> float:
        """Smallest probability of the right answer; 1 where parameters are estimated."""
        return min((o.power for o in self.outcomes), default=1.0)

    @property
    def is_enough(self) -> bool:
        """True where the right answer is as probable as a design is to make it."""
        return self.power >= DESIGN.power

    @property
    def is_held(self) -> bool:
        """True if the designed inputs are constant between their samples."""
        return self.details.get("hold") == "zoh"

    @property
    def notes(self) -> tuple[str, ...]:
        """What bears on the trust in it."""
        return tuple(self.details.get("notes", ()))

    @property
    def sentence(self) -> str:
        """The answer in words."""
        text = time_text(self.duration)
        if self.outcomes:
            what = "detects the cause" if self.aim.kind == "detect" else "names the right cause"
            text = f"A record of {text} {what} with a probability of {100 * self.power:.3g} %"
            if not self.is_enough:
                return f"{text}; {self._sufficient_duration}."
        elif self.aim.kind == "identifiable":
            text = (
                f"A record of {text} determines every parameter to "
                f"{100 * self.aim.relative_error:.3g} %"
            )
            return text + "."
        elif self._is_standard:
            return (
                f"No input was found whose record of {text} carries more information than that of "
                f"the best standard input under the same limits: {self.standards[0].description}."
            )
        else:
            text = f"A record of {text} carries {self.gain:.3g} times the information"
            return f"{text} of the best standard input under the same limits."
        if self.gain <= 1.0:
            return text + "; so does the best standard input."
        times = f"{float(f'{self.gain:.3g}'):,g}"  # 1,450 and not 1.45e+03
        return f"{text}; the best standard input needs {times} such records for the same."

    @property
    def _is_standard(self) -> bool:
        """True if the design gains nothing that shows on the best standard input."""
        return bool(self.standards) and self.gain < 1 + DESIGN.equal

    @property
    def _sufficient_duration(self) -> str:
        """How long to record for the usual power, energies growing with the record."""
        wanted = energy_for_name(DESIGN.power)
        if self.aim.kind == "detect":
            wanted = energy_for_detection(DESIGN.power, self.aim.false_alarm_rate)
        least = min(o.energy for o in self.outcomes)
        if least <= 0:
            return "no record under these limits shows the difference"
        longer = time_text(self.duration * wanted / least)
        return f"{100 * DESIGN.power:.3g} % needs at most {longer} of it, or wider limits"

    def write_csv(self, path: str | Path, *, force: bool = False) -> Path:
        """Write time, designed inputs and predicted outputs in declared units; returns the path.

        Raises
        ------
        DataError
            If the file exists, or its ending is neither .csv nor .parquet.
        """
        columns = {n: ColumnSpec(n, self.units.get(n)) for n in self.record}
        time = "t" if "t" not in columns else "time"
        return write_record(self.record, path, columns, time=time, force=force)

    def to_json(self) -> dict[str, Any]:
        """The content of `design.json` (schema casid.design/1)."""
        left_out = ["records", "details", "aim"]
        first = {n: self.record[n] for n in self.inputs}
        return {
            "schema": "casid.design/1",
            "sentence": self.sentence,
            "aim": plain_fields(self.aim),
            "power": self.power,
            **plain_fields(self, leave_out=left_out),
            "sample_time": self.record.Ts,
            "samples": plain(first),  # SI
            **plain(dict(self.details)),
        }

    def __repr__(self) -> str:
        return f"<DesignedExperiment {self.problem}: {self.aim}, {self.duration:g} s>"

    def plot(self) -> Any:
        """The input, and the predicted outputs of every hypothesis, as a Plotly figure."""
        return present(self, "figure")

    def references(self) -> tuple[str, ...]:
        """The papers behind the methods used."""
        return SOURCES

    def write(self, folder: str | Path) -> Path:
        """Write `design.json`, `report.html` and `input.csv` into `folder`; the page's path."""
        page = write(self, folder)
        self.write_csv(Path(folder) / "input.csv", force=True)
        return page
