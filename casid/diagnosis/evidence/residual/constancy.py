"""Whether the parameters of a model are constant along the records.

A jump or a drift is one course of a parameter in time of many. The residual is tested, off the
baseline's tangent, on what the first half waves of each parameter would change,

    p(t) = p + sum a_k cos(pi k t / T),  k = 1 .. K,                                           (1)

T the length of all records end to end: Neyman's smooth test (Skand. Aktuarietidskr. 20 (1937)
149-199) in the place of the sums over time of Nyblom (J. Am. Stat. Assoc. 84 (1989) 223-230), whose
weights 1 / k^2 leave little of a parameter that comes and goes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.diagnosis.evidence.residual.force_functions import TIME, Group, Table
from casid.diagnosis.evidence.residual.linearised_path import Linearised
from casid.diagnosis.evidence.residual.signatures import Regression
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import RESIDUAL


@dataclass(frozen=True, slots=True)
class Unsteady:
    """The parameter that is the least constant."""

    parameter: str
    p_value: float  # that one of all parameters seems as unsteady by chance


def unsteady(
    at: Weighted,
    experiments: Sequence[Experiment],
    recorded: Mapping[str, str] | None = None,
    *,
    seed: int = 0,
) -> Unsteady | None:
    """The parameter whose course along the records explains most by (1); None without any.

    Parameters
    ----------
    seed : of the antithetic draw.
    """
    fit = at.unbiased or at.fit
    criterion = fit.criterion
    along = Linearised(criterion, fit.x)
    total = sum(d.N * d.Ts for d in criterion.data)
    course = Group((), partial(_half_waves, total))
    places = {*criterion.model.balances, *criterion.outputs}
    found = []
    # One at a time, which bounds the memory: long records times all parameters' courses are many.
    for name in criterion.names:
        if name not in criterion.model.parameters or name in places:
            continue
        regression = Regression(
            fit,
            at.noise,
            name,
            [course],
            experiments,
            input_sd=at.input_sd,
            recorded=recorded or {},
            linearised=along,
            seed=seed,
        )
        # A random force that the noise model lacks goes with any slow course for a while.
        white = regression.of_innovations()
        found += [(tested.p_value, name) for tested in white.test(draws=0)]
    if not found:
        return None
    p_value, name = min(found)
    return Unsteady(name, min(1.0, len(found) * p_value))


def _half_waves(total: float, table: Table) -> Array:
    """(N, K) of (1)."""
    k = np.arange(1, RESIDUAL.half_waves + 1)
    return np.asarray(np.cos(np.pi * table[TIME][:, None] * k / total))
