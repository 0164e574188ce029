"""The options that say how a file is written, where the file itself leaves it open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from casid.data.reading.file_format import FileFormat

FORMAT_OPTIONS = (
    click.option(
        "--dates",
        type=click.Choice(["dmy", "mdy", "ymd"]),
        help="Order of day, month and year, where the dates leave it open.",
    ),
    click.option(
        "--time-zone",
        metavar="ZONE",
        help="Time zone of local time stamps, as in Europe/Berlin; summer time is corrected for.",
    ),
    click.option(
        "--decimal",
        type=click.Choice([".", ","]),
        help="The decimal mark; the other one then separates thousands.",
    ),
    click.option("--encoding", metavar="NAME", help="Encoding of the text, as in cp850."),
    click.option(
        "--table", metavar="NAME", help="Sheet, group, variable or member of an archive to read."
    ),
    click.option(
        "--missing",
        multiple=True,
        metavar="CELL",
        help="A cell that stands for no value, as in --missing 9999. Repeatable.",
    ),
    click.option(
        "--sample-time",
        type=float,
        metavar="TS",
        help="Sample time [s] of a file without time stamps.",
    ),
)
"""How a file is written."""

READING_OPTIONS = (
    *FORMAT_OPTIONS,
    click.option(
        "--mark-missing",
        is_flag=True,
        help="Leave samples without a value out instead of refusing the file.",
    ),
    click.option(
        "--ignore",
        multiple=True,
        metavar="COLUMN",
        help="Leave out this column, which the problem does not use; a diagnosis tests every other "
        "unused column as a missing input. Repeatable.",
    ),
)
"""How a file is written, and what is read from it."""


@dataclass(frozen=True, slots=True)
class ReadingRequest:
    """The values of `READING_OPTIONS`."""

    dates: Any = None
    time_zone: str | None = None
    decimal: Any = None
    encoding: str | None = None
    table: str | None = None
    missing: tuple[str, ...] = ()
    sample_time: float | None = None
    mark_missing: bool = False
    ignore: tuple[str, ...] = ()

    @property
    def form(self) -> FileFormat:
        """How the file is written."""
        from casid.data.reading.file_format import FileFormat

        return FileFormat(
            self.dates,
            self.time_zone,
            self.decimal,
            self.encoding,
            self.table,
            tuple(self.missing),
            self.sample_time,
        )
