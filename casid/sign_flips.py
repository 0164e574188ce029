"""Channels that are taken the wrong way round: a sign flip is a scale of -1.

A flip of one channel changes the signs of some coefficients of the difference equation and leaves
its misfit as it is, so no residual shows it where the parameters may have either sign. What shows
it is physics: bounds, and parameters that several coefficients share. So every channel is flipped
in turn, the physical parameters are estimated within their bounds from either, and a flip that the
equations fit clearly better is suspected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.data import Experiment
from casid.errors import CasidError
from casid.instrumental.estimators import least_squares
from casid.model import Model
from casid.problem import Problem


@dataclass(frozen=True, slots=True)
class SignFlip:
    """What flipping one channel does to the misfit of the difference equations.

    Attributes
    ----------
    channel : of the records.
    ratio : rms equation error with the channel flipped, relative to that as recorded; geometric
        mean over records. Infinite where no estimate is found with it flipped. Where there is none
        as recorded, relative to the worst of the flips.
    is_suspected : the flip is clearly better.
    """

    channel: str
    ratio: float
    is_suspected: bool

    def __str__(self) -> str:
        if not self.is_suspected:
            return (
                f"{self.channel}: no sign flip suspected (misfit flipped/recorded {self.ratio:.3g})"
            )
        return (
            f"{self.channel}: probably recorded with the wrong sign, a scale of -1: with "
            f"-{self.channel} the physical model misses by {self.ratio:.2g} of what it does as "
            "recorded. Compare the sensor's axes with the model's (an axis that points up where "
            "the model's points down), and negate the channel: "
            f"record.with_channel({self.channel!r}, -record[{self.channel!r}], unit)"
        )


def sign_flips(
    problem: Problem | Model, experiments: Sequence[Experiment], *, clearly: float = 0.95
) -> tuple[SignFlip, ...]:
    """Flip every channel of the model in turn, the one that is most suspected first.

    Parameters
    ----------
    problem : whose model has no unknown inputs, with bounds that mean something.
    experiments : with their load cases.
    clearly : ratio of the misfits under which a flip is suspected (a heuristic). Only the best of
        the flips is: where one sign is wrong, others may help a little.

    Raises
    ------
    CasidError
        As `least_squares`, if there is no estimate with any of the flips, nor as recorded.
    """
    model = problem.model if isinstance(problem, Problem) else problem
    failed: CasidError | None = None
    try:
        recorded = _misfit(model, experiments)
    except CasidError as error:
        recorded, failed = np.inf, error
    found: dict[str, float] = {}
    for channel in (*model.outputs, *(n for n, u in model.inputs.items() if u.kind != "generated")):
        flipped = [
            replace(
                e,
                record=e.record.with_channel(channel, -e.record[channel], e.record.units[channel]),
            )
            for e in experiments
        ]
        try:
            found[channel] = _misfit(model, flipped)
        except CasidError:
            found[channel] = np.inf
    if failed is not None:
        if not np.isfinite(list(found.values())).any():
            raise failed
        recorded = max(f for f in found.values() if np.isfinite(f))
    ratios = {c: f / recorded for c, f in found.items()}
    best = min(ratios, key=lambda c: ratios[c])
    rows = [SignFlip(c, r, c == best and r < clearly) for c, r in ratios.items()]
    return tuple(sorted(rows, key=lambda f: f.ratio))


def _misfit(model: Model, experiments: Sequence[Experiment]) -> float:
    """Geometric mean over equations of their rms error, each relative to its left side."""
    (stage,) = least_squares(model, experiments).stages
    logs = [
        np.log(e.error_power(theta) / max(float(e.second[0, 0]), 1e-300)) / 2
        for e, theta in zip(stage.equations, stage.thetas, strict=True)
    ]
    return float(np.exp(np.mean(logs)))
