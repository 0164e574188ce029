"""What casid says of channels with the wrong sign, and of a ship on a straight course."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casid
from analysis.ship_bias.records import IMPERFECTIONS, Rudder, answers
from analysis.ship_bias.table import SOUGHT, by_instruments, model_at_truth, with_background
from casid.identification.moment_estimators import least_squares
from casid.identification.signs_from_moments import sign_flips
from problems import ship

CHANNELS = ("r", "accel", "gyro", "delta")


def flipped(experiments: Sequence[casid.Experiment], channel: str) -> list[casid.Experiment]:
    """The records with a channel negated."""
    return [
        replace(
            e,
            record=e.record.with_channel(channel, -e.record[channel], e.record.units[channel]),
        )
        for e in experiments
    ]


def suspected(imperfection: str, *, seconds: float, seed: int) -> dict[str, str]:
    """Channel that is flipped ("" for none) -> channel that is suspected ("" for none)."""
    wrong = with_background(IMPERFECTIONS[imperfection])
    recorded = [a.experiment(wrong) for a in answers(seed, Rudder(), seconds=seconds)]
    found = {}
    for channel in ("", *CHANNELS):
        given = flipped(recorded, channel) if channel else recorded
        best = sign_flips(ship.problem, given, reference="delta")[0]
        found[channel] = best.channel if best.is_suspected else ""
    return found


def straight_course(*, seconds: float, seed: int, jitter: float = 0.0) -> dict[str, str]:
    """What the estimators say where the rudder rests, or only trembles by `jitter` [rad]."""
    wrong = replace(with_background(IMPERFECTIONS["all of these"]), heel=0.0, gyro_bias=0.0)
    made = answers(seed, Rudder(angle=jitter, hold=0.2), seconds=seconds)
    records = [a.experiment(wrong) for a in made]
    said = {}
    model = model_at_truth()
    try:
        found = by_instruments(model, records)
        said["instruments"] = ", ".join(
            f"{n} = {found[n]:.3g} +- {found.std_error(n):.2g}" for n in SOUGHT
        )
    except casid.CasidError as error:
        said["instruments"] = f"{type(error).__name__}: {error}"
    by_squares = least_squares(model, records)
    said["least squares"] = ", ".join(f"{n} = {by_squares[n]:.3g}" for n in SOUGHT)
    said["warnings"] = "; ".join(by_squares.estimate.warnings)
    return said
