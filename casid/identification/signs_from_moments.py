"""Channels with the wrong sign, found from moments: a sign flip is a scale of -1.

A flip of one channel changes the signs of some coefficients of the difference equation and leaves
its misfit as it is, so no residual shows it where the parameters may have either sign. What shows
it is physics: bounds, and parameters that several coefficients share. So every channel is flipped
in turn, the physical parameters are estimated within their bounds from either, and a flip that the
equations fit clearly better is suspected.

Two measures of fit. Without a reference it is the equation error of least squares: where noise on
the regressors makes most of that, both signs miss by as much. With an external reference it is

    J = sum over records of N m' S^-1 m,   m = mean zeta (left - columns' theta)              (1)

of instruments zeta made of the reference alone (`black_box_reference`), with S
the covariance of N^(1/2) m from the unconstrained fit, which knows no signs. Noise drops out of m,
and J is chi^2 where the signs are right (Hansen, Econometrica 50 (1982) 1029-1054).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from casid.arrays import TINY
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.errors import CasidError
from casid.estimation.moments.equations.parts import parts_of
from casid.estimation.moments.instruments.black_box_reference import (
    black_box_instruments,
    black_box_references,
)
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.stage import Stage
from casid.identification.channel_signs import negated, sign_correction
from casid.identification.moment_estimators import least_squares
from casid.model.model import Model


@dataclass(frozen=True, slots=True)
class SignFlip:
    """What flipping one channel does to the misfit of the difference equations.

    Attributes
    ----------
    channel : of the records.
    ratio : misfit with the channel flipped, relative to that as recorded: rms equation error,
        geometric mean over records, or the root of (1). Infinite where no estimate is found with
        it flipped. Where there is none as recorded, relative to the worst of the flips.
    is_suspected : the flip is clearly better.
    p_value : of (1) as recorded, corrected for the number of channels, at least 1e-16: its law
        is not reliable further out. None without a reference, or without an estimate as recorded.
    is_rival : (1) does not distinguish this flip from the suspected one.
    """

    channel: str
    ratio: float
    is_suspected: bool
    p_value: float | None = None
    is_rival: bool = False

    def __str__(self) -> str:
        if not self.is_suspected:
            return (
                f"{self.channel}: no sign flip suspected (misfit flipped/recorded {self.ratio:.3g})"
            )
        return (
            f"{self.channel}: probably recorded with the wrong sign, a scale of -1: with "
            f"-{self.channel} the physical model misses by {self.ratio:.2g} of what it does as "
            f"recorded. {sign_correction(self.channel)}"
        )


def sign_flips(
    problem: Problem | Model,
    experiments: Sequence[Experiment],
    *,
    reference: str | None = None,
    clearly: float = 0.95,
) -> tuple[SignFlip, ...]:
    """Flip every channel of the model in turn, the one that is most suspected first.

    Parameters
    ----------
    problem : whose model has no unknown inputs, with bounds that mean something.
    experiments : with their load cases.
    reference : recorded channel that drives the system and does not depend on the noise. With it
        the signs are found through noise of any size: a flip is suspected where (1) rejects the
        signs as recorded at 0.1 %, and falls by more than `FALLS`.
    clearly : without a reference, ratio of the misfits under which a flip is suspected (a
        heuristic). Only the best of the flips is: one wrong sign, and others may help a little.

    Raises
    ------
    CasidError
        As `least_squares` or `black_box_references`, if there is no estimate with any of the
        flips, nor as recorded.
    """
    model = problem.model if isinstance(problem, Problem) else problem
    misfit: Callable[[Sequence[Experiment]], Fitted] = partial(_by_squares, model)
    if reference is not None:
        others = [c for c in _channels(model) if c != reference]
        black = black_box_references(experiments, reference, others)
        experiments = black.experiments
        chosen = black_box_instruments(model, black, n_y=LAGS, n_u=LAGS)
        misfit = partial(_by_instruments, model, chosen)
    failed: CasidError | None = None
    recorded = Fitted(np.inf, 0)
    try:
        recorded = misfit(experiments)
    except CasidError as error:
        failed = error
    found = {c: _flipped(misfit, experiments, c) for c in _channels(model)}
    if failed is not None:
        finite = [f for f in found.values() if np.isfinite(f.value)]
        if not finite:
            raise failed
        recorded = max(finite)
    best = min(found, key=lambda c: found[c])
    if reference is None:
        is_wrong = found[best].value < clearly * recorded.value
    else:
        is_wrong = failed is not None or recorded.rejects(found[best])
    if reference is None:
        rows = [
            SignFlip(c, f.value / recorded.value, c == best and is_wrong) for c, f in found.items()
        ]
    else:
        p = None if failed is not None else min(1.0, len(found) * max(recorded.p_value, 1e-16))
        rows = [
            SignFlip(
                c,
                (f.value / recorded.value) ** 0.5,
                c == best and is_wrong,
                p,
                c != best and is_wrong and np.isfinite(f.value) and not f.rejects(found[best]),
            )
            for c, f in found.items()
        ]
    return tuple(sorted(rows, key=lambda f: f.ratio))


def _flipped(
    misfit: Callable[[Sequence[Experiment]], Fitted],
    experiments: Sequence[Experiment],
    channel: str,
) -> Fitted:
    """The misfit with one channel negated, infinite where there is no estimate."""
    try:
        return misfit(negated(experiments, channel))
    except CasidError:
        return Fitted(np.inf, 0)


LAGS = 4
"""Of every simulated signal among the instruments."""

FALLS = 20.0
"""Fall of (1) for which a sign is suspected, in units of what the better fit leaves a degree."""


class Fitted(NamedTuple):
    """A misfit, and its degrees of freedom."""

    value: float
    degrees: int

    def rejects(self, better: Fitted) -> bool:
        """True if the moments reject these signs, and `better` is clearly better."""
        scale = max(better.value / max(better.degrees, 1), 1.0)
        return self.p_value < 1e-3 and self.value - better.value > FALLS * scale

    @property
    def p_value(self) -> float:
        """p-value of (1), which is chi^2 where the signs are right."""
        return float(chdtrc(max(self.degrees, 1), self.value))


def _channels(model: Model) -> list[str]:
    return [*model.outputs, *(n for n, u in model.inputs.items() if u.kind != "generated")]


def _by_instruments(model: Model, chosen: Instruments, experiments: Sequence[Experiment]) -> Fitted:
    """(1) at its minimum within the bounds.

    However weak the instruments are: a direction that they do not see has no part in (1).
    """
    settings = MomentSettings(weighting="optimal", iterations=1)
    parts = parts_of(model, experiments, method=settings.method, outputs=settings.outputs)
    free = [
        p.name
        for p in model.parameters.values()
        if not p.is_known and not all(p.name in e.known for e in experiments)
    ]
    fit = Stage(model, parts, free, settings, chosen).fit(
        parts, [p.values for p in parts], check=False
    )
    left = [
        root @ (e.Y - e.Phi @ theta)
        for root, e, theta in zip(fit.roots, fit.equations, fit.thetas, strict=True)
    ]
    return Fitted(float(sum(m @ m for m in left)), sum(map(len, left)) - len(free))


def _by_squares(model: Model, experiments: Sequence[Experiment]) -> Fitted:
    """Geometric mean over equations of their rms error, each relative to its left side."""
    (stage,) = least_squares(model, experiments).stages
    logs = [
        np.log(e.error_power(theta) / max(float(e.second[0, 0]), TINY)) / 2
        for e, theta in zip(stage.equations, stage.thetas, strict=True)
    ]
    return Fitted(float(np.exp(np.mean(logs))), 0)
