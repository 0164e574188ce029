"""`casid investigate`."""

from __future__ import annotations

from typing import Any

import click

from casid.cli.design_options import INPUT_OPTIONS, design_arguments
from casid.cli.options import (
    DATA_OPTIONS,
    OUTPUT_OPTIONS,
    budget_option,
    folder_options,
    hold_out_option,
    options,
    seed_option,
)
from casid.cli.output import Output, taken
from casid.cli.problem_file import known_problem
from casid.cli.request import request_of
from casid.cli.terminal import print_json, print_text, say
from casid.errors import DataError


@click.command()
@click.argument("problem", type=click.Path())
@click.argument("data", nargs=-1)
@hold_out_option("0.3")
@budget_option("Time limit of the diagnosis; default 600 s.")
@options(
    *INPUT_OPTIONS,
    *DATA_OPTIONS,
    seed_option("Seed of the diagnosis and of the standard inputs."),
    *folder_options("a new reports/<problem>-<n>", "Write into a folder that is not empty."),
    *OUTPUT_OPTIONS,
)
def investigate(problem: str, **given: Any) -> None:
    """Diagnose the records; where causes cannot be separated, design the experiment that does.

    Record the designed experiment, and run the command again with all records, the new one last,
    until the causes are separated. Without DATA the problem simulates its own example. Writes
    input.csv (for a signal generator; only where an experiment is to be recorded),
    investigation.json and report.html, and a folder each for the diagnosis and the design.

    Example: casid investigate store.py first.csv --limit u=-3:3 --duration 12 --noise y=0.01

    Then: casid investigate store.py first.csv second.csv --limit u=-3:3 --duration 12
    """
    output = taken(Output, given)
    budget, seed = given.pop("budget"), given.pop("seed")
    arguments = design_arguments(given)
    limits, duration = arguments.pop("limits"), arguments.pop("duration")
    request = request_of(given)
    model = known_problem(problem, request)
    with output.work(model.name) as (folder, progress):
        fitted, hold_out = request.experiments(model)
        if isinstance(hold_out, list):
            raise DataError(
                "--hold-out names a file; an investigation takes records one after another, and "
                "holds a share of each out: --hold-out 0.3, or 0 to fit everything"
            )
        output.print_provenance(fitted)
        from casid.diagnosis.investigation import investigate as run

        found = run(
            model,
            fitted,
            limits,
            duration,
            diagnosis={"hold_out": hold_out, "budget": budget, "seed": seed},
            progress=progress,
            seed=seed,
            **arguments,
        )
        found.write(folder)
    if not output.quiet:
        say(f"wrote {folder / 'report.html'} and {folder / 'investigation.json'}")
        if found.next is not None:
            say(f"record {folder / 'input.csv'} next")
    if output.as_json:
        print_json(found.to_json())
    else:
        print_text(str(found))
