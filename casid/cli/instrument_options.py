"""The options of `casid identify --method instruments`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import click

from casid.cli.request import Request, is_number, parse_setting
from casid.errors import DataError, nearest

if TYPE_CHECKING:
    from casid.data.experiment import Experiment
    from casid.data.problem import Problem


@dataclass(frozen=True, slots=True)
class InstrumentRequest:
    """The options of `--method instruments`, read and checked against each other."""

    method: str = "simulation"
    reference: str | None = None
    lag: float | None = None
    free: str | None = None

    def __post_init__(self) -> None:
        if self.method != "instruments":
            for option in ("lag", "free"):
                if getattr(self, option) is not None:
                    raise DataError(
                        f"--{option} belongs to instruments; add --method instruments, or leave "
                        f"--{option} out"
                    )
        elif self.lag is not None and not math.isfinite(self.lag):
            raise DataError(f"--lag {self.lag}: give a finite number of seconds, 0 or more")
        elif self.reference is None:
            raise DataError(
                "--method instruments needs a signal that no disturbance reaches: name the "
                "recorded channel with --reference, for example --reference ref"
            )

    def refuse(self, request: Request, starts: int | None, others: Mapping[str, bool]) -> None:
        """Refuse what moment equations have no use for; `others` are options and if given."""
        for option, is_given in (
            ("--hold-out", request.hold_out_files or request.share != 0),
            ("--starts", starts is not None),
            *others.items(),
        ):
            if is_given:
                raise DataError(
                    f"{option} has no meaning for --method instruments, which solves moment "
                    f"equations of whole records; leave {option} out"
                )
        for text in request.settings:
            name, _ = parse_setting(text)
            if self.free is not None and name in _names(self.free):
                raise DataError(f"--set {text} and --free {name} contradict; leave one of them out")

    def declared(self, problem: Problem) -> Problem:
        """The problem with the reference among its external signals, where there is one.

        Raises
        ------
        DataError
            If it records no such channel.
        """
        if self.reference is None:
            return problem
        self._require_reference([], problem)
        return replace(problem, external=(self.reference,))

    def _require_reference(self, others: Sequence[str], problem: Problem) -> None:
        """Refuse a reference that the problem does not read, nor is one of `others`."""
        channels = [*problem.recorded, *problem.model.inputs, *others]
        if self.reference not in channels:
            raise DataError(
                f"--reference {self.reference}: problem {problem.name} reads no such channel; "
                "declare it in the problem file, "
                f"casid.Problem(..., recorded={{{self.reference!r}: unit}})"
                f"{nearest(str(self.reference), channels)}"
            )

    def freed(self, problem: Problem) -> tuple[Problem, tuple[str, ...] | None]:
        """The problem with the parameters of --free unknown, and their names (None: its own).

        Raises
        ------
        DataError
            If the problem has no such parameter, a value is no number, or it records no such
            reference.
        """
        self._require_reference([*problem.model.outputs], problem)
        if self.free is None:
            return problem, None
        names, starts = [], {}
        known = list(problem.model.parameters)
        for part in self.free.split(","):
            name, equals, text = (x.strip() for x in part.partition("="))
            if name not in known:
                raise DataError(
                    f"--free {self.free}: problem {problem.name} has no parameter "
                    f"{name!r}{nearest(name, known)}"
                )
            if equals:
                if not is_number(text) or not math.isfinite(float(text)):
                    raise DataError(
                        f"--free {part}: the start is no finite number; write NAME or NAME=START "
                        "in its declared unit, as in --free I_x,d,m=0.1"
                    )
                starts[name] = float(text)
            elif problem.model.parameters[name].value == 0.0:
                raise DataError(
                    f"--free {name}: its known value is 0, where other parameters may have no "
                    f"effect; give a start in its unit, as in --free {name}=0.1"
                )
            names.append(name)
        model = problem.model.with_unknown(*names, **starts)
        return replace(problem, model=model), tuple(dict.fromkeys(names))

    def estimate(self, problem: Problem, fitted: Sequence[Experiment], solver: str) -> Any:
        """Joint instrumental variables on all records: a `casid.MomentEstimate`."""
        from casid.estimation.moments.instruments.instruments import Instruments
        from casid.estimation.moments.instruments.reference_filter import ReferenceFilter
        from casid.estimation.moments.stages.moment_settings import MomentSettings
        from casid.estimation.nlp.solver import Solver
        from casid.identification.moment_estimators import instrumental_variables

        problem, free = self.freed(problem)
        for name in free or ():
            if all(name in e.known for e in fitted):
                raise DataError(
                    f"--free {name}: it is known in the load case of every record "
                    f"({', '.join(e.name for e in fitted)}); name the record in which it is "
                    "estimated without its load case, as in b.csv for loaded=b.csv"
                )
        for p in problem.model.parameters.values():
            left = [e.name for e in fitted if p.name not in e.known]
            if free is not None and left and not p.is_known and p.name not in free:
                raise DataError(
                    f"--free {self.free} leaves out {p.name}, which is unknown in "
                    f"{', '.join(left)}; add it there, or give its value, --set {p.name}=..."
                )
        lag = ReferenceFilter.lag(self.lag) if self.lag else ReferenceFilter()
        return instrumental_variables(
            problem,
            fitted,
            Instruments(str(self.reference), lag),
            free=free,
            settings=MomentSettings(solver=Solver(solver)),
        )


def _names(free: str) -> list[str]:
    """The parameters of --free."""
    return [part.partition("=")[0].strip() for part in free.split(",")]


INSTRUMENT_OPTIONS = (
    click.option(
        "--method",
        type=click.Choice(["simulation", "instruments"]),
        default="simulation",
        show_default=True,
        help="Least squares of the simulation error, or instrumental variables: consistent in "
        "closed loop and with noise on measured inputs, for linear models.",
    ),
    click.option(
        "--reference",
        metavar="CHANNEL",
        help="Recorded channel that drives the system and is independent of all disturbances: "
        "instruments are made of it where least squares is biased, or in any case with --method "
        "instruments.",
    ),
    click.option(
        "--lag",
        type=click.FloatRange(min=0),
        metavar="S",
        help="Time constant from the reference to the unknown input [s]; a guess will do. "
        "Default 0.",
    ),
    click.option(
        "--free",
        metavar="NAME[=START],...",
        help="Parameters to estimate with instruments; default all unknown ones.",
    ),
)
"""Which estimator, and the settings of instrumental variables."""
