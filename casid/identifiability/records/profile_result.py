"""Profiles of parameters: intervals, and which of them are open or flat."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from casid.arrays import Array
from casid.data.files import plain_fields
from casid.errors import UnknownNameError
from casid.model.units import difference_from_si, from_si
from casid.presentation import Viewed, present

Kind = Literal["identifiable", "practically non-identifiable", "flat"]

ASSUMES = (
    "white Gaussian noise of the stated standard deviation on each output, exact inputs, a "
    "correct model; the deviance is then chi squared with one degree of freedom in large records"
)
SOURCES = (
    "A. Raue et al., Bioinformatics 25 (2009) 1923-1929: profile likelihood, structural and "
    "practical identifiability",
)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ProfileLikelihood:
    """The profile of one parameter, SI units.

    Attributes
    ----------
    best : the estimate.
    lower, upper : end points of the confidence interval; -inf or inf where the deviance never
        crosses the threshold as far as it was followed.
    grid, deviance : (m,) values tried, increasing, and PL(c) - PL(best) there, chi squared with one
        degree of freedom at the true value.
    path : (m, n) all variables along the profile, columns as `Profiles.names`.
    kind : "identifiable" (both ends found), "practically non-identifiable" (open on one side or
        both), or "flat" (nothing was lost anywhere: structurally non-identifiable).
    note : how far an open side was followed, and what stopped it.
    declared : the unit that it was declared in, and that tables and figures show it in; that of SI
        by default.
    """

    name: str
    unit: str
    best: float
    lower: float
    upper: float
    threshold: float
    grid: Array
    deviance: Array
    path: Array
    kind: Kind
    note: str = ""
    declared: str = ""

    @property
    def shown_unit(self) -> str:
        """The unit that tables and figures show it in."""
        return self.declared or self.unit

    @property
    def shown(self) -> tuple[float, float, float]:
        """The estimate and both ends in the unit shown."""
        best, lower, upper = from_si([self.best, self.lower, self.upper], self.shown_unit).tolist()
        return best, lower, upper

    def __repr__(self) -> str:
        best, lower, upper = self.shown
        return (
            f"<ProfileLikelihood {self.name}: {self.kind}, {best:.6g} in "
            f"{lower:.6g} to {upper:.6g} {self.shown_unit}>"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values in SI units; an open end is None."""
        return plain_fields(self, leave_out=["path", "declared"])


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Profiles(Viewed):
    """Profiles of chosen parameters over the same records.

    Attributes
    ----------
    names : variables of each profile's `path`.
    noise : output -> standard deviation the deviance is counted in, SI; `noise_source` says whence.
    noise_units : output -> unit that it is shown in.
    """

    problem: str
    records: tuple[str, ...]
    confidence: float
    profiles: tuple[ProfileLikelihood, ...]
    names: tuple[str, ...]
    noise: Mapping[str, float]
    noise_source: Mapping[str, str]
    noise_units: Mapping[str, str]
    assumes: str = ASSUMES
    sources: tuple[str, ...] = SOURCES

    def __repr__(self) -> str:
        return f"<Profiles {self.problem}: {', '.join(p.name for p in self.profiles)}>"

    def __getitem__(self, name: str) -> ProfileLikelihood:
        """The profile of one parameter."""
        for p in self.profiles:
            if p.name == name:
                return p
        raise UnknownNameError(
            f"no profile of {name!r}; there are {', '.join(p.name for p in self)}"
        )

    def __iter__(self) -> Iterator[ProfileLikelihood]:
        return iter(self.profiles)

    def __str__(self) -> str:
        lines = [
            f"Profile likelihood of {self.problem} from {', '.join(self.records)}, "
            f"{100 * self.confidence:g} % intervals"
        ]
        for p in self.profiles:
            best, lower, upper = p.shown
            lines.append(
                f"  {p.name}  {best:.6g} {p.shown_unit}  {_end(lower)} to {_end(upper)}  {p.kind}"
                + (f" ({p.note})" if p.note else "")
            )
        for name, sd in self.noise.items():
            unit = self.noise_units[name]
            size = f"{float(difference_from_si(sd, unit)):.3g} {unit}".removesuffix(" 1")
            lines.append(f"  noise  {name} {size} ({self.noise_source[name]})")
        lines.append(f"  The interval assumes {self.assumes}")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"schema": "casid.profiles/1"} | plain_fields(
            self, leave_out=["names", "noise_units"]
        )

    def plot(self) -> Any:
        """Plotly figure: deviance against each parameter, with the threshold of the interval."""
        return present(self, "figure")


def _end(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else ("-inf" if value < 0 else "inf")
