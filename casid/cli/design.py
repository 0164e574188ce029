"""`casid design`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from casid.cli.design_options import DESIGN_OPTIONS, AimOptions, design_arguments
from casid.cli.options import OUTPUT_OPTIONS, SET_OPTION, folder_options, options, seed_option
from casid.cli.output import Output, taken
from casid.cli.terminal import say

if TYPE_CHECKING:
    from casid.experiment_design.setup import Source


@click.command()
@click.argument("model", metavar="PROBLEM|RESULT", type=click.Path())
@options(
    *DESIGN_OPTIONS,
    SET_OPTION,
    seed_option("Seed of the standard inputs that the search begins from."),
    *folder_options("a new reports/<problem>-<n>", "Write into a folder that is not empty."),
    *OUTPUT_OPTIONS,
)
def design(model: str, settings: tuple[str, ...], seed: int, **given: Any) -> None:
    """Design the next experiment: the input that answers a question in the shortest time.

    RESULT is the folder that casid identify or casid diagnose wrote, or a saved result. One of
    --separate, --detect, --estimate, --variance-of and --identifiable is the question; the
    default, for a diagnosis with causes that it could not separate, is to separate them. Writes
    input.csv (for a signal generator), design.json and report.html.

    Example: casid design problems/tank.py --estimate c --limit q=0:1e-3 --limit level=0.1:0.5
    --noise level=1e-3 --x0 level=0.3 --duration 1200 --interval 60
    """
    output = taken(Output, given)
    aims = taken(AimOptions, given)
    source, name = _source(model, settings)
    aim = aims.aim(source)
    arguments = design_arguments(given)
    from casid.experiment_design.design import design_experiment

    with output.work(name) as (folder, progress):
        found = design_experiment(source, aim, **arguments, seed=seed, progress=progress)
        output.keep(found, folder, found.write)
    if not output.quiet:
        say(f"wrote {folder / 'input.csv'}")
    output.finish(found, folder, "design.json")


def _source(path: str, settings: tuple[str, ...]) -> tuple[Source, str]:
    """The problem of a file, or a saved result, and its name."""
    from casid.errors import DataError

    if Path(path).suffix == ".py":
        from casid.cli.problem_file import known_problem
        from casid.cli.request import Request

        problem = known_problem(path, Request(settings=settings))
        return problem, problem.name
    if settings:
        raise DataError(
            "--set belongs to a problem file; the parameters of a result are as it found them"
        )
    from casid.cli.result_file import fitted_model
    from casid.saving.archive import load

    return load(path), fitted_model(path).name
