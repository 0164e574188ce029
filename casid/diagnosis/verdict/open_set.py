"""The open set: the remainder when no effect of the catalogue explains more.

The remainder is tested for its kind (`residual_tests`). Where it depends on states and inputs, or
changes in time, the missing effect is not in the catalogue. It is then described instead of being
given the name of the nearest effect: a single named cause that leaves a good part of the misfit is
listed among the alternatives only.

What is stationary and depends on nothing is a disturbance. It acts on the system, the model does
not lack it: it is reported with its place and spectrum, and is no cause.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from casid.arrays import TINY, Array, robust_sd
from casid.diagnosis.evidence.disturbances import Disturbance, disturbances_of
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.evidence.residual_tests import (
    DISTURBANCE,
    NOISE,
    ResidualTests,
    residual_tests,
)
from casid.diagnosis.search.alternatives import is_imitator
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.residual_check import tested_residual
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import DESCRIPTION, JUDGING, ROUNDS
from casid.diagnosis.unexplained.description import Unexplained, unexplained
from casid.diagnosis.verdict.cause import Alternative, Cause
from casid.diagnosis.verdict.not_accepted import Refused
from casid.diagnosis.verdict.remainder import Remaining
from casid.diagnosis.verdict.unnamed_alternatives import UnnamedAlternative
from casid.model.effects.effect import OF_SAMPLES
from casid.model.effects.names import ANYWHERE, unknown_place

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
    p_value = tests.adjusted
    if not at.noise_absorbs_misfit and tests.verdict in _RANDOM:
        beside = at if at.noise.spectra else None
        return Remainder(p_value, level, disturbances=disturbances_of(at, level), beside=beside)
    if at.noise_absorbs_misfit:
        # The residual was tested under the noise of sensors and inputs alone, of which it is much
        # more. With random forces in the noise, of spectra of their own, it may be nothing else.
        with_force = at.beside or search.under_disturbance(at.fit)
        again = _tests(with_force, search, level)
        burst = _burst(again, with_force)
        if again.verdict in _RANDOM and burst >= level:
            found = disturbances_of(with_force, level)
            return Remainder(again.adjusted, level, disturbances=found, beside=with_force)
        # The spectrum of a random force may be any: it speaks for no deficiency.
        p_value = min(1.0, 3 * min(again.p_dependence, again.p_time), burst)
        if adopted and tests.verdict in _RANDOM:
            return Remainder(p_value, level)
    search.progress("describe the unexplained remainder")
    description = _description(at, search, level)
    return Remainder(p_value, level, description)


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


def _description(at: Weighted, search: Search, level: float) -> Unexplained | None:
    """The description of a model's misfit, if it is more than noise."""
    of = search.weighing
    tests = tested_residual(at, search, level)
    found = unexplained(at, of.experiments, search.recorded, alpha=level, seed=of.seed, tests=tests)
    return found if found.is_something else None


def with_the_unnamed_alternative(
    causes: Sequence[Cause], rival: UnnamedAlternative, remainder: Remainder | None = None
) -> list[Cause]:
    """The causes with an unnamed function among the alternatives of the first, or before them.

    Parameters
    ----------
    remainder : the description of the whole misfit, where the function is better: the named
        causes are then listed among the alternatives only.
    """
    named = [c for c in causes if c.kind not in OF_SAMPLES]
    others = [c for c in causes if c not in named]
    if not rival.is_better:
        first = named[0]
        with_it = replace(first, alternatives=(*first.alternatives, rival.alternative()))
        return [with_it if c is first else c for c in causes]
    why = f"{rival.function}, which is no effect of the catalogue, explains more"
    alternatives = tuple(Alternative(c.kind, c.where, c.p_value, why) for c in named)
    found = remainder.unexplained if remainder is not None else None
    cause = Cause(
        kind="unknown",
        where=rival.place,
        p_value=min(c.p_value for c in named),
        parameters=(),
        alternatives=alternatives,
        share=sum(c.share for c in named),
        sentence=f"an unidentified term in {rival.place}: {rival.function} explains it better than "
        "any effect of the catalogue",
        description=found.sentence if found is not None else "",
    )
    return [cause, *others]


def with_the_unknown(
    causes: Sequence[Cause],
    remainder: Remainder,
    remaining: Remaining | None,
    refused: Refused = (),
    *,
    is_disturbed: bool = False,
) -> list[Cause]:
    """The causes with one of kind "unknown", where the remainder is too large for a named cause.

    Parameters
    ----------
    is_disturbed : the causes were found together with a random disturbance, and stay named: its
        variance, and so the share that they leave, is uncertain where a record has few periods.
    refused : candidates that were significant but not adopted, and why, the best first: where
        nothing is named, the nearest of the catalogue.
    """
    found = remainder.unexplained
    assert found is not None
    share = remaining.unexplained if remaining is not None else 1.0
    named = [c for c in causes if c.kind not in OF_SAMPLES]
    if named and (is_disturbed or share < JUDGING.doubtful):
        return list(causes)
    where = found.where or (named[0].where if named else ANYWHERE)
    alternatives: tuple[Alternative, ...] = ()
    others = list(causes)
    if len(named) == 1 and named[0].kind != "unknown":
        nearest = named[0]
        others.remove(nearest)
        why = (
            f"the nearest effect of the catalogue: it explains {100 * (1 - share):.0f} % of the "
            "excess misfit, and the remainder is not noise"
        )
        alternatives = (
            Alternative(nearest.kind, nearest.where, nearest.p_value, why, nearest.description),
            *(a for a in nearest.alternatives if a.kind != "unknown"),  # as near as the nearest
        )
        unknown = _unknown(where, remainder, alternatives, share=nearest.share)
        return [unknown, *others]
    if not named:
        alternatives = tuple(_nearest(refused))
    return [*others, _unknown(where, remainder, alternatives, share=share)]


def _nearest(refused: Refused) -> Iterator[Alternative]:
    """Named effects that explain much of what was fitted, and what speaks against each."""
    keys: set[tuple[str, str]] = set()
    for c, why in refused:
        is_new = c.effect.key not in keys and c.effect.kind != "unknown" and not is_imitator(c)
        if is_new and len(keys) < ROUNDS.rivals:
            keys.add(c.effect.key)
            text = f"significant and of a similar effect, but {why.text}"
            kind, where, description = c.effect.kind, c.effect.where, c.effect.description
            yield Alternative(kind, where, 1.0, text, description, has_reason=True)


def _unknown(
    where: str, remainder: Remainder, alternatives: tuple[Alternative, ...], *, share: float
) -> Cause:
    assert remainder.unexplained is not None
    return Cause(
        kind="unknown",
        where=where,
        p_value=max(remainder.p_value, TINY),
        parameters=(),
        alternatives=alternatives,
        share=share,
        sentence=f"an unidentified term in {unknown_place(where)}: no effect of the catalogue "
        "explains it",
        description=remainder.unexplained.sentence,
    )
