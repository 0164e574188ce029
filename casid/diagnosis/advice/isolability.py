"""Which causes a record can separate, and the misfit energy that this needs.

Write e = sqrt(lambda) a + n for the whitened residual of the baseline when the cause A is at work:
a is A's signature, the whitened sensitivity less its part in the baseline's tangent space, of unit
length; n is white noise of unit variance; and lambda, the energy of the misfit that no baseline
parameter can take up, is the cause's size squared times what one unit of its parameter gives. With
b the signature of another cause B and c = a'b, refitting one or the other lowers the criterion by

    G_A = (a'e)^2,   G_B = (b'e)^2,   D = G_A - G_B                                            (1)

and D is, for these alternatives of one parameter each, twice the log likelihood ratio of two models
that are not nested (Vuong 1989). Its sum and difference factors s = (a + b)'e / sqrt(2 (1 + c)) and
t = (a - b)'e / sqrt(2 (1 - c)) are independent normals of unit variance, so that

    D = 2 sqrt(1 - c^2) s t,   E D = (1 - c^2) lambda,   var D = 4 (1 - c^2) (lambda + 1)      (2)

A is separated from B when D exceeds the margin m within which causes count as tied. With x^2 =
(1 - c^2) lambda and the 1 in the variance left out, that has the probability Phi(z) if

    x^2 - 2 z x - m = 0,   so   lambda = (z + sqrt(z^2 + m))^2 / (1 - c^2)                     (3)

For m = 6 units of BIC and a probability of 0.95 the numerator is 21.1; it is 4 z^2 = 10.8 where A
need only come first (m = 0).

Sources: Q. H. Vuong, Econometrica 57 (1989) 307-333, for (1); R. E. Kass and A. E. Raftery, J. Am.
Stat. Assoc. 90 (1995) 773-795, for the margin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import log, sqrt
from typing import Any

import numpy as np
from scipy.special import ndtri

from casid.arrays import Array
from casid.data.files import plain_fields
from casid.deprecation import renamed
from casid.diagnosis.evidence.scores.score_tests import ScoreTable
from casid.diagnosis.thresholds import PLANNING, SCORES
from casid.errors import DataError
from casid.model.effects.effect import Effect
from casid.model.effects.names import effect_words, law_of
from casid.presentation import Presented, present

Key = tuple[str, str]


def separation_constant(*, margin: float = PLANNING.margin, power: float = PLANNING.power) -> float:
    """Numerator of (3): energy that separates two causes whose signatures are at right angles.

    Raises
    ------
    DataError
        If the margin is negative or the power does not lie between 0.5 and 1.
    """
    if margin < 0 or not 0.5 <= power < 1:
        raise DataError(
            f"margin={margin:g}, power={power:g}: give a margin of 0 or more BIC units and a "
            "power of at least 0.5 and below 1"
        )
    z = -float(ndtri(1 - power))
    return (z + sqrt(z * z + margin)) ** 2


def separation_energy(cosine: float, *, margin: float = PLANNING.margin) -> float:
    """Energy (3) of the misfit that separates the right one of two causes; may be inf.

    Parameters
    ----------
    cosine : of the causes' whitened, projected signatures.
    """
    apart = 1.0 - min(cosine * cosine, 1.0)
    constant = separation_constant(margin=margin)
    return constant / apart if apart > 1e-10 else float("inf")


def likeness(first: Effect, second: Effect, cosine: float) -> float:
    """The cosine with which one cause imitates the other; 0 where that takes an impossible sign."""
    one_sided = all(e.sided == "positive" or e.test == "clip" for e in (first, second))
    return 0.0 if one_sided and cosine < 0 else cosine


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two causes and the energy that separates them."""

    first: Key
    second: Key
    cosine: float
    energy: float  # lambda of (3), with what the dearer of the two is charged for more parameters

    @property
    def is_same(self) -> bool:
        """True if they are indistinguishable in this record at any realistic size."""
        return abs(self.cosine) > PLANNING.same

    def to_json(self) -> dict[str, Any]:
        """Plain numbers; an infinite energy is None."""
        return plain_fields(self, "is_same", is_same="same")


@dataclass(frozen=True, slots=True, eq=False)
class Isolability(Presented):
    """Causes that a record can separate: angles of all signatures, and energies needed.

    Attributes
    ----------
    keys : kind and place of the visible causes, the strongest variant of each.
    cosines : (K, K) in that order.
    pairs : all of them, the hardest first.
    groups : causes that are indistinguishable in this record, two or more each: |cosine| above
        `PLANNING.same`.
    undetectable : causes that the baseline absorbs; `Diagnosis.undetectable` says why.
    laws : cause -> the law that it is called by, where it has one (`law_of`).
    """

    keys: tuple[Key, ...]
    cosines: Array
    pairs: tuple[Pair, ...]
    groups: tuple[tuple[Key, ...], ...]
    undetectable: tuple[Key, ...] = ()
    margin: float = PLANNING.margin
    power: float = PLANNING.power
    laws: Mapping[Key, str] = field(default_factory=dict)

    unseen = renamed("unseen", "undetectable")

    def words(self, key: Key) -> str:
        """A cause as an engineer says it."""
        return effect_words(*key, description=self.laws.get(key, ""))

    def of(self, key: Key) -> tuple[Pair, ...]:
        """The pairs of a cause, its hardest rival first.

        Raises
        ------
        DataError
            If the cause is not among those compared.
        """
        if key not in self.keys:
            known = ", ".join(f"{k} in {w}" for k, w in self.keys)
            raise DataError(
                f"{key!r} is not among the causes compared; request one of these: {known}"
            )
        return tuple(p for p in self.pairs if key in (p.first, p.second))

    def to_json(self) -> dict[str, Any]:
        """Part of `diagnosis.json`: every cosine, and the pairs from `PLANNING.alike` on."""
        return {
            "margin": self.margin,
            "power": self.power,
            "effects": [list(k) for k in self.keys],
            "cosines": np.round(self.cosines, 6).tolist(),
            "pairs": [p.to_json() for p in self.pairs if abs(p.cosine) >= PLANNING.alike],
            "groups": [[list(k) for k in g] for g in self.groups],
            "unseen": [list(k) for k in self.undetectable],
        }

    def __repr__(self) -> str:
        return (
            f"<Isolability: {len(self.keys)} causes, {len(self.groups)} indistinguishable groups>"
        )

    def plot(self) -> Any:
        """The angles as a heat map, a Plotly figure."""
        return present(self, "figure")


def strongest_variants(table: ScoreTable) -> list[int]:
    """Places in the table, one a kind and place: the variant with the largest plain score.

    Where nothing scores, the variant that one unit of shows most.
    """
    chosen: dict[Key, int] = {}
    for i, s in enumerate(table.scores):
        old = table.scores[chosen[s.effect.key]] if s.effect.key in chosen else None
        if old is None or (s.unrobust, s.energy) > (old.unrobust, old.energy):
            chosen[s.effect.key] = i
    return list(chosen.values())


def isolability(table: ScoreTable, *, n_samples: int | None = None) -> Isolability:
    """Compare every pair of causes of a score table.

    Parameters
    ----------
    table : of `score_test`; of the variants of a kind in one place the strongest counts.
    n_samples : samples that the fit counts; where given, a cause that is charged for more
        parameters than its rival (by BIC) has to win by that much more.

    Returns
    -------
    Isolability
        Causes that the baseline absorbs are set apart.
    """
    places = strongest_variants(table)
    seen = [i for i in places if table.scores[i].visible > SCORES.undetectable]
    undetectable = tuple(table.scores[i].effect.key for i in places if i not in seen)
    effects = [table.scores[i].effect for i in seen]
    cosines = np.clip(np.asarray(table.cosines)[np.ix_(seen, seen)], -1.0, 1.0)
    pairs = []
    for i, first in enumerate(effects):
        for j in range(i):
            c = likeness(first, effects[j], float(cosines[i, j]))
            extra = abs(first.cost - effects[j].cost) * log(n_samples) if n_samples else 0.0
            energy = separation_energy(c, margin=PLANNING.margin + extra)
            pairs.append(Pair(effects[j].key, first.key, c, energy))
    pairs.sort(key=lambda p: (-abs(p.cosine), p.first, p.second))
    return Isolability(
        keys=tuple(e.key for e in effects),
        cosines=cosines,
        pairs=tuple(pairs),
        groups=_groups([e.key for e in effects], pairs),
        undetectable=undetectable,
        margin=PLANNING.margin,
        power=PLANNING.power,
        laws={e.key: law for e in effects if (law := law_of(e.kind, e.description))},
    )


def _groups(keys: Sequence[Key], pairs: Sequence[Pair]) -> tuple[tuple[Key, ...], ...]:
    """Causes joined by pairs that are the same, in the order of `keys`."""
    home = {k: k for k in keys}
    for p in pairs:
        if p.is_same:
            old, new = home[p.second], home[p.first]
            home = {k: new if h == old else h for k, h in home.items()}
    groups = {h: tuple(k for k in keys if home[k] == h) for h in home.values()}
    return tuple(g for g in groups.values() if len(g) > 1)
