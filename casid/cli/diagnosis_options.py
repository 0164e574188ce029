"""The options of `casid diagnose` beside those of its records."""

from __future__ import annotations

from typing import Any

import click

from casid.cli.options import CATALOGUE_OPTIONS, budget_option, jobs_option


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
        help="Probability that an adequate model is called deficient, for the whole catalogue of "
        "effects together.",
    ),
    click.option(
        "--calibrate",
        is_flag=False,
        flag_value=200,
        type=_Count(min=1),
        metavar="[N]",
        help="Calibrate that rate on this record: simulate N records with the fitted model, "
        "diagnose each, and use the threshold that they give. Default 200; the expected time is "
        "printed first, and Ctrl-C continues with the records done.",
    ),
    budget_option(
        "Time limit of the diagnosis: it then reports what was found and lists what was not done. "
        "Default 600 s; the records of --calibrate are not limited by default."
    ),
    jobs_option("Processes for --calibrate; default one per core."),
    *CATALOGUE_OPTIONS,
)
"""Settings of the search for causes."""
