"""`casid identify`."""

from __future__ import annotations

from typing import Any

import click

from casid.cli.instrument_options import INSTRUMENT_OPTIONS, InstrumentRequest
from casid.cli.interrupt import interruptible
from casid.cli.options import FitOptions, hold_out_option, options, record_options
from casid.cli.output import Output, taken
from casid.cli.problem_file import known_problem
from casid.cli.request import request_of


@click.command()
@click.argument("problem", type=click.Path())
@click.argument("data", nargs=-1)
@hold_out_option("0")
@click.option(
    "--segments",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Multiple shooting with so many segments a record, for unstable models.",
)
@options(*INSTRUMENT_OPTIONS)
@record_options
def identify(problem: str, segments: int, **given: Any) -> None:
    """Estimate the unknown parameters from these records.

    Least squares of the simulation error, with standard errors that allow for autocorrelated
    residuals. Without DATA the problem simulates its own example. Writes estimate.json,
    report.html, and result.casid for `casid export` and `casid simulate`.

    Example: casid identify ship.py nominal=a.csv loaded=b.csv --set M=22.04 --hold-out c.csv

    With instruments: casid identify ship.py nominal=a.csv b.csv --method instruments --reference
    rudder --free I_x,d,m=0.1
    """
    output, fit = taken(Output, given), taken(FitOptions, given)
    instruments = taken(InstrumentRequest, given)
    request = request_of(given)
    model = known_problem(problem, request)
    by_instruments = instruments.method == "instruments"
    if by_instruments:
        instruments.refuse(request, fit.starts, segments)
        instruments.freed(model)  # refused before anything is read
    with output.work(model.name) as (folder, progress):
        fitted, hold_out = request.experiments(model)
        output.say_what_was_read([*fitted, *(hold_out if isinstance(hold_out, list) else ())])
        from casid.data.files import write_text
        from casid.identification.identify import identify as run
        from casid.presentation import present

        result: Any
        with interruptible():
            if by_instruments:
                progress(f"instrumental variables of {', '.join(e.name for e in fitted)}")
                result = instruments.estimate(model, fitted, fit.solver)
                estimate = result.estimate
            else:
                settings = fit.settings(model, segments=segments)
                result = estimate = run(
                    model, fitted, hold_out=hold_out, settings=settings, progress=progress
                )
        progress("write the report")
        # Before anything is written: both files or none.
        page = present(estimate, "page")
        result.write(folder)
        write_text(folder / "report.html", page)
        output.keep(estimate, folder)
    output.finish(result, folder, "estimate.json")
