"""What `check` says of the samples that a channel lacks."""

from __future__ import annotations

import numpy as np

from casid.arrays import BoolArray
from casid.data.findings import Finding
from casid.data.record import Record
from casid.data.sampling import gaps_among, gaps_of
from casid.model.quantities import are, count_text

_ON_ITS_OWN_CLOCK = (
    "An output counts at its own instants; an input is held or joined between them, as the model "
    "declares"
)


def is_as_placed(record: Record, mask: BoolArray) -> bool:
    """True where a channel lacks what no row of its file has, and no gap is among it.

    That rows of an irregular file were read onto an even clock of more samples, each with the
    instant that it was taken at, was said of the file already.
    """
    if not record.late:
        return False
    steps = np.diff(np.flatnonzero(~mask))
    has_gaps = bool(gaps_among(steps).any()) if steps.size else True
    absent = np.all([record.is_missing(name) for name in record], axis=0)
    return not has_gaps and np.array_equal(mask, absent)


def some_missing(record: Record, name: str) -> Finding:
    """How many samples a channel lacks, or on what clock of its own it is."""
    gaps = gaps_of(record.is_missing(name))
    if gaps.rate is not None:
        return Finding(
            "note",
            name,
            f"has a value in one row of {gaps.rate} alone: a clock of its own, of "
            f"{gaps.rate * record.Ts:.6g} s.",
            f"{_ON_ITS_OWN_CLOCK}.",
        )
    if gaps.missing > record.N // 2 and gaps.missing < record.N - 1:
        return _own_clock(record, name)
    return Finding(
        "note",
        name,
        f"{count_text(gaps.missing, 'sample')} ({100 * gaps.missing / record.N:.3g} %) "
        f"{are(gaps.missing)} missing, in {count_text(gaps.stretches, 'gap')}, the longest of "
        f"{gaps.longest * record.Ts:.4g} s from t = {record.t[gaps.first]:.6g} s.",
        "Missing samples of an output are left out; short gaps of an input are filled as the model "
        "holds it, at long ones the record is cut. Instruments need a complete stretch: select it "
        "with a window.",
    )


def _own_clock(record: Record, name: str) -> Finding:
    """The instants of a channel that has a value in few rows, at uneven distances."""
    there = np.flatnonzero(~record.is_missing(name))
    steps = np.diff(there)
    usual = float(np.median(steps))
    (gaps,) = np.nonzero(gaps_among(steps))
    text = (
        f"a clock of its own: {there.size} samples, {record.Ts * steps.min():.4g} to "
        f"{record.Ts * steps.max():.4g} s apart, {record.Ts * usual:.4g} s as a rule"
    )
    remedy = _ON_ITS_OWN_CLOCK
    if gaps.size:
        gone = round(float(np.sum(steps[gaps] / usual - 1)))
        at = there[int(np.argmax(steps))]
        text += (
            f"; about {gone} ({100 * gone / (there.size + gone):.2g} %) are missing in "
            f"{count_text(gaps.size, 'gap')}, the longest of {record.Ts * steps.max():.4g} s from "
            f"t = {record.t[at]:.6g} s"
        )
        remedy += "; at long gaps of an input the record is cut"
    return Finding("note", name, f"{text}.", f"{remedy}.")
