"""Whether the residual of a fit is white, as a complete model with its noise model leaves it."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Literal

from casid.arrays import Array
from casid.estimation.covariance import FEWEST_FOR_WHITENESS, whiteness

_MOST_OUTSIDE = 3
"""Of 20 lags, that white noise leaves outside its 95 % band but for one residual in 60."""

Meaning = Literal["incomplete", "allowed for", "too few", ""]
"""What a test says: of a coloured residual, that model or noise model is incomplete, or that the
error bars allow for it; of another one, that it has too few samples to tell."""

_REMARKS: dict[Meaning, str] = {
    "incomplete": "autocorrelated: model or noise model incomplete",
    "allowed for": "autocorrelated; the error bars allow for it",
    "too few": "too few samples to tell",
    "": "",
}


@dataclass(frozen=True, slots=True)
class Whiteness:
    """How many autocorrelations of a residual lie outside the 95 % band of white noise.

    Attributes
    ----------
    outside, lags : how many do, of how many; the first 20, or fewer of a short residual.
    tested : what was tested, as a report calls it.
    meaning : what that says of the model, and of the samples.
    """

    outside: int
    lags: int
    tested: str = "whiteness"
    meaning: Meaning = ""

    @property
    def is_coloured(self) -> bool:
        """True if more lags lie outside than white noise leaves there."""
        return self.outside > _MOST_OUTSIDE

    @property
    def counts(self) -> str:
        """The numbers in words."""
        return f"{self.outside} of {self.lags} lags outside 95 %"

    @classmethod
    def of_sentence(cls, text: str) -> Whiteness:
        """What `str` made of a test: results that were saved earlier have it so."""
        said = re.fullmatch(r"(.*): (\d+) of (\d+) lags outside 95 %(?: \((.*)\))?", text)
        if said is None:
            return cls(0, 0, text)
        meanings = {remark: meaning for meaning, remark in _REMARKS.items()}
        return cls(int(said[2]), int(said[3]), said[1], meanings.get(said[4] or "", ""))

    def __str__(self) -> str:
        remark = _REMARKS[self.meaning]
        return f"{self.tested}: {self.counts}" + (f" ({remark})" if remark else "")


def measured_whiteness(residual: Array, tested: str, coloured: Meaning) -> Whiteness:
    """The test of a residual (N,).

    Parameters
    ----------
    coloured : what is found where it is coloured; few samples that are not tell nothing.
    """
    found = Whiteness(whiteness(residual), min(20, len(residual) - 2), tested)
    if found.is_coloured:
        return replace(found, meaning=coloured)
    return replace(found, meaning="too few" if len(residual) < FEWEST_FOR_WHITENESS else "")
