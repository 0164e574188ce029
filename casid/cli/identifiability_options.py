"""The options of `casid identifiability`: what is assumed, and which remedies are compared."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from casid.cli.request import Request, names_in, parse_setting
from casid.errors import DataError, nearest

if TYPE_CHECKING:
    from casid.identifiability.equations.equation_file import EquationFile
    from casid.identifiability.question import Assumptions
    from casid.identifiability.remedies.candidates import Candidate

ASSUMPTION_OPTIONS = (
    click.option(
        "--replicas",
        type=click.IntRange(min=1),
        default=1,
        show_default=True,
        metavar="N",
        help="Every experiment is repeated N times, from different initial states "
        "and with different inputs.",
    ),
    click.option(
        "--shared-input",
        "shared_inputs",
        multiple=True,
        metavar="W",
        help="Unknown input that is the same signal in all experiments; by default each has its "
        "own. Repeatable.",
    ),
    click.option(
        "--known-initial",
        multiple=True,
        metavar="X[=VALUE],...",
        help="States whose initial value is known. Without VALUE it is treated as an arbitrary "
        "number; state the value where it matters, such as 0.",
    ),
    click.option(
        "--known",
        multiple=True,
        metavar="NAME,...",
        help="Parameters to treat as known, whatever their value.",
    ),
    click.option(
        "--at",
        multiple=True,
        metavar="NAME=VALUE",
        help="Analyse the model at this value of a parameter, in its declared unit; by default the "
        "answer holds for almost every value, but perhaps not for this one. Repeatable.",
    ),
    click.option(
        "--generic",
        is_flag=True,
        help="Treat known parameters of the model as arbitrary numbers instead of their values.",
    ),
)
"""The assumptions of the assessment."""

QUESTION_OPTIONS = (
    click.option(
        "--sensor",
        "sensors",
        multiple=True,
        metavar="NAME=FORMULA[@COST]",
        help="A sensor that could be added, as a formula of the model's names: phi=x1 or "
        "a=k*x1/m@3. The cheapest set of these sensors that makes the rank full is found. "
        "Repeatable.",
    ),
    click.option(
        "--profile",
        "profiles",
        multiple=True,
        metavar="NAME,...",
        help="Parameters whose profile likelihood is computed from the records, with one fit per "
        "point.",
    ),
    click.option(
        "--structural",
        is_flag=True,
        help="Only the rank and what follows from it: no closed forms, no expected "
        "standard errors.",
    ),
    click.option(
        "--time-limit",
        type=click.FloatRange(min=0, min_open=True),
        metavar="S",
        help="Time limit for the rank [s]; what is proven by then is reported.",
    ),
)
"""What else is requested."""


@dataclass(frozen=True, slots=True)
class Question:
    """The options, read and checked against each other."""

    replicas: int
    shared_inputs: Sequence[str]
    known_initial: Sequence[str]
    known: Sequence[str]
    at: Sequence[str]
    generic: bool
    sensors: Sequence[str]
    profiles: Sequence[str]
    structural: bool
    time_limit: float | None

    def __post_init__(self) -> None:
        if self.time_limit is not None and math.isnan(self.time_limit):
            raise DataError("--time-limit nan: give a number of seconds")

    def assumptions(self) -> Assumptions:
        """The assumptions of the assessment.

        Raises
        ------
        DataError
            If a value is no number, or some initial values have numbers and others have none.
        """
        from casid.identifiability.question import Assumptions

        return Assumptions(
            replicas=self.replicas,
            shared_inputs=_names(self.shared_inputs),
            known_initial=self._initial(),
            known=_names(self.known),
            at=dict(parse_setting(text, "--at") for text in self.at),
            generic=self.generic,
        )

    def _initial(self) -> dict[str, float | None]:
        found: dict[str, float | None] = {}
        for name in _names(self.known_initial):
            if "=" in name:
                key, value = parse_setting(name, "--known-initial")
                found[key] = value
            else:
                found[name] = None
        return found

    def profiled(self) -> tuple[str, ...]:
        """Parameters whose profile is requested.

        Raises
        ------
        DataError
            If only the rank is requested as well.
        """
        names = _names(self.profiles)
        if names and self.structural:
            raise DataError("--profile takes fits, and --structural leaves them out; drop one")
        return names

    def candidates(self) -> tuple[Candidate, ...]:
        """The sensors of --sensor; their formulas are read where they are mounted.

        Raises
        ------
        DataError
            If a text is not NAME=FORMULA[@COST].
        """
        from casid.identifiability.remedies.candidates import sensor

        made = []
        for text in self.sensors:
            name, equals, rest = text.partition("=")
            formula, at, cost = rest.partition("@")
            if not equals or not name.strip() or not formula.strip():
                raise DataError(
                    f"--sensor {text}: write it as name=formula, or name=formula@cost, for example "
                    "--sensor angle=x1@2"
                )
            price = _cost(cost, text) if at else 1.0
            made.append(sensor(name.strip(), formula.strip(), price))
        return tuple(made)


def read_equations_for(path: str, request: Request) -> EquationFile:
    """The systems of an equation file, values of --set put in; options on data are refused.

    Raises
    ------
    DataError
        If data or their options are given, or --set names no parameter.
    """
    from casid.identifiability.equations.equation_file import read_equations

    for option, is_given in (
        ("DATA", request.data),
        ("--map", request.maps),
        ("--window", request.window),
        ("--lowpass", request.lowpass),
        ("--detrend", request.detrend),
        ("--decimate", request.decimate != 1),
        ("--resample", request.resample),
    ):
        if is_given:
            raise DataError(
                f"{option} belongs to records, and {path} holds equations alone; leave it out, or "
                "name a problem file (.py), which says where signals come from"
            )
    found = read_equations(path)
    known = list(dict.fromkeys(n for s in found.systems for n in (*s.parameters, *s.constants)))
    values = {}
    for text in request.settings:
        name, value = parse_setting(text)
        if name not in known:
            raise DataError(
                f"--set {text}: the equations have no parameter {name!r}{nearest(name, known)}"
            )
        values[name] = value
    systems = [
        s.substituted({n: v for n, v in values.items() if n in s.symbols}) for s in found.systems
    ]
    return replace(found, systems=tuple(systems))


def is_equation_file(path: str) -> bool:
    """True for what is neither a Python file nor a record, by its ending."""
    return Path(path).suffix.lower() not in ("", ".py", ".csv", ".parquet")


def _names(texts: Sequence[str]) -> tuple[str, ...]:
    """The names of a repeatable option, each once."""
    return tuple(dict.fromkeys(name for text in texts for name in names_in(text)))


def _cost(text: str, sensor: str) -> float:
    try:
        return parse_setting(f"cost={text}")[1]
    except DataError:
        raise DataError(
            f"--sensor {sensor}: the cost {text!r} is no finite number; write name=formula@cost, "
            "for example --sensor angle=x1@2"
        ) from None
