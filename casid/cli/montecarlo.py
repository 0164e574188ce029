"""`casid montecarlo`."""

from __future__ import annotations

from typing import Any

import click

from casid.cli.options import (
    FIT_OPTIONS,
    OUTPUT_OPTIONS,
    FitOptions,
    budget_option,
    folder_options,
    jobs_option,
    options,
    seed_option,
)
from casid.cli.output import Output, taken
from casid.cli.problem_file import known_problem
from casid.cli.request import request_of
from casid.cli.terminal import quiet_stdout, study_folder, workers


@click.command()
@click.argument("problem", type=click.Path())
@click.option(
    "--runs",
    type=click.IntRange(min=1),
    default=200,
    show_default=True,
    metavar="N",
    help="Total number of runs; those already in the folder are not repeated.",
)
@click.option(
    "--method",
    default="identify",
    show_default=True,
    metavar="NAME",
    help="The estimator of every run.",
)
@click.option(
    "--duration",
    type=float,
    metavar="S",
    help="Use the first S seconds of every simulated record; default whole records.",
)
@jobs_option("Number of processes; default one per core.")
@click.option(
    "--dask",
    metavar="ADDRESS",
    help="Work on the cluster of this Dask scheduler instead, as in tcp://host:8786. Its workers "
    "need casid, and the problem at the same path.",
)
@budget_option(
    "Time limit of the study: the runs finished by then count, and the same command does the "
    "others. Default none; each fit has its own budget.",
)
@options(
    *FIT_OPTIONS,
    seed_option("Seed of the study, from which each run derives its own."),
    *folder_options(
        "reports/<problem>-montecarlo-<n>, the last one if it holds this very study",
        "Start again in a folder that is not empty.",
    ),
    *OUTPUT_OPTIONS,
)
def montecarlo(problem: str, runs: int, method: str, duration: float | None, **given: Any) -> None:
    """Simulate a problem many times and compare its estimates with the known truth.

    Bias and standard deviation of the estimates, and coverage of the intervals, each with its
    uncertainty. The problem has to simulate itself: `casid.Problem(..., simulate=, truth=)`. An
    interrupted study continues with the same command. Writes results.parquet, montecarlo.json and
    report.html.

    Example: casid montecarlo problems/roll_decay.py --runs 1000 --out study
    """
    output, fit = taken(Output, given), taken(FitOptions, given)
    budget = given.pop("budget")
    at_work = workers(given.pop("jobs"), given.pop("dask"))
    model = known_problem(problem, request_of(given))
    from casid.campaigns.monte_carlo import Study

    study = Study(model, method, fit.settings(model, seed=0), duration)
    manifest = study.manifest(fit.seed)
    with study_folder(output.out, model.name, manifest, force=output.force) as folder:
        with quiet_stdout(), at_work:
            result = study.run(
                runs,
                seed=fit.seed,
                out=folder,
                resume=not output.force,
                progress=not output.quiet,
                budget=budget,
            )
            result.write(folder)
    output.finish(result, folder, "montecarlo.json")
