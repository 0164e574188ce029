"""The options of `casid diagnose` beside those of its records."""

from __future__ import annotations

from typing import Any

import click

from casid.cli.options import budget_option


class _Count(click.IntRange):
    """A number that may be left out, and then does not take the argument behind it."""

    name = "count"

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        """The number, or a refusal that says where the option may be given without one."""
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter:
            self.fail(
                f"{value!r} is no number of records from 1 on; give one, as in --calibrate 200, or "
                "put --calibrate alone behind the data",
                param,
                ctx,
            )


DIAGNOSIS_OPTIONS = (
    click.option(
        "--false-alarm-rate",
        type=float,
        default=0.05,
        show_default=True,
        metavar="RATE",
        help="How often a model that lacks nothing may be called deficient: one rate for the whole "
        "catalogue of effects.",
    ),
    click.option(
        "--calibrate",
        is_flag=False,
        flag_value=200,
        type=_Count(min=1),
        metavar="[N]",
        help="Calibrate that rate on this very record: simulate N records with the fitted model, "
        "diagnose each, and judge at the threshold that they set. Default 200; the time it "
        "takes is printed first, and Ctrl-C goes on with what is done.",
    ),
    budget_option(
        "Time that the diagnosis may take: it reports what was found until then, and lists what "
        "was not done. Default 600 s, and for --calibrate what it takes."
    ),
    click.option(
        "--jobs",
        type=click.IntRange(min=1),
        metavar="N",
        help="Processes that calibrate; default one for every core.",
    ),
    click.option(
        "--max-causes",
        type=click.IntRange(min=1),
        default=4,
        show_default=True,
        metavar="N",
        help="Stop the search there.",
    ),
    click.option(
        "--without",
        multiple=True,
        metavar="KIND",
        help="Leave a kind of effect out of the catalogue, as in --without offset. Repeatable.",
    ),
)
"""Settings of the search for causes."""
