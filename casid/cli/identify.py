"""`casid identify`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from casid.cli.instrument_options import INSTRUMENT_OPTIONS, InstrumentRequest
from casid.cli.interrupt import interruptible
from casid.cli.options import (
    FitOptions,
    budget_option,
    hold_out_option,
    options,
    record_options,
)
from casid.cli.output import Output, taken
from casid.cli.problem_file import known_problem
from casid.cli.request import names_in, request_of
from casid.errors import DataError
from casid.time_limit import until, wall_clock

if TYPE_CHECKING:
    from casid.data.problem import Problem


@dataclass(frozen=True, slots=True)
class _Search:
    """The options of the estimate by simulation or prediction."""

    segments: int
    own: str | None
    disturbances: tuple[str, ...]
    intervals: str
    budget: float | None

    @property
    def refused(self) -> dict[str, bool]:
        """Options that mean nothing for instruments -> whether they are given."""
        return {
            "--segments": self.segments != 1,
            "--own": self.own is not None,
            "--disturbance": bool(self.disturbances),
            "--intervals": self.intervals != "auto",
        }


@click.command()
@click.argument("problem", type=click.Path())
@click.argument("data", nargs=-1)
@hold_out_option("0")
@click.option(
    "--segments",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Multiple shooting with this many segments per record, for unstable models.",
)
@click.option(
    "--own",
    metavar="NAME,...",
    help="Parameters estimated for each record separately; the others are shared.",
)
@click.option(
    "--disturbance",
    "disturbances",
    multiple=True,
    metavar="PLACE[:SPECTRUM]",
    help="A disturbance in this balance, state or unknown input, with the spectrum white (the "
    "default), first (order) or peak: size and frequency are estimated together with the "
    "parameters, by prediction error. Repeatable.",
)
@click.option(
    "--intervals",
    type=click.Choice(["auto", "quick", "profile", "bootstrap"]),
    default="auto",
    show_default=True,
    help="95 % intervals: quick (normal), profile (values that the records do not reject) or "
    "bootstrap (from simulated records). auto: normal, and profile where the normal interval fails "
    "its test.",
)
@budget_option(
    "Time limit of the estimate: it then reports the best result so far and lists what was not "
    "done. Default 120 s plus 1 ms for each sample and unknown.",
)
@options(*INSTRUMENT_OPTIONS)
@record_options
def identify(problem: str, **given: Any) -> None:
    """Estimate the unknown parameters from these records.

    Least squares of the simulation error, with standard errors that allow for autocorrelated
    residuals. Without DATA the problem simulates its own example. Writes estimate.json,
    report.html, and result.casid for `casid export` and `casid simulate`.

    Example: casid identify ship.py nominal=a.csv loaded=b.csv --set M=22.04 --hold-out c.csv

    With instruments: casid identify ship.py nominal=a.csv b.csv --method instruments --reference
    rudder --free I_x,d,m=0.1
    """
    output, fit = taken(Output, given), taken(FitOptions, given)
    instruments, search = taken(InstrumentRequest, given), taken(_Search, given)
    request = request_of(given)
    model = known_problem(problem, request)
    by_instruments = instruments.method == "instruments"
    if by_instruments:
        instruments.refuse(request, fit.starts, search.refused)
        instruments.freed(model)  # refused before anything is read
    else:
        model = instruments.declared(model)
    owned = own_parameters(model, search.own)
    with output.work(model.name) as (folder, progress):
        fitted, hold_out = request.experiments(model)
        output.print_provenance([*fitted, *(hold_out if isinstance(hold_out, list) else ())])
        from casid.data.files import write_text
        from casid.estimation.simulation.budget import fit_budget
        from casid.identification.identify import identify as run
        from casid.presentation import present

        result: Any
        with interruptible():
            if by_instruments:
                progress(f"instrumental variables of {', '.join(e.name for e in fitted)}")
                with until(wall_clock() + fit_budget(model.model, fitted, search.budget)):
                    result = instruments.estimate(model, fitted, fit.solver)
                estimate = result.estimate
            else:
                settings = fit.settings(model, segments=search.segments, own=owned)
                result = estimate = run(
                    model,
                    fitted,
                    hold_out=hold_out,
                    settings=settings,
                    budget=search.budget,
                    intervals=search.intervals,
                    disturbances=search.disturbances,
                    progress=progress,
                )
        progress("write the report")
        page = present(result, "page", *([fitted] if by_instruments else []))

        def write(place: Path) -> None:
            result.write(place)
            write_text(place / "report.html", page)

        output.keep(estimate, folder, write)
    output.finish(result, folder, "estimate.json")


def own_parameters(problem: Problem, own: str | None) -> tuple[str, ...]:
    """The parameters that --own names.

    Raises
    ------
    DataError
        If the problem has no such parameter, or its value is known.
    """
    names = tuple(names_in(own or ""))
    for name in names:
        parameter = problem.model.parameter_named(name)
        if parameter.is_known:
            raise DataError(
                f"--own {name}: its known value is {parameter.value:g} {parameter.unit}; leave it "
                "out, or make it unknown in the problem"
            )
    return names
