"""`casid simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from casid.cli.options import map_option, options
from casid.cli.output import taken
from casid.cli.reading_options import FORMAT_OPTIONS, ReadingRequest
from casid.cli.request import Request, parse_setting
from casid.cli.terminal import say
from casid.errors import DataError

if TYPE_CHECKING:
    from casid.data.record import Record
    from casid.estimation.fitted.fitted_model import FittedModel


@click.command()
@click.argument("model", metavar="PROBLEM|RESULT", type=click.Path())
@click.argument("inputs", required=False)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    metavar="FILE",
    help="A CSV or Parquet file of inputs, outputs and states, in declared units.",
)
@click.option(
    "--x0",
    multiple=True,
    metavar="STATE=VALUE",
    help="An initial state, in its declared unit. Repeatable.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="A parameter, in its declared unit. Repeatable.",
)
@map_option("Column of an input, and its unit; t=COLUMN names the time stamps.")
@click.option(
    "--window",
    metavar="START:STOP",
    help="Use this part only, in seconds of the file's clock: 27:91.",
)
@click.option(
    "--resample",
    type=float,
    metavar="TS",
    help="Interpolate irregular inputs onto this sample time [s].",
)
@click.option(
    "--duration",
    type=float,
    metavar="SECONDS",
    help="Duration of the simulation of a model without inputs; default that of the fitted record, "
    "or of the example.",
)
@click.option(
    "--on-clock",
    is_flag=True,
    help="INPUTS are on the clock of the fitted record: what the fit found to set in at an instant "
    "of it acts at that time. Without it that acts in windows of the file that was fitted alone.",
)
@options(*FORMAT_OPTIONS)
@click.option("--force", is_flag=True, help="Write over a file that exists.")
def simulate(
    model: str,
    inputs: str | None,
    out: Path,
    x0: tuple[str, ...],
    duration: float | None,
    on_clock: bool,
    force: bool,
    **given: Any,
) -> None:
    """Simulate a model without noise, driven by a file of inputs, and write the result.

    RESULT is the folder that casid identify or casid diagnose wrote, or a saved result: the fitted
    model with its causes, from the initial state of the fit. PROBLEM is a problem file: its model
    with the known values, and starting values for unknown parameters. Without INPUTS the problem's
    own example drives it.

    Example: casid simulate reports/pendulum-1 run.csv --out simulated.csv --x0 phi=0.1
    """
    from casid.data.record_files import require_new

    require_new(out, force=force)
    reading = taken(ReadingRequest, given)
    request = Request(data=(inputs,) if inputs else (), reading=reading, **given)
    if duration is not None and inputs:
        raise DataError("--duration is for a model without inputs; cut a file with --window")
    if Path(model).suffix == ".py":
        fitted, record = _of_problem(model, request, x0=x0, duration=duration)
    else:
        fitted, record = _of_result(model, request, x0=x0, duration=duration, on_clock=on_clock)
    from casid.data.reading.columns import ColumnSpec
    from casid.data.record_files import write_record

    columns = {
        n: ColumnSpec(n, fitted.model.unit_of(n.removesuffix(" (state)")))
        for n in record
        if not _is_shown(record, n)
    }
    time = "t" if "t" not in columns else "time"
    path = write_record(record, out, columns, time=time, force=force)
    say(f"wrote {path}")


def _is_shown(record: Record, name: str) -> bool:
    """True of a state that an output of its name shows as it is."""
    output = name.removesuffix(" (state)")
    return output != name and bool((record[name] == record[output]).all())


def _of_result(
    path: str, request: Request, *, x0: tuple[str, ...], duration: float | None, on_clock: bool
) -> tuple[FittedModel, Record]:
    """A fitted model, and its simulation with a file or, without inputs, over a time."""
    from casid.cli.result_file import fitted_model
    from casid.estimation.fitted.driving import driving_of, silent_causes
    from casid.estimation.fitted.simulation_inputs import clock, inputs_alone, problem_of

    fitted = fitted_model(path).without_noise()
    problem = problem_of(fitted)
    known = request.known(problem)
    start = _initial(fitted, x0)
    if not request.data:
        record = clock(fitted, duration)
        return fitted, fitted.simulate(record, start, known=known, on_clock=True)
    try:
        experiment = request.experiments(inputs_alone(problem))[0][0]
    except DataError as error:
        raise DataError(f"{error}{_computed_by_the_problem(fitted, str(error))}") from error
    given = driving_of(fitted.model, fitted.records, experiment, None, fitted.channels)
    silent = silent_causes(fitted.model, fitted.causes, fitted.records, given, "--on-clock")
    if silent and not on_clock:
        say(f"note: {silent}")
    acts = on_clock or not silent
    return fitted, fitted.simulate(given, start, known=known, on_clock=acts)


def _computed_by_the_problem(fitted: FittedModel, refused: str) -> str:
    """What to do about an input without a column, where the problem file computed it."""
    for name, how in fitted.channels.derived.items():
        if f"no column {name!r} for {name}." in refused:
            return (
                f" It was computed by the problem file ({how}), and a result holds no code: "
                "simulate with the problem file, whose output has such a column, and give that."
            )
    return ""


def _of_problem(
    path: str, request: Request, *, x0: tuple[str, ...], duration: float | None
) -> tuple[FittedModel, Record]:
    """The model of a problem at its starts, and its simulation."""
    from casid.cli.problem_file import load
    from casid.data.experiment import Experiment
    from casid.estimation.fitted.simulation_inputs import clock, inputs_alone, starting_model

    problem = load(path)
    known = request.known(problem)
    if request.data:
        experiment = request.experiments(inputs_alone(problem))[0][0]
    else:
        experiment = problem.examples()[0]
    fitted = starting_model(problem, experiment, problem.model.in_si(known))
    if duration is not None:
        experiment = Experiment(clock(fitted, duration))
    return fitted, fitted.simulate(experiment, _initial(fitted, x0), known=known, on_clock=True)


def _initial(fitted: FittedModel, texts: tuple[str, ...]) -> dict[str, float] | None:
    """The initial states of --x0, in their units."""
    from casid.errors import nearest

    given = dict(parse_setting(text, "--x0") for text in texts)
    for name in given:
        if name not in fitted.model.states:
            there = ", ".join(fitted.model.states)
            raise DataError(
                f"--x0 {name}: {fitted.name} has no such state; it has {there}"
                f"{nearest(name, fitted.model.states, is_listed=True)}"
            )
    return given or None
