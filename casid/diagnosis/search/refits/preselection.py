"""Which candidates are refitted on long records, chosen by refits on their first part.

A refit simulates every sample dozens of times, and 20 000 samples reject a poor candidate as well
as ten times as many. The part is the records' beginning: there known initial states hold, those of
a cause that starts at rest among them. What the candidates gain is compared there under the noise
of the whole.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import TINY
from casid.data.experiment import Experiment
from casid.diagnosis.evidence.scores.score_tests import Score
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.diagnosis.thresholds import COMPARISON, ROUNDS


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Start of a refit: a score, or a candidate found on a part of the records."""

    score: Score
    found: Candidate | None = None  # on the part


def preselected(
    refitting: Refitting,
    at: Weighted,
    short: Sequence[Score],
    progress: Callable[[str], None] = lambda _: None,
) -> list[Start]:
    """The scores whose candidates are to be refitted on the whole, with what the part found.

    All of them, without anything found, where the records are short, where the misfit hardly shows
    in their first part, or where fewer than three would be compared.
    """
    everything = [Start(s) for s in short]
    # Of kinds on the clock the part says nothing: they are refitted on the whole.
    compared = [s for s in short if not s.effect.is_on_the_clock]
    samples = [d.N for d in at.criterion.data]
    share = ROUNDS.part / sum(samples)
    if sum(samples) <= ROUNDS.long or at.criterion.own or len(compared) < ROUNDS.fewest_compared:
        return everything
    if _misfit_in_head(at, share) < ROUNDS.head_misfit * share:
        return everything
    heads = [head_of(e, share) for e in refitting.weighing.experiments]
    weighing = replace(refitting.weighing, experiments=heads)
    small = Refitting(weighing, refitting.left_out, refitting.attempts)
    part = replace(at, fit=weighing.fitted(at.model, at, at.fit.values), unbiased=None)
    found: dict[tuple[str, str], Candidate | None] = {}
    best = 0.0
    for i, s in enumerate(compared):
        progress(f"refit on a part {i + 1}/{len(compared)}: {s.effect!r}")
        below = part.fit.solution.value - 0.5 * ROUNDS.kept * best
        c = found[s.effect.key] = small.refit(part, s.effect, s.step, starts=s.starts, below=below)
        best = max(best, c.gain if c is not None else 0.0)
    out = []
    for s in short:
        c = found.get(s.effect.key)
        if c is None or c.gain >= ROUNDS.kept * best - COMPARISON.by_chance:
            out.append(Start(s, c))
    return out


def _misfit_in_head(at: Weighted, share: float) -> float:
    """Share of the whitened residual's sum of squares in the first part of the records."""
    inside = total = 0.0
    for e, d in enumerate(at.criterion.data):
        power = np.sum(at.criterion.columns(at.fit.x, e)[0] ** 2, axis=1)
        inside += float(power[: round(share * d.N)].sum())
        total += float(power.sum())
    return inside / max(total, TINY)


def head_of(experiment: Experiment, share: float) -> Experiment:
    """The first `share` of an experiment's samples."""
    record = experiment.record
    last = record.t0 + (round(share * record.N) - 1) * record.Ts
    return replace(experiment, record=record.between(-np.inf, last))
