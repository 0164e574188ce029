"""The options of a design by name, with their defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict, cast

from casid.errors import DataError, nearest
from casid.experiment_design.excitation import Shape
from casid.experiment_design.limits import Range
from casid.experiment_design.question import SizeOf
from casid.experiment_design.thresholds import DESIGN


class DesignOptions(TypedDict, total=False):
    """The options of `casid.design_experiment`, given by name.

    Attributes
    ----------
    Ts : sample time [s]; default that of the fitted records, or a quarter of an interval.
    shape : "constant" in each interval, "linear" (default where the slew rate is limited) or
        "multisine".
    intervals, interval : their number, or their length [s], which goes before.
    band : frequencies of a multisine (from, to) [Hz].
    slew : input -> largest rate of change, its unit per second; the input begins at rest.
    max_energy : input -> largest integral of (u - rest)^2, its unit squared times s.
    release : state -> (lower, upper) of an initial displacement that is chosen as well.
    hold : input -> value: of a designed input at rest (default 0, or the end next to it), of any
        other input throughout.
    x0 : state -> initial value; default the known one or the declared start.
    noise : output -> standard deviation of its white noise, in its unit; default the problem's, or
        the RMS error that the fit left.
    sizes : cause -> value of its first parameter, or of several by name, SI; default what a
        diagnosis found. One is enough: the other causes are taken as visible as that one. A list
        of sizes that a cause may have: the design is the best for the worst of them.
    scenarios : parameter -> value in its unit, over the nominal ones: the design is the best for
        the worst of them, and the limits hold in all.
    candidates : standard inputs drawn under the same limits, to begin from and compare with.
    standards : their kinds, of step, doublet, chirp, PRBS and multisine; default all.
    starts : of the best of different kinds, from which the program is solved; default 2, and up to
        12 where the input has few variables. 0 compares them alone.
    seconds : of the processor, that may be spent on solving.
    seed : of everything random.
    verify : simulated records of each truth, as a check of the predicted power; default none.
    verify_by : "diagnoses" (default) fits truth and rival to each of them and has each diagnosed
        with the whole catalogue; "fits" fits them alone, which is faster.
    """

    Ts: float | None
    shape: Shape | None
    intervals: int
    interval: float | None
    band: tuple[float, float] | None
    slew: Mapping[str, float] | None
    max_energy: Mapping[str, float] | None
    release: Mapping[str, Range] | None
    hold: Mapping[str, float]
    x0: Mapping[str, float] | None
    noise: Mapping[str, float] | None
    sizes: SizeOf
    scenarios: Sequence[Mapping[str, float]]
    candidates: int
    standards: Sequence[str]
    starts: int | None
    seconds: float
    seed: int
    verify: int
    verify_by: Literal["diagnoses", "fits"]


_DEFAULTS: Mapping[str, Any] = {
    **dict.fromkeys(("Ts", "shape", "interval", "band", "slew", "max_energy", "release")),
    **dict.fromkeys(("x0", "noise", "starts")),
    **dict.fromkeys(("hold", "sizes"), {}),
    **dict.fromkeys(("scenarios", "standards"), ()),
    "intervals": DESIGN.intervals,
    "candidates": DESIGN.candidates,
    "seconds": DESIGN.seconds,
    **dict.fromkeys(("seed", "verify"), 0),
    "verify_by": "diagnoses",
}
VERIFIED_BY = ("diagnoses", "fits")


def filled(given: DesignOptions) -> DesignOptions:
    """The options with defaults for what is not given, or given as None.

    Raises
    ------
    DataError
        For an option that there is not, or a check that there is not.
    """
    for name in given:
        if name not in _DEFAULTS:
            raise DataError(f"a design has no option {name!r}{nearest(name, _DEFAULTS)}")
    if (by := given.get("verify_by")) not in (None, *VERIFIED_BY):
        raise DataError(f"verify_by {by!r} is not known; use {' or '.join(map(repr, VERIFIED_BY))}")
    chosen = {name: value for name, value in given.items() if value is not None}
    return cast(DesignOptions, {**_DEFAULTS, **chosen})
