"""Expected errors of every parameter, correlations, and the weakest directions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

from casid.arrays import Array, finite_or_none
from casid.data.files import plain_fields
from casid.deprecation import renamed
from casid.errors import UnknownNameError
from casid.grouping import Grouped
from casid.identifiability.records.planned_experiment import Noise
from casid.presentation import Presented

Verdict = Literal[
    "well determined", "poorly determined", "not seen by this record", "seen, not judged"
]
WELL: Verdict = "well determined"
POOR: Verdict = "poorly determined"
UNDETERMINED: Verdict = "not seen by this record"
UNJUDGED: Verdict = "seen, not judged"

LARGEST_RELATIVE = 0.3
"""Standard error over value above which a parameter is called poorly determined (a convention)."""

ASSUMES = (
    "white Gaussian noise of the stated standard deviation on each output, exact inputs, a "
    "correct model, small errors around the stated values (Cramer-Rao bound); coloured noise, "
    "noise on measured inputs and a wrong model make the errors larger"
)
SOURCES = (
    "L. Ljung, System Identification, 2nd ed., Prentice Hall 1999, section 7.4: Cramer-Rao bound",
    "E. Walter, L. Pronzato, Identification of Parametric Models from Experimental Data, "
    "Springer 1997: Fisher information of an experiment",
)


@dataclass(frozen=True, slots=True)
class Row:
    """Expected error and verdict of one parameter or initial state, SI units.

    Attributes
    ----------
    std_error : expected standard error, inf without information; for noise of one unit on every
        output where the noise is unknown.
    relative : std_error / |value|, None where the value is zero; of an initial state, relative to
        the rms of the state over the records where that is more.
    correlation, partner : the largest correlation with a parameter, and which; None without one.
    note : why, and which other parameter it is confused with.
    declared : the unit that it was declared in, and that tables show it in; that of SI by default.
    """

    name: str
    unit: str
    value: float
    is_state: bool
    std_error: float
    relative: float | None
    correlation: float | None
    partner: str | None
    verdict: Verdict
    note: str = ""
    declared: str = ""

    def to_json(self) -> dict[str, Any]:
        """Plain values in SI units; None for what is infinite."""
        return {
            "name": self.name,
            "unit": self.unit,
            "value": self.value,
            "kind": "initial state" if self.is_state else "parameter",
            "std_error": finite_or_none(self.std_error),
            "relative": None if self.relative is None else finite_or_none(self.relative),
            "correlation": self.correlation,
            "partner": self.partner,
            "verdict": self.verdict,
            "note": self.note,
        }


@dataclass(frozen=True, slots=True)
class Direction:
    """A combination of the parameters and its error, initial states eliminated.

    Attributes
    ----------
    error : standard error along the relative direction of length one; inf where nothing moves.
    moves : parameter -> its move at one standard error, relative to its value (to its scale where
        that is zero); per cent of a common factor where the error is infinite.
    """

    error: float
    moves: Mapping[str, float]

    def __str__(self) -> str:
        moves = ", ".join(f"{n} {100 * v:+.3g} %" for n, v in self.moves.items())
        if math.isinf(self.error):
            return f"{moves}: moves no output"
        return f"{moves}, by one standard error of this combination"

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return plain_fields(self)


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What the errors are computed for: records, noise, and the limits of the verdicts."""

    records: tuple[str, ...]
    samples: int
    noise: Noise
    largest_relative: float
    largest_correlation: float
    assumes: str = ASSUMES
    sources: tuple[str, ...] = SOURCES


@dataclass(frozen=True, slots=True, eq=False)
class Matrices:
    """Information and errors, SI units.

    Attributes
    ----------
    names : (n,) variables, in order.
    fisher_information, covariance, correlation : (n, n); covariance is inf and correlation NaN
        where there is no information.
    """

    names: tuple[str, ...]
    fisher_information: Array
    covariance: Array
    correlation: Array


@dataclass(frozen=True, slots=True, eq=False)
class Conditioning:
    """Numerical rank and weakest directions of the sensitivities.

    Attributes
    ----------
    rank, unknowns : numerical rank of all sensitivities, and how many there are.
    singular_values : of the parameters' sensitivities relative to their values, in units of the
        noise, initial states eliminated: one over the relative standard error along `weakest`.
    condition : their largest over their smallest; inf where a direction has no information.
    weakest : directions, the worst first.
    undetermined : what the records do not determine and the combinations they determine instead;
        empty where everything is determined.
    """

    rank: int
    unknowns: int
    singular_values: Array
    condition: float
    weakest: tuple[Direction, ...]
    undetermined: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Practical(Presented):
    """Expected errors, correlations and weakest directions for stated records, values and noise.

    Fields are grouped by question; the attributes of all groups can be read here as well.

    Attributes
    ----------
    rows : every unknown parameter, then every initial state.
    setup : records, noise and limits (`Setup`).
    matrices : information, covariance and correlation (`Matrices`).
    conditioning : numerical rank and weakest directions (`Conditioning`).
    """

    problem: str
    rows: tuple[Row, ...]
    setup: Setup
    matrices: Matrices
    conditioning: Conditioning

    records: ClassVar[Grouped[tuple[str, ...]]] = Grouped("setup")
    samples: ClassVar[Grouped[int]] = Grouped("setup")
    noise: ClassVar[Grouped[Noise]] = Grouped("setup")
    largest_relative: ClassVar[Grouped[float]] = Grouped("setup")
    largest_correlation: ClassVar[Grouped[float]] = Grouped("setup")
    assumes: ClassVar[Grouped[str]] = Grouped("setup")
    sources: ClassVar[Grouped[tuple[str, ...]]] = Grouped("setup")
    names: ClassVar[Grouped[tuple[str, ...]]] = Grouped("matrices")
    fisher_information: ClassVar[Grouped[Array]] = Grouped("matrices")
    covariance: ClassVar[Grouped[Array]] = Grouped("matrices")
    correlation: ClassVar[Grouped[Array]] = Grouped("matrices")
    rank: ClassVar[Grouped[int]] = Grouped("conditioning")
    unknowns: ClassVar[Grouped[int]] = Grouped("conditioning")
    singular_values: ClassVar[Grouped[Array]] = Grouped("conditioning")
    condition: ClassVar[Grouped[float]] = Grouped("conditioning")
    weakest: ClassVar[Grouped[tuple[Direction, ...]]] = Grouped("conditioning")
    undetermined: ClassVar[Grouped[str]] = Grouped("conditioning")

    unseen = renamed("unseen", "undetermined")

    def __repr__(self) -> str:
        poor = [r.name for r in self.parameters if r.verdict == POOR]
        lost = [r.name for r in self.parameters if r.verdict == UNDETERMINED]
        parts = [f"poorly determined: {', '.join(poor)}"] if poor else []
        parts += [f"not seen: {', '.join(lost)}"] if lost else []
        return (
            f"<Practical {self.problem}: rank {self.rank} of {self.unknowns}"
            f"{'; ' if parts else ''}{'; '.join(parts)}>"
        )

    def __getitem__(self, name: str) -> Row:
        """The row of a parameter or initial state."""
        for row in self.rows:
            if row.name == name:
                return row
        raise UnknownNameError(f"no {name!r}; there are {', '.join(r.name for r in self.rows)}")

    @property
    def parameters(self) -> tuple[Row, ...]:
        """Rows of parameters alone."""
        return tuple(r for r in self.rows if not r.is_state)

    def to_json(self) -> dict[str, Any]:
        """Plain values; None for what is infinite or not a number."""

        def plain(matrix: Array) -> list[list[float | None]]:
            return [[finite_or_none(v) for v in row] for row in matrix.tolist()]

        return {
            "schema": "casid.practical/1",
            "problem": self.problem,
            "records": list(self.records),
            "samples": self.samples,
            "rows": [r.to_json() for r in self.rows],
            "names": list(self.names),
            "fisher_information": plain(self.fisher_information),
            "covariance": plain(self.covariance),
            "correlation": plain(self.correlation),
            "singular_values": self.singular_values.tolist(),
            "condition": finite_or_none(self.condition),
            "weakest": [d.to_json() for d in self.weakest],
            "rank": self.rank,
            "unknowns": self.unknowns,
            "unseen": self.undetermined,
            "noise": dict(self.noise.sd),
            "noise_source": dict(self.noise.source),
            "noise_is_absolute": self.noise.is_absolute,
            "thresholds": {
                "relative": self.largest_relative,
                "correlation": self.largest_correlation,
            },
            "assumes": self.assumes,
            "sources": list(self.sources),
        }
