"""`casid fleet`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from casid.cli.options import (
    CATALOGUE_OPTIONS,
    OUTPUT_OPTIONS,
    SET_OPTION,
    folder_options,
    jobs_option,
    map_option,
    options,
    seed_option,
)
from casid.cli.output import Output, taken
from casid.cli.problem_file import known_problem
from casid.cli.request import Request
from casid.cli.terminal import quiet_stdout, workers
from casid.errors import DataError

FLEET_OPTIONS = (
    click.option(
        "--asset",
        metavar="COLUMN|PATTERN",
        help="Asset that a record belongs to: a column of the files, or a pattern of their paths "
        "with {asset}, as in '{asset}_{time}.parquet'. Default the folder that a file is in.",
    ),
    click.option(
        "--time",
        metavar="COLUMN|PATTERN",
        help="Time of a record: a column, or a pattern with {time}; dates or numbers. Default the "
        "{time} of --asset, else the order of the names.",
    ),
    click.option(
        "--level",
        type=float,
        default=0.05,
        show_default=True,
        metavar="RATE",
        help="False discovery rate over the fleet, and false-alarm rate of one record.",
    ),
    click.option(
        "--no-screening",
        is_flag=True,
        help="Search every record in full, not only those in which a quick score test finds "
        "something.",
    ),
    *CATALOGUE_OPTIONS,
    click.option(
        "--starts",
        type=click.IntRange(min=1),
        metavar="N",
        help="Starts of the estimation. Default: the problem's.",
    ),
)
"""Which records, and how they are searched."""

ENGINE_OPTIONS = (
    click.option(
        "--engine",
        type=click.Choice(["local", "dask"]),
        default="local",
        show_default=True,
        help="Processes of this machine, or a Dask cluster.",
    ),
    jobs_option("Local processes; default one per core."),
    click.option(
        "--scheduler",
        metavar="ADDRESS",
        help="Address of the scheduler of the Dask cluster, as in tcp://host:8786. Its workers "
        "need casid, and problem and records at the same paths.",
    ),
    click.option(
        "--budget",
        type=click.FloatRange(min=0.0, min_open=True),
        default=300.0,
        show_default=True,
        metavar="SECONDS",
        help="Time that one record may take; one that takes longer is stopped and reported.",
    ),
    click.option(
        "--memory",
        type=click.FloatRange(min=0.0, min_open=True),
        default=2000.0,
        show_default=True,
        metavar="MB",
        help="Memory that one record may take, in addition to that of the libraries.",
    ),
)
"""Where the work is done, and what a record may take of it."""


@dataclass(frozen=True, slots=True)
class _Engine:
    """The options --engine, --jobs and --scheduler."""

    engine: str
    jobs: int | None
    scheduler: str | None

    def __post_init__(self) -> None:
        if (self.engine == "dask") != (self.scheduler is not None):
            raise DataError(
                "--engine dask and --scheduler ADDRESS belong together; give both, as in --engine "
                "dask --scheduler tcp://host:8786, or neither"
            )


@click.command()
@click.argument("problem", type=click.Path())
@click.argument("records", nargs=-1, required=True)
@map_option("Column of a signal, and its unit in the files, as in phi=roll:deg.")
@click.option(
    "--window", metavar="START:STOP", help="Use this part of each record, in seconds of its clock."
)
@click.option(
    "--hold-out",
    type=click.FloatRange(0.0, 1.0, max_open=True),
    default=0.3,
    show_default=True,
    metavar="SHARE",
    help="Not fitted: this share at the end of every record (0: fit everything).",
)
@click.option(
    "--ignore",
    multiple=True,
    metavar="COLUMN",
    help="Do not test this column as a missing input; every other column that the problem does "
    "not use is tested. Repeatable.",
)
@options(
    SET_OPTION,
    *FLEET_OPTIONS,
    *ENGINE_OPTIONS,
    seed_option("Seed of the random starts."),
    *folder_options(
        "reports/<problem>-fleet", "Discard the results in the folder and start again."
    ),
    *OUTPUT_OPTIONS,
)
def fleet(problem: str, records: tuple[str, ...], **given: Any) -> None:
    """Diagnose the records of many assets: which asset shows which missing effect, since when.

    RECORDS are files, folders, or patterns in quotes. The false discovery
    rate over all of them is controlled. The same command continues where it was stopped, and
    diagnoses only the new records when some have arrived. Writes causes.parquet,
    parameters.parquet, fleet.json and report.html.

    Example: casid fleet ship.py 'voyages/*.parquet' --asset '{asset}_{time}.parquet' --out causes
    """
    from casid.data.reading.sources import parse_window

    output, engine = taken(Output, given), taken(_Engine, given)
    window, screen = given.pop("window"), not given.pop("no_screening")
    request = Request(data=records, maps=given.pop("maps"), settings=given.pop("settings"))
    model = known_problem(problem, request)
    folder = output.out or Path("reports") / f"{model.name}-fleet"
    from casid.fleets.fleet import fleet as run

    with quiet_stdout(), workers(engine.jobs, engine.scheduler):
        result = run(
            model,
            records,
            out=folder,
            resume=not output.force,
            screen=screen,
            mapping={m.signal: m.text for m in request.mapping.values()},
            window=parse_window(window) if window else None,
            progress=not output.quiet,
            **given,
        )
        result.write(folder)
    output.finish(result, folder, "fleet.json")
