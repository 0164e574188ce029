"""The sign of a channel: records with a channel negated, and how to correct one for good."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from casid.data.experiment import Experiment
from casid.data.record import with_samples


def negated(experiments: Sequence[Experiment], channel: str) -> list[Experiment]:
    """The experiments with one channel negated."""
    return [
        replace(e, record=with_samples(e.record, channel, -e.record[channel])) for e in experiments
    ]


def sign_correction(channel: str) -> str:
    """What to compare, and the line of Python that negates a channel."""
    return (
        "Compare the sensor's axes with the model's (an axis that points up where the model's "
        f"points down), and negate it: in Python record.with_channel({channel!r}, "
        f"-record[{channel!r}], record.units[{channel!r}])"
    )
