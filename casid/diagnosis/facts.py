"""Quantities of a diagnosis that several sentences, tables or figures state.

Every one of them is decided here once: which p-value belongs to an effect, which errors the causes
lower, whether the remainder is noise. What is displayed is derived from them, so that no two
sentences of a report can contradict each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from casid.diagnosis.diagnosis import Diagnosis
from casid.model.quantities import quantity_texts


@dataclass(frozen=True, slots=True)
class ErrorChange:
    """RMS error of one output before and after the causes were included, in its unit.

    part : "fitted" or "held out".
    after : None where nothing was included.
    """

    part: str
    output: str
    unit: str
    before: float
    after: float | None
    floor: float | None


@dataclass(frozen=True, slots=True)
class Facts:
    """Facts of a diagnosis, each decided once for all sentences and tables.

    Attributes
    ----------
    p_values : kind and place (`Cause.key`) -> the family-wise p-value shown of it, everywhere.
    changes : errors before and after, output by output.
    coloured : outputs with an autocorrelated residual under the model that the report recommends,
        and how many lags are outside.
    tied : (kind, place) of everything that the record does not separate from a named cause.
    """

    verdict: str
    p_values: Mapping[tuple[str, str], float]
    changes: tuple[ErrorChange, ...]
    coloured: Mapping[str, str]
    tied: frozenset[tuple[str, str]]

    @classmethod
    def of(cls, d: Diagnosis) -> Facts:
        """The facts of a diagnosis."""
        p_values = {(r.kind, r.where): r.adjusted for r in d.ranking}
        # A later round judges an effect beside the causes found before it: that is the one shown.
        p_values |= {c.key: c.p_value for c in (*d.remainders, *d.causes)}
        tied = [c for c in d.causes if c.tied]
        others = {(a.kind, a.where) for c in tied for a in c.alternatives}
        return cls(
            verdict=d.verdict,
            p_values=p_values,
            changes=tuple(_changes(d)),
            coloured=(d.extended or d.baseline).fit.coloured,
            tied=frozenset(others | {(c.kind, c.where) for c in tied}),
        )

    @property
    def shown(self) -> tuple[ErrorChange, ...]:
        """The changes that count: of what was held out, else of what was fitted."""
        held = tuple(c for c in self.changes if c.part == "held out")
        return held or self.changes

    def change_texts(self) -> Iterator[tuple[ErrorChange, list[str], str]]:
        """The changes as texts of before, after and floor ("" where there is none), and their unit.

        Errors of one output have one unit throughout.
        """
        for c in self.changes:
            numbers = [c.before, c.after, c.floor]
            beside = [x for o in self.changes if o.output == c.output for x in (o.before, o.after)]
            values = [math.nan if x is None else x for x in (*numbers, *beside)]
            texts, unit = quantity_texts(values, c.unit)
            yield c, ["" if x is None else t for x, t in zip(numbers, texts, strict=False)], unit

    def p_value(self, kind: str, where: str) -> float:
        """The family-wise p-value of an effect; NaN where it was not tested."""
        return self.p_values.get((kind, where), math.nan)


def _changes(d: Diagnosis) -> Iterator[ErrorChange]:
    for part, numbers in (("fitted", d.fitted), ("held out", d.held_out)):
        for output, before in numbers.get("baseline_rmse", {}).items():
            yield ErrorChange(
                part,
                output,
                d.output_units.get(output, ""),
                before,
                numbers.get("extended_rmse", {}).get(output),
                numbers.get("noise_floor", {}).get(output),
            )
