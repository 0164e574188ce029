"""`casid identifiability`."""

from __future__ import annotations

from typing import Any

import click

from casid.cli.identifiability_options import (
    ASSUMPTION_OPTIONS,
    QUESTION_OPTIONS,
    Question,
    is_equation_file,
    read_equations_for,
)
from casid.cli.interrupt import interruptible
from casid.cli.options import (
    DATA_OPTIONS,
    OUTPUT_OPTIONS,
    SET_OPTION,
    folder_options,
    options,
    seed_option,
)
from casid.cli.output import Output, taken
from casid.cli.problem_file import known_problem
from casid.cli.request import request_of


@click.command()
@click.argument("problem", metavar="PROBLEM|EQUATIONS", type=click.Path())
@click.argument("data", nargs=-1)
@options(*ASSUMPTION_OPTIONS, *QUESTION_OPTIONS)
@options(
    *DATA_OPTIONS,
    SET_OPTION,
    seed_option("Seed of the random points."),
    *folder_options("a new reports/<problem>-<n>", "Write into a folder that is not empty."),
    *OUTPUT_OPTIONS,
)
def identifiability(problem: str, seed: int, **given: Any) -> None:
    """Decide which parameters are identifiable, and what would make the others so.

    PROBLEM is a problem file (.py), analysed for the load cases and inputs of DATA or of its own
    example, with the expected errors; EQUATIONS is a JSON or TOML file of states, parameters,
    inputs and outputs, without any Python. Every experiment has unknown inputs of its
    own unless --shared-input says otherwise. Writes identifiability.json and report.html.

    Example: casid identifiability problems/pendulum.py nominal=a.csv b.csv --known k

    Equations: casid identifiability model.toml --sensor angle=x1 --known-initial x1,x2=0
    """
    output, question = taken(Output, given), taken(Question, given)
    request = request_of(given)
    assuming, candidates = question.assumptions(), question.candidates()
    subject: Any
    if is_equation_file(problem):
        subject = read_equations_for(problem, request)
    else:
        subject = known_problem(problem, request)
    with output.work(subject.name) as (folder, progress):
        from casid.identifiability.procedure import assess_identifiability

        experiments = None
        if not is_equation_file(problem) and (request.data or subject.example is not None):
            experiments, _ = request.experiments(subject)
            output.print_provenance(experiments)
        with interruptible():
            result = assess_identifiability(
                subject,
                experiments,
                assuming=assuming,
                candidates=candidates,
                symbolic=not question.structural,
                practical=not question.structural,
                profiles=question.profiled(),
                time_limit=question.time_limit,
                seed=seed,
                progress=progress,
            )
        progress("write the report")
        result.write(folder)
    output.finish(result, folder, "identifiability.json")
