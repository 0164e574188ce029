"""Profiles of parameters: intervals, and which of them are open or flat."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from casid.arrays import Array
from casid.data.files import plain_fields
from casid.errors import UnknownNameError
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

    def __repr__(self) -> str:
        return (
            f"<ProfileLikelihood {self.name}: {self.kind}, {self.best:.6g} in "
            f"{self.lower:.6g} to {self.upper:.6g}>"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values; an open end is None."""
        return plain_fields(self, leave_out=["path"])


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Profiles(Viewed):
    """Profiles of chosen parameters over the same records.

    Attributes
    ----------
    names : variables of each profile's `path`.
    noise : output -> standard deviation the deviance is counted in; `noise_source` says whence.
    """

    problem: str
    records: tuple[str, ...]
    confidence: float
    profiles: tuple[ProfileLikelihood, ...]
    names: tuple[str, ...]
    noise: Mapping[str, float]
    noise_source: Mapping[str, str]
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
            lines.append(
                f"  {p.name}  {p.best:.6g} {p.unit}  {_end(p.lower)} to {_end(p.upper)}  {p.kind}"
                + (f" ({p.note})" if p.note else "")
            )
        lines += [f"  noise  {n} {sd:.3g} ({self.noise_source[n]})" for n, sd in self.noise.items()]
        lines.append(f"  The interval assumes {self.assumes}")
        return "\n".join(lines)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"schema": "casid.profiles/1"} | plain_fields(self, leave_out=["names"])

    def plot(self) -> Any:
        """Plotly figure: deviance against each parameter, with the threshold of the interval."""
        return present(self, "figure")


def _end(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else ("-inf" if value < 0 else "inf")
