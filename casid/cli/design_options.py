"""What the options of `casid design` request: the aim, the limits, the shape of the input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from casid.cli.request import names_in, parse_setting
from casid.errors import DataError
from casid.experiment_design.thresholds import DESIGN, STARTING

if TYPE_CHECKING:
    from casid.experiment_design.aim import Aim


def _values(flag: str, what: str, metavar: str) -> Any:
    return click.option(flag, multiple=True, metavar=metavar, help=f"{what} Repeatable.")


AIM_OPTIONS = (
    click.option("--separate", metavar="A,B[,C]", help="Find out which of these causes acts."),
    click.option("--detect", metavar="KIND", help="Detect this cause; KIND@WHERE names its place."),
    click.option(
        "--estimate",
        metavar="NAME[,NAME]",
        help="Estimate these parameters, the others being nuisance parameters; 'all' for every "
        "unknown one.",
    ),
    click.option(
        "--optimality",
        type=click.Choice(["D", "A", "E"]),
        default="D",
        show_default=True,
        help="Criterion of --estimate: determinant of the information (D), mean (A) or largest (E) "
        "relative variance.",
    ),
    click.option(
        "--variance-of",
        metavar="FORMULA",
        help='Minimise the variance of this function, as in "m*z_m".',
    ),
    click.option(
        "--identifiable",
        is_flag=True,
        help="Find the cheapest input that makes every parameter identifiable.",
    ),
    click.option(
        "--false-alarm-rate",
        type=float,
        default=0.05,
        show_default=True,
        metavar="P",
        help="False-alarm rate of --detect.",
    ),
    click.option(
        "--relative-error",
        type=float,
        metavar="R",
        default=DESIGN.relative_error,
        show_default=True,
        help="Largest relative standard error allowed with --identifiable.",
    ),
)

SAMPLE_TIME_OPTION = click.option(
    "--sample-time", "Ts", type=float, metavar="TS", help="Sample time of the record [s]."
)

INPUT_OPTIONS = (
    click.option(
        "--duration",
        required=True,
        metavar="S|FROM:TO",
        help="Duration of the record [s]; with a range, the shortest one that decides with 95 % "
        "probability.",
    ),
    _values(
        "--limit",
        "Range of an input, output or state, in its declared unit or the one given, as in "
        "phi=-15:15:deg; an empty end is open. Inputs with a limit are designed.",
        "NAME=LOWER:UPPER[:UNIT]",
    ),
    _values("--release", "Range of an initial displacement to choose.", "STATE=LOWER:UPPER[:UNIT]"),
    _values("--slew", "Largest rate of change of an input, its unit per second.", "INPUT=RATE"),
    _values(
        "--max-energy",
        "Largest integral of an input's squared deviation from rest, its unit squared times s.",
        "INPUT=VALUE",
    ),
    _values(
        "--hold",
        "Value of an input that is not designed, or rest value of one that is.",
        "INPUT=VALUE",
    ),
    _values("--x0", "An initial state, in its declared unit.", "STATE=VALUE"),
    _values("--noise", "Standard deviation of an output, in its unit.", "OUTPUT=SD"),
    _values(
        "--size",
        "A value that a cause's first parameter may have, in SI units; several: the worst counts.",
        "KIND[@WHERE]=VALUE",
    ),
    click.option(
        "--shape",
        type=click.Choice(["constant", "linear", "multisine"]),
        help="Shape of the input in each interval. Default constant; linear where the slew rate is "
        "limited.",
    ),
    click.option(
        "--intervals",
        type=click.IntRange(min=1),
        default=DESIGN.intervals,
        show_default=True,
        metavar="N",
        help="Number of intervals of the input.",
    ),
    click.option(
        "--interval",
        type=float,
        metavar="S",
        help="Length of an interval [s], instead of their number.",
    ),
    click.option("--band", metavar="FROM:TO", help="Frequencies of a multisine [Hz]."),
    click.option(
        "--candidates",
        type=click.IntRange(min=1),
        default=DESIGN.candidates,
        show_default=True,
        metavar="N",
        help="Standard inputs drawn under the same limits, to begin from and compare with.",
    ),
    click.option(
        "--starts",
        type=click.IntRange(min=1),
        metavar="N",
        help="Number of the best standard inputs from which the optimisation starts. Default "
        f"{DESIGN.starts}, and up to {STARTING.most} for inputs with few intervals.",
    ),
    click.option(
        "--seconds",
        type=click.FloatRange(min=0, min_open=True),
        default=DESIGN.seconds,
        show_default=True,
        metavar="S",
        help="Processor time for the optimisation [s].",
    ),
    click.option(
        "--verify",
        type=click.IntRange(min=0),
        default=0,
        metavar="N",
        help="Check the predicted power: simulate N records for each cause, diagnose them, and "
        "fit the true cause and its rival to them.",
    ),
    click.option(
        "--verify-by",
        type=click.Choice(["diagnoses", "fits"]),
        default="diagnoses",
        show_default=True,
        help="Whether --verify runs diagnoses and fits, or fits alone, which is faster.",
    ),
)

DESIGN_OPTIONS = (*AIM_OPTIONS, *INPUT_OPTIONS, SAMPLE_TIME_OPTION)


@dataclass(frozen=True, slots=True)
class AimOptions:
    """The values of `AIM_OPTIONS`."""

    separate: str | None
    detect: str | None
    estimate: str | None
    optimality: str
    variance_of: str | None
    identifiable: bool
    false_alarm_rate: float
    relative_error: float

    def aim(self, source: object) -> Aim:
        """The one aim that is given; by default to separate what a diagnosis could not.

        Raises
        ------
        DataError
            If there are several, or none and the source is no diagnosis that ended in a tie.
        """
        from casid.experiment_design.aim import Aim

        given = [
            name
            for name in ("separate", "detect", "estimate", "variance_of", "identifiable")
            if getattr(self, name)
        ]
        if not given and hasattr(source, "verdict"):
            return Aim.of(source)
        if len(given) != 1:
            raise DataError(
                f"{'no aim' if not given else ' and '.join(given)} given: one experiment has one "
                "aim, --separate A,B or --detect KIND or --estimate m,z_m or --variance-of "
                "FORMULA or --identifiable"
            )
        if self.separate:
            return Aim.separate(*names_in(self.separate))
        if self.detect:
            return Aim.detect(self.detect, false_alarm_rate=self.false_alarm_rate)
        if self.estimate:
            names = [] if self.estimate == "all" else names_in(self.estimate)
            return Aim.estimate(*names, optimality=self.optimality)
        if self.variance_of:
            return Aim.variance_of(self.variance_of)
        return Aim.identifiable(relative_error=self.relative_error)


_NUMBERS = ("slew", "max_energy", "hold", "x0", "noise")
_PLAIN = (
    *("shape", "intervals", "interval", "Ts"),
    *("candidates", "starts", "seconds", "verify", "verify_by"),
)


def _sizes(given: Sequence[str]) -> dict[str, list[float]]:
    """Cause -> the sizes that it may have."""
    found: dict[str, list[float]] = {}
    for text in given:
        name, value = parse_setting(text, "--size")
        found.setdefault(name, []).append(value)
    return found


def design_arguments(given: dict[str, Any]) -> dict[str, Any]:
    """The values of `INPUT_OPTIONS`, taken out of `given`, as `casid.design_experiment` takes them.

    Raises
    ------
    DataError
        For what cannot be read.
    """
    out = {name: given.pop(name, None) for name in _PLAIN}
    for name in _NUMBERS:
        option = f"--{name.replace('_', '-')}"
        values = dict(parse_setting(text, option) for text in given.pop(name))
        out[name] = values or None
    out["sizes"] = _sizes(given.pop("size"))
    out["limits"] = _ranges("--limit", given.pop("limit"))
    out["release"] = _ranges("--release", given.pop("release"))
    out["band"] = _band(given.pop("band"))
    out["duration"] = _duration(given.pop("duration"))
    return out


def _ranges(option: str, texts: Sequence[str]) -> dict[str, tuple[Any, ...]]:
    """Ranges written as name=lower:upper or name=lower:upper:unit."""
    out: dict[str, tuple[Any, ...]] = {}
    for text in texts:
        name, equals, rest = text.partition("=")
        low, colon, others = rest.partition(":")
        high, _, unit = others.partition(":")
        try:
            ends = tuple(float(end) if end.strip() else None for end in (low, high))
        except ValueError:
            ends = ()
        if not (equals and colon and name.strip() and ends):
            raise DataError(
                f"{option} {text}: write it as name=lower:upper or name=lower:upper:unit, for "
                f"example {option} phi=-15:15:deg"
            )
        name = name.strip()
        if name in out:
            raise DataError(f"{option} names {name!r} twice; keep one of them")
        out[name] = (*ends, unit.strip()) if unit.strip() else ends
    return out


def _duration(text: str) -> float | tuple[float, ...]:
    try:
        ends = tuple(float(part) for part in text.split(":"))
    except ValueError:
        ends = ()
    if len(ends) not in (1, 2):
        raise DataError(
            f"--duration {text}: write seconds, or the shortest and the longest, for example "
            "--duration 30 or --duration 5:60"
        )
    return ends if len(ends) > 1 else ends[0]


def _band(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise DataError(
            f"--band {text}: write it as two frequencies in Hz, for example --band 0.1:2"
        ) from None
    return low, high
