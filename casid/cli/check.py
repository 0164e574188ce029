"""`casid check`."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import click

from casid.cli.options import map_option, options
from casid.cli.output import taken
from casid.cli.problem_file import load
from casid.cli.reading_options import FORMAT_OPTIONS, ReadingRequest
from casid.cli.request import TIME, Request, Source, source_of, time_column, with_time
from casid.cli.terminal import print_json, print_text
from casid.errors import DataError

if TYPE_CHECKING:
    from casid.data.problem import Problem
    from casid.data.quality import CheckReport
    from casid.data.reading.columns import ColumnSpec


@click.command()
@click.argument("data", nargs=-1, required=True)
@click.option(
    "--problem",
    type=click.Path(),
    metavar="FILE",
    help="Check the channels that this problem reads, in its units.",
)
@map_option("Column of a signal and its unit in the file; t=COLUMN names the time stamps.")
@click.option(
    "--window", metavar="START:STOP", help="Check this part only, in seconds of the record's clock."
)
@click.option(
    "--resample", type=float, metavar="TS", help="Interpolate onto this sample time [s] first."
)
@options(*FORMAT_OPTIONS)
@click.option(
    "--json", "as_json", is_flag=True, help="Print the report as JSON; of several files, a list."
)
def check(
    data: tuple[str, ...],
    problem: str | None,
    maps: tuple[str, ...],
    window: str | None,
    resample: float | None,
    as_json: bool,
    **given: Any,
) -> None:
    """Check the data quality of records before anything is estimated from them.

    Clock, gaps, noise, quantisation, plateaus, spikes, drift and bandwidth of every channel.
    Exit status 2 if a file cannot be used.

    Example: casid check run.csv --map phi=roll:deg
    """
    from casid.data.reading.sources import parse_window

    reading = taken(ReadingRequest, given)
    request = Request(data=data, maps=maps, window=window, resample=resample, reading=reading)
    found = load(problem) if problem is not None else None
    common = parse_window(window) if window else None
    sources = [source_of(text, common) for text in data]
    _refuse_problems(sources)
    reports = [_checked(source, request, found) for source in sources]
    if as_json:
        content = [report.to_json() for report in reports]
        print_json(content[0] if len(content) == 1 else content)
    else:
        print_text("\n\n".join(str(report) for report in reports))
    unusable = [str(s) for s, r in zip(sources, reports, strict=True) if not r.is_usable]
    if unusable:
        raise DataError(
            f"cannot be used: {', '.join(unusable)}; fix the errors listed under findings"
        )


def _refuse_problems(sources: list[Source]) -> None:
    """Refuse a problem file in the place of a record: other commands take it there."""
    for source in sources:
        if source.path.suffix == ".py":
            others = [str(s) for s in sources if s.path.suffix != ".py"] or ["RECORD"]
            raise DataError(
                f"{source.path} is a problem file, and no record; casid check takes it by "
                f"--problem: casid check {' '.join(others)} --problem {source.path}"
            )


def _checked(source: Source, request: Request, problem: Problem | None) -> CheckReport:
    from casid.data.quality import check as run
    from casid.data.reading.columns import ColumnSpec
    from casid.data.reading.record_file import column_names

    columns: dict[str, ColumnSpec] | None = None
    form = request.reading.form
    if problem is not None and problem.form is not None:
        form = problem.form.updated(form)
    mapping, time = dict(request.mapping), None
    if problem is not None:
        problem, mapping = with_time(problem, mapping)
        time = problem.time
        texts = {m.signal: m.text for m in mapping.values()}
        columns = problem.columns(texts)
        with contextlib.suppress(DataError):  # reported by the check itself
            columns = problem.columns_in(column_names(source.path, form), texts)
    elif mapping:
        if TIME in mapping:
            time = time_column(mapping.pop(TIME))
        columns = {m.signal: ColumnSpec(m.column, m.unit) for m in mapping.values()} or None
    return run(
        source.path,
        columns,
        time=time,
        window=source.window,
        resample=request.resample,
        form=form,
    )
