"""The options that several commands have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from casid.cli.reading_options import READING_OPTIONS

if TYPE_CHECKING:
    from casid.data.problem import Problem
    from casid.estimation.nlp.solver import Solver
    from casid.estimation.simulation.fit import FitSettings


def map_option(help: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The option --map."""
    return click.option(
        "--map",
        "maps",
        multiple=True,
        metavar="SIGNAL=COLUMN[:UNIT]",
        help=f"{help} Repeatable.",
    )


DATA_OPTIONS = (
    map_option(
        "Column of a signal, and its unit in the file, as in phi=roll:deg; t=COLUMN names the time "
        "stamps."
    ),
    click.option(
        "--window",
        metavar="START:STOP",
        help="Use this part of the record only, in seconds of its own clock, as in 27:91; "
        "run.csv@12:194 sets the window of one file.",
    ),
    click.option(
        "--resample",
        type=float,
        metavar="TS",
        help="Interpolate irregular records onto this sample time [s].",
    ),
    click.option(
        "--lowpass",
        type=float,
        metavar="HZ",
        help="Low-pass filter all channels alike (zero phase); the first step of three.",
    ),
    click.option(
        "--decimate",
        type=click.IntRange(min=1),
        default=1,
        metavar="N",
        help="Keep every N-th sample after an anti-alias filter; the second step.",
    ),
    click.option(
        "--detrend", is_flag=True, help="Subtract the mean of every channel; the last step."
    ),
    *READING_OPTIONS,
)
"""Where records come from, and how they are prepared."""

SET_OPTION = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="NAME=VALUE",
    help="A parameter that is known, in its declared unit. Repeatable.",
)

DEFAULT_SOLVER = "ipopt"

FIT_OPTIONS = (
    SET_OPTION,
    click.option(
        "--starts",
        type=click.IntRange(min=1),
        metavar="N",
        help="Starts of the estimation; the best optimum is kept. Default: the problem's.",
    ),
    click.option(
        "--solver",
        default=DEFAULT_SOLVER,
        show_default=True,
        metavar="NAME",
        help="A CasADi NLP solver.",
    ),
)
"""How a fit is made."""


@dataclass(frozen=True, slots=True)
class FitOptions:
    """The values of `FIT_OPTIONS` and --seed."""

    starts: int | None
    solver: str
    seed: int

    def own_solver(self) -> Solver | None:
        """The solver if it is not the default, which the library tunes to each of its fits."""
        from casid.estimation.nlp.solver import Solver

        return None if self.solver == DEFAULT_SOLVER else Solver(self.solver)

    def settings(
        self,
        problem: Problem,
        *,
        segments: int = 1,
        seed: int | None = None,
        own: tuple[str, ...] = (),
    ) -> FitSettings:
        """Settings of a fit, the number of starts by default the problem's."""
        from casid.estimation.nlp.solver import Solver
        from casid.estimation.simulation.fit import FitSettings

        return FitSettings(
            starts=problem.starts if self.starts is None else self.starts,
            segments=segments,
            own=own,
            solver=Solver(self.solver),
            seed=self.seed if seed is None else seed,
        )


OUTPUT_OPTIONS = (
    click.option("--json", "as_json", is_flag=True, help="Print the result as JSON."),
    click.option("--quiet", is_flag=True, help="Print no progress, only errors."),
)
"""What is printed."""


def seed_option(help: str) -> Any:
    """The option --seed."""
    return click.option(
        "--seed", type=click.IntRange(min=0), default=0, show_default=True, help=help
    )


def budget_option(help: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The option --budget."""
    return click.option(
        "--budget",
        type=click.FloatRange(min=0.0, min_open=True),
        metavar="SECONDS",
        help=help,
    )


def jobs_option(help: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The option --jobs."""
    return click.option("--jobs", type=click.IntRange(min=1), metavar="N", help=help)


CATALOGUE_OPTIONS = (
    click.option(
        "--max-causes",
        type=click.IntRange(min=1),
        default=4,
        show_default=True,
        metavar="N",
        help="Largest number of causes to search for in one diagnosis.",
    ),
    click.option(
        "--without",
        multiple=True,
        metavar="KIND",
        help="Leave a kind of effect out of the catalogue, as in --without offset. Repeatable.",
    ),
)
"""How far the catalogue of effects is searched."""


def folder_options(default: str, force: str) -> tuple[Any, Any]:
    """The options --out and --force."""
    return (
        click.option(
            "--out",
            type=click.Path(path_type=Path),
            metavar="DIR",
            help=f"Folder of the results; default {default}.",
        ),
        click.option("--force", is_flag=True, help=force),
    )


def options(*options: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command these options, in this order."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


record_options = options(
    *DATA_OPTIONS,
    *FIT_OPTIONS,
    seed_option("Seed of the random starts."),
    *folder_options("a new reports/<problem>-<n>", "Write into a folder that is not empty."),
    *OUTPUT_OPTIONS,
)
"""The options of what works on records."""


def hold_out_option(default: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """The option --hold-out."""
    return click.option(
        "--hold-out",
        "hold_out",
        multiple=True,
        default=(default,),
        metavar="FILE|SHARE",
        help="Not fitted: this share at the end of every record (0: fit everything), or a file. "
        "A file is simulated on its own and may carry a load case and a window; --window does not "
        "apply to it. A change at an instant acts in another window of the file that is fitted; a "
        f"file on another clock neither confirms nor refutes it. Default {default}.",
    )
