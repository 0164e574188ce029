"""How many of the records that are called deficient are so by chance: rates over a whole fleet.

Every record has one hypothesis, "the model lacks nothing in it", with a family-wise p over the
catalogue. Three procedures hold the share of false discoveries among all:

    Benjamini and Hochberg, J. R. Stat. Soc. B 57 (1995) 289-300: the k smallest p are rejected for
    the largest k with p_(k) <= k level / n. Under independence, or positive dependence (PRDS,
    Benjamini and Yekutieli 2001).                                                             (1)

    e-BH, Wang and Ramdas, J. R. Stat. Soc. B 84 (2022) 822-852: the k largest e for the largest k
    with e_[k] >= n / (k level). Under any dependence.                                         (2)

    LORD++, Ramdas, Yang, Wainwright and Jordan, NeurIPS 2017: record t is tested at

        level_t = w_0 gamma_t + (level - w_0) gamma_(t - tau_1) + level sum_j>1 gamma_(t - tau_j)

    where tau_j is when the j-th was rejected: in the order of their arrival, no decision ever
    taken back. Under p that are valid whatever came before.                                   (3)

A p becomes an e by the mixture of all power calibrators k p^(k - 1) with k uniform on (0, 1),

    e(p) = (1 - p + p ln p) / (p (ln p)^2)                                                     (4)

(Vovk and Wang, Ann. Stat. 49 (2021) 1736-1754, equation 2.3), which has no number to choose.
SAFFRON would gain over (3) where many records are deficient; in a fleet in service few are, and
then its estimate of their share costs more than it gives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from casid.arrays import TINY, Array, BoolArray

SOURCES = (
    "Y. Benjamini, Y. Hochberg, J. R. Stat. Soc. B 57 (1995) 289-300: false discovery rate",
    "R. Wang, A. Ramdas, J. R. Stat. Soc. B 84 (2022) 822-852: e-BH, under any dependence",
    "V. Vovk, R. Wang, Ann. Stat. 49 (2021) 1736-1754: e-values of p-values",
    "A. Ramdas, F. Yang, M. Wainwright, M. Jordan, NeurIPS 30 (2017): LORD++, online",
)
"""Papers behind the rates."""


def benjamini_hochberg(p: Array, level: float) -> BoolArray:
    """(n,) which of the p (n,) are rejected by (1)."""
    n = len(p)
    order = np.argsort(p, kind="stable")
    within = np.flatnonzero(p[order] <= level * np.arange(1, n + 1) / max(n, 1))
    rejected = np.zeros(n, bool)
    if within.size:
        rejected[order[: within[-1] + 1]] = True
    return rejected


def e_values(p: Array) -> Array:
    """(n,) e-values of p-values by (4); 1/2 at p = 1, its limit."""
    # With L = -ln p, (e^L - 1 - L) / L^2: at L = 1e-5 the limit to six digits, and no cancellation.
    L = np.maximum(-np.log(np.clip(np.asarray(p, float), TINY, 1.0)), 1e-5)
    return np.asarray((np.expm1(L) - L) / L**2)


def e_benjamini_hochberg(e: Array, level: float) -> BoolArray:
    """(n,) which of the e (n,) are rejected by (2)."""
    n = len(e)
    order = np.argsort(-e, kind="stable")
    enough = np.flatnonzero(e[order] * np.arange(1, n + 1) * level >= n)
    rejected = np.zeros(n, bool)
    if enough.size:
        rejected[order[: enough[-1] + 1]] = True
    return rejected


def shares(n: int) -> Array:
    """(n,) gamma_1, gamma_2, ... of (3), which fall as slowly as their sum allows.

    log(max(j, 2)) / (j exp(sqrt(log j))), of which the infinite sum is 1 with the factor of
    Ramdas et al. (2017), section 6.
    """
    j = np.arange(1, n + 1, dtype=float)
    return np.asarray(0.07720838 * np.log(np.maximum(j, 2)) / (j * np.exp(np.sqrt(np.log(j)))))


def lord(p: Sequence[float] | Array, level: float) -> tuple[BoolArray, Array]:
    """Which of the p (n,), in the order of their arrival, are alarms by (3), and the levels (n,).

    What is decided of the first n does not depend on what comes after them.
    """
    p = np.asarray(p, float)
    n = len(p)
    gamma = shares(n)
    initial = level / 2
    levels = initial * gamma
    alarms = np.zeros(n, bool)
    count = 0
    for t in range(n):
        if p[t] <= levels[t]:
            alarms[t] = True
            count += 1
            wealth = level - initial if count == 1 else level
            levels[t + 1 :] += wealth * gamma[: n - t - 1]
    return alarms, levels


def false_alarms_per_month(levels: Array, days: float) -> float:
    """At most how many false alarms are expected in 30 days, were no record deficient.

    Parameters
    ----------
    levels : (n,) at which the records were tested.
    days : that they span; NaN where the records have no dates.
    """
    if not len(levels) or not days > 0:
        return math.nan
    return float(np.sum(levels) * 30.0 / days)
