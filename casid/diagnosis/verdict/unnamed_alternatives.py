"""Functions without a name that explain the misfit as well as what was named, or better.

A cause that is not in the catalogue may lie so near to one that is that no remainder shows it. The
record may still say that a function which the catalogue does not have explains as much. Every
function of states, inputs, channels and time (`candidate_functions`) is therefore compared with the
causes that were adopted, on the baseline, by

    gain - k log N                                                                             (1)

with the gain linear in the function's size, and for the causes the larger of the linear one and
their refits'. A function that the causes themselves express is none of these: with them in the
model, little of its signature is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.diagnosis.evidence.residual.candidate_functions import regressions
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import COMPARISON, JUDGING
from casid.diagnosis.verdict.cause import Alternative


@dataclass(frozen=True, slots=True)
class UnnamedAlternative:
    """A function of what is known, in one place."""

    place: str  # balance or output
    function: str  # in words, like "phi growing in time"
    gain: float  # sum of squares that it explains
    ahead: float  # units of BIC by which it is better than the causes
    own: float  # share of its signature that the causes do not express

    @property
    def is_better(self) -> bool:
        """True if the causes are rejected against it."""
        return self.ahead > COMPARISON.strong

    def alternative(self) -> Alternative:
        """The function as an alternative of a cause."""
        return Alternative(
            "unknown",
            self.place,
            1.0,
            f"{self.function}, which is no effect of the catalogue, explains as much",
            self.function,
        )


def unnamed_alternatives(
    search: Search,
    start: Weighted,
    at: Weighted,
    adopted: Sequence[Adopted],
) -> tuple[UnnamedAlternative, ...]:
    """Functions that the record cannot reject against the causes together, best first.

    None where the noise model absorbs misfit: (1) is no likelihood there; the remainder decides.

    Parameters
    ----------
    start, at : the model as it is and with the causes, under the noise found there.
    """
    if not adopted or search.gains_are_no_likelihoods(start):
        return ()
    if adopted[0].candidate.effect.kind == "unknown":
        return ()
    table = adopted[0].candidate.score
    linear = table.unrobust if table is not None else 0.0
    merit = -sum(a.candidate.cost for a in adopted) + max(
        sum(a.candidate.gain for a in adopted), linear
    )
    cost = float(np.log(start.criterion.n_samples))
    near: dict[str, dict[str, tuple[float, float, float]]] = {}
    experiments = search.weighing.experiments
    for place, names, regression in regressions(start, experiments, search.recorded):
        for name, gain, energy in zip(names, *regression.explained_and_energy(), strict=True):
            by = gain - cost - merit
            if by > -COMPARISON.strong:
                near.setdefault(place, {})[name] = gain, by, energy
    found = []
    under = replace(at, noise=start.noise)
    for place, names, regression in regressions(
        under, experiments, search.recorded, places=tuple(near)
    ):
        beside = dict(zip(names, regression.explained_and_energy()[1], strict=True))
        for name, (gain, by, alone) in near[place].items():
            own = float(beside[name] / alone)
            if own > JUDGING.expressed:
                found.append(UnnamedAlternative(place, name, gain, by, own))
    return tuple(sorted(found, key=lambda r: -r.ahead))
