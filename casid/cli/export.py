"""`casid export`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from casid.cli.request import parse_setting
from casid.cli.result_file import fitted_model
from casid.cli.terminal import say
from casid.data.files import refuse_existing


@click.command()
@click.argument("result", type=click.Path())
@click.option(
    "--as",
    "target",
    required=True,
    metavar="TARGET",
    help="problem (a Python problem file), casadi, c, control (a state space), modelica or fmu.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    metavar="PATH",
    help="The file; its ending is added where it has none.",
)
@click.option(
    "--at",
    multiple=True,
    metavar="NAME=VALUE",
    help="Operating point of a state space: a state or input, in its declared unit. Where not "
    "given: 0 if the fitted record passes through it, else its mean there. Repeatable.",
)
@click.option(
    "--pade",
    type=int,
    metavar="ORDER",
    help="Order of the Pade approximation that replaces delays in a state space.",
)
@click.option(
    "--without-delays",
    is_flag=True,
    help="Leave out the delays of sensors and inputs.",
)
@click.option("--force", is_flag=True, help="Write over a file that exists.")
def export(
    result: str,
    target: str,
    out: Path,
    at: tuple[str, ...],
    force: bool,
    **delays: Any,
) -> None:
    """Export a fitted model, with its causes, and its parameters at the estimates.

    RESULT is the folder that casid identify or casid diagnose wrote, or a saved result. Beside C
    stands a header, and beside a CasADi function a JSON file, with sample time, initial state,
    names and units.

    Example: casid export reports/pendulum-1 --as modelica --out Pendulum.mo
    """
    from casid.export.naming import checked_path
    from casid.export.targets import export as run
    from casid.export.targets import require_target

    require_target(target)
    path = checked_path(out, target)
    refuse_existing(path, force=force)
    model = fitted_model(result)
    point = dict(parse_setting(text, "--at") for text in at)
    say(f"wrote {run(model, target, path, at=point, say=say, **delays)}")
