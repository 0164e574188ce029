"""`casid diagnose`."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import click

from casid.cli.diagnosis_options import DIAGNOSIS_OPTIONS
from casid.cli.interrupt import interruptible
from casid.cli.options import FitOptions, hold_out_option, options, record_options
from casid.cli.output import Output, taken
from casid.cli.problem_file import known_problem
from casid.cli.request import request_of
from casid.cli.terminal import workers
from casid.errors import DataError


@dataclass(frozen=True, slots=True)
class _Search:
    """The options of the search for causes."""

    false_alarm_rate: float
    calibrate: int | None
    budget: float | None
    jobs: int | None
    max_causes: int
    without: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.jobs is not None and self.calibrate is None:
            raise DataError(
                "--jobs belongs to --calibrate, which alone has work for several processes; add "
                "--calibrate, or leave --jobs out"
            )


@click.command()
@click.argument("problem", type=click.Path())
@click.argument("data", nargs=-1)
@hold_out_option("0.3")
@options(*DIAGNOSIS_OPTIONS)
@record_options
def diagnose(problem: str, **given: Any) -> None:
    """Find what the model is missing in these records.

    Names the causes, extends the model, and measures the gain on data that were not fitted; says
    so where nothing is missing, and where the records cannot decide. Several records are diagnosed
    jointly, each with its load case. Without DATA the problem simulates its own example. Writes
    diagnosis.json, report.html, and result.casid for `casid export` and `casid simulate`.

    Example: casid diagnose problems/pendulum.py run.csv --map gyro=rate:deg/s --window 27:91

    Several: casid diagnose ship.py nominal=a.csv loaded=b.csv --hold-out c.csv --calibrate
    """
    from casid.diagnosis.settings import require_settings

    output, fit, search = taken(Output, given), taken(FitOptions, given), taken(_Search, given)
    request = request_of(given)
    model = known_problem(problem, request)
    # Refused before anything is read.
    require_settings(model, search.false_alarm_rate, search.max_causes, search.without)
    with output.work(model.name) as (folder, progress):
        fitted, hold_out = request.experiments(model)
        output.print_provenance([*fitted, *(hold_out if isinstance(hold_out, list) else ())])
        from casid.diagnosis.diagnose import diagnose as run

        calibrated = workers(search.jobs, None) if search.calibrate else contextlib.nullcontext()
        with interruptible(), calibrated:
            result = run(
                model,
                fitted,
                hold_out=hold_out,
                false_alarm_rate=search.false_alarm_rate,
                max_causes=search.max_causes,
                without=search.without,
                calibrate=search.calibrate or 0,
                budget=search.budget,
                solver=fit.own_solver(),
                starts=fit.starts,
                seed=fit.seed,
                progress=progress,
            )
        progress("write the report")
        output.keep(result, folder, result.write)
    output.finish(result, folder, "diagnosis.json")
