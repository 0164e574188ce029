"""`casid new`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from casid.cli.options import map_option, options
from casid.cli.output import taken
from casid.cli.reading_options import FORMAT_OPTIONS, ReadingRequest
from casid.cli.request import parse_mapping, parse_setting
from casid.cli.terminal import print_text
from casid.errors import DataError

NAMES = "mass-spring-damper, dc-motor, thermal, tank, vehicle, free"


@click.command()
@click.argument("data")
@click.option(
    "--as",
    "template",
    default="free",
    show_default=True,
    metavar="TEMPLATE",
    help=f"What the system is: {NAMES} (a first-order lag for every output).",
)
@map_option("Column of a signal of the template, and its unit; t=COLUMN names the time stamps.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="A parameter of the template that is known, in its unit there. Repeatable.",
)
@options(*FORMAT_OPTIONS)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="The problem file; default the name of DATA with .py, in this folder.",
)
@click.option("--force", is_flag=True, help="Write over a problem file that exists.")
def new(
    data: str,
    template: str,
    maps: tuple[str, ...],
    settings: tuple[str, ...],
    out: Path | None,
    force: bool,
    **given: Any,
) -> None:
    """Write a problem file to fill in for a file of measurements.

    Columns are matched with the signals of a template by unit and name; what is guessed is marked
    CHECK in the file and listed here. The file can be fitted as it is written.

    Example: casid new run.csv --as dc-motor --set N=20
    """
    from casid.data.reading.sources import source_of
    from casid.data.templates.file_channels import identifier
    from casid.data.templates.new_problem import new_problem

    mapping: dict[str, str] = {}
    for entry in map(parse_mapping, maps):
        if entry.signal in mapping:
            raise DataError(f"--map names {entry.signal!r} twice; keep one of them")
        mapping[entry.signal] = entry.text
    path = out or Path(f"{identifier(source_of(data)[0].stem)}.py")
    written = new_problem(
        data,
        template,
        path,
        mapping=mapping,
        known=dict(map(parse_setting, settings)),
        force=force,
        form=taken(ReadingRequest, given).form,
    )
    print_text(str(written))
