"""`casid gallery`."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from casid.cli.terminal import print_text, say
from casid.errors import DataError


@click.command()
@click.argument("name", required=False)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="A folder for the page, the script and the notebook, and the problem files they read.",
)
@click.option("--force", is_flag=True, help="Write over files that differ.")
def gallery(name: str | None, out: Path | None, force: bool) -> None:
    """List the worked cases, show the page of one, or write it as a script and a notebook.

    Example: casid gallery motor --out motor
    """
    from casid.gallery.case import case_called, cases

    if name is None:
        if out is not None:
            raise DataError("--out needs the name of a case; casid gallery lists them")
        listed = cases()
        width = max(map(len, listed))
        print_text("\n".join(f"{n:<{width}}  {case.title}" for n, case in listed.items()))
        return
    case = case_called(name)
    if out is None:
        print_text(case.text.rstrip())
        return
    for path in case.write(out, force=force):
        say(f"wrote {path}")
    print_text(f"cd {shlex.quote(str(out))} && python {case.name}.py")
