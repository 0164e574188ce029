"""The remainder of the misfit, tested for its kind, and described where the model lacks something.

A remainder that depends on states and inputs, or changes in time, is a deficiency of the model.
What is stationary and depends on nothing is a disturbance. It acts on the system, the model does
not lack it: it is reported with its place and spectrum, and is no cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from casid.arrays import TINY, Array, robust_sd
from casid.diagnosis.evidence.disturbances import Disturbance, disturbances_of
from casid.diagnosis.evidence.residual.residual_tests import (
    DISTURBANCE,
    NOISE,
    ResidualTests,
    residual_tests,
    with_constancy,
)
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.residual_check import tested_residual
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import DESCRIPTION, ROUNDS
from casid.diagnosis.unexplained.description import Unexplained, unexplained

_RANDOM = (NOISE, DISTURBANCE)


@dataclass(frozen=True, slots=True, eq=False)
class Remainder:
    """The test of the remainder, and its description where it is a deficiency of the model."""

    p_value: float
    level: float
    unexplained: Unexplained | None = None
    disturbances: tuple[Disturbance, ...] = ()  # where it is none
    beside: Weighted | None = None  # the model under them, where it is simulated without

    @property
    def is_noise(self) -> bool:
        """True if the remainder is consistent with the noise of sensors and inputs."""
        return self.p_value >= self.level and not self.disturbances


def tested_remainder(at: Weighted, search: Search, adopted: Sequence[Adopted]) -> Remainder:
    """Test the residual of the last model; describe it where it is deterministic or changes."""
    level = (2 if adopted else 1) * ROUNDS.residual_share * search.alpha
    tests = tested_residual(at, search, level)
    if not at.noise_absorbs_misfit and tests.verdict in _RANDOM:
        tests = _with_constancy(tests, at, search, level)
    p_value = tests.adjusted
    if not at.noise_absorbs_misfit and tests.verdict in _RANDOM:
        beside = at if at.noise.spectra else None
        return Remainder(p_value, level, disturbances=disturbances_of(at, level), beside=beside)
    if at.noise_absorbs_misfit:
        # The residual was tested under the noise of sensors and inputs alone, of which it is much
        # more. With random forces in the noise, of spectra of their own, it may be nothing else.
        with_force = at.beside or search.under_disturbance(at.fit)
        again = _with_constancy(_tests(with_force, search, level), with_force, search, level)
        burst = _burst(again, with_force)
        if again.verdict in _RANDOM and burst >= level:
            found = disturbances_of(with_force, level)
            return Remainder(again.adjusted, level, disturbances=found, beside=with_force)
        # The spectrum of a random force may be any: it speaks for no deficiency.
        p_value = min(1.0, 3 * min(again.p_dependence, again.p_time), burst)
        if adopted and tests.verdict in _RANDOM:
            return Remainder(p_value, level)
    search.progress("describe the unexplained remainder")
    description = _description(at, search, level, tests)
    return Remainder(p_value, level, description)


def _with_constancy(
    tests: ResidualTests, at: Weighted, search: Search, level: float
) -> ResidualTests:
    """The tests with that of parameters that come and go, which no search is led by."""
    of = search.weighing
    return with_constancy(tests, at, of.experiments, search.recorded, alpha=level, seed=of.seed)


def _burst(tests: ResidualTests, at: Weighted) -> float:
    """p that one stretch is by chance as much louder than the others as the loudest is.

    1 where none is `DESCRIPTION.loud`. A stretch has no more independent samples than the spread
    of most of them shows. Loud is what is so in the residual and in its innovations.
    """
    return max(_loudest(blocks, at) for blocks in (tests.blocks, tests.innovation_blocks))


def _loudest(blocks: Array, at: Weighted) -> float:
    power = blocks[:, 2] / np.median(blocks[:, 2])
    spread = robust_sd(power - 1.0)
    Ts = at.criterion.data[0].Ts
    count = (blocks[:, 1] - blocks[:, 0]) / Ts * len(at.criterion.outputs)
    count = np.minimum(count, 2.0 / max(spread**2, TINY))
    p = len(power) * chi2.sf(power * count, count)
    return float(np.min(np.where(power > DESCRIPTION.loud, p, 1.0)))


def _tests(at: Weighted, search: Search, level: float) -> ResidualTests:
    of = search.weighing
    return residual_tests(
        at, of.experiments, search.recorded, alpha=level, seed=of.seed, of_any_spectrum=True
    )


def described(start: Weighted, search: Search, level: float, p_value: float) -> Remainder:
    """Describe the whole misfit of the model as it is: the named causes explain it worse."""
    search.progress("describe the misfit by functions outside the catalogue")
    description = _description(start, search, level)
    return Remainder(p_value, level, description)


def _description(
    at: Weighted, search: Search, level: float, tests: ResidualTests | None = None
) -> Unexplained | None:
    """The description of a model's misfit, if it is more than noise."""
    of = search.weighing
    tests = tests or tested_residual(at, search, level)
    found = unexplained(at, of.experiments, search.recorded, alpha=level, seed=of.seed, tests=tests)
    return found if found.is_something else None
