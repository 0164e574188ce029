"""Each of many candidates is compared with all others; what each leaves is computed once."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.search.comparison.alternatives import Losses, rivals_of
from casid.model.effects.effect import Effect


class Criterion:
    """A criterion whose whitened residual is white noise."""

    def __init__(self, seed: int) -> None:
        self.data, self.count = [None], 0
        self.residual = np.random.default_rng(seed).standard_normal((200, 1))

    def columns(self, x: object, e: int) -> tuple[np.ndarray, None]:
        self.count += 1
        return self.residual, None


def test_what_a_candidate_leaves_is_computed_once_for_all_comparisons():
    criteria = [Criterion(seed) for seed in range(4)]
    found = [
        Candidate(
            effect=Effect("offset", f"b{i}", (), lambda model, names: None),
            names=("F",),
            model=None,  # type: ignore[arg-type]
            fit=SimpleNamespace(criterion=c, x=None),  # type: ignore[arg-type]
            gain=50.0 + i,
            cost=5.0,
            wald=5.0,
        )
        for i, c in enumerate(criteria)
    ]
    at = SimpleNamespace(noise=SimpleNamespace(spectra=()), noise_absorbs_misfit=False)
    kept = Losses()
    shared = [rivals_of(at, c, found, kept) for c in found]  # type: ignore[arg-type]
    assert [c.count for c in criteria] == [1, 1, 1, 1]
    afresh = [rivals_of(at, c, found) for c in found]  # type: ignore[arg-type]
    assert [[r.p_value for r in row] for row in shared] == [
        [r.p_value for r in row] for row in afresh
    ]
