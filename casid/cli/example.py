"""`casid example`."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from casid.cli.problem_file import load
from casid.cli.terminal import print_text, say


@click.command()
@click.argument("problem", type=click.Path())
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    metavar="FILE",
    help="A CSV or Parquet file; for several records, each record's name is appended to that of "
    "the file.",
)
@click.option("--force", is_flag=True, help="Write over files that exist.")
def example(problem: str, out: Path, force: bool) -> None:
    """Write a problem's own example records, in the columns and units that it reads.

    Example: casid example problems/pendulum.py --out example.csv
    """
    from casid.data.example_files import write_examples

    written = write_examples(load(problem), out, force=force)
    for path in written.values():
        say(f"wrote {path}")
    print_text(f"casid diagnose {shlex.quote(problem)} {shlex.join(written)}")
