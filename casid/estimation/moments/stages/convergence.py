"""How an iterative estimate settled: parameters and noise models, iteration by iteration.

Tables 9.5, 9.8 and 9.9 of Linder (2017).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.estimation.moments.stages.noise_models import eta_distance
from casid.estimation.moments.stages.stage import StageFit
from casid.presentation import Presented


@dataclass(frozen=True, slots=True, eq=False)
class Convergence(Presented):
    """The result of every iteration of a stage.

    Attributes
    ----------
    names : (n,) free parameters.
    theta_p : (iterations + 1, n); row 0 from the first instruments.
    moved : (iterations + 1,) ||theta_p^j - theta_p^(j-1)||, nan in row 0.
    prefilter_moved : the same, sum over records of ||eta^j - eta^(j-1)||, (8.93).
    noise_models : of each iteration, one per record (None: prefilter 1).
    is_settled : the stopping rule was met before the allowed iterations were spent.
    truth : parameter -> true value, where it is known, for the columns of errors.
    """

    names: tuple[str, ...]
    theta_p: Array
    moved: Array
    prefilter_moved: Array
    noise_models: tuple[tuple[Any, ...], ...]
    is_settled: bool
    truth: Mapping[str, float]

    @classmethod
    def of(cls, fit: StageFit, truth: Mapping[str, float] | None = None) -> Convergence:
        """The iterations of a stage, ``estimate.stages[0]`` for a joint estimate."""
        theta_p = np.array(fit.history)
        apart = [np.nan]
        for before, now in pairwise(fit.prefilters):
            apart.append(sum(eta_distance(a, b) for a, b in zip(now, before, strict=True)))
        moved = np.concatenate([[np.nan], np.linalg.norm(np.diff(theta_p, axis=0), axis=1)])
        known = {k: v for k, v in (truth or {}).items() if k in fit.free}
        return cls(fit.free, theta_p, moved, np.array(apart), fit.prefilters, fit.settled, known)

    def errors(self, name: str) -> Array:
        """Relative errors |theta/truth - 1| of a parameter, (iterations + 1,), per cent."""
        column = self.theta_p[:, self.names.index(name)]
        return np.asarray(100 * np.abs(column / self.truth[name] - 1))

    def rows(self) -> list[dict[str, float]]:
        """One mapping an iteration, for a table or a file."""
        out = []
        for j, theta in enumerate(self.theta_p):
            row: dict[str, float] = {"iteration": j}
            row |= dict(zip(self.names, theta.tolist(), strict=True))
            row |= {f"error of {n}, %": float(self.errors(n)[j]) for n in self.truth}
            row |= {
                "moved": float(self.moved[j]),
                "prefilter moved": float(self.prefilter_moved[j]),
            }
            out.append(row)
        return out

    def __repr__(self) -> str:
        return (
            f"<Convergence of {', '.join(self.names)}: {len(self.theta_p)} iterations, "
            f"{'settled' if self.is_settled else 'not settled'}>"
        )
