"""Is a declared reference external, or does it depend on the outputs?

Instruments made of a reference are correlated with no disturbance only if the reference is not. A
heading that commands the rudder, or a pilot who watches the roll, feeds disturbances back into it.
Granger's question (1969, Econometrica 37, 424-438) is: do past outputs predict the
reference better than its own past alone?

    delta(k) = sum_i a_i delta(k-i) + sum_i b_i' y(k-i) + c + e(k),       b = 0 ?               (1)

Innovations of a reference are nothing like Gaussian: steps and reversals are few and large. So the
F statistic is not compared with Fisher's F, but with its values with the signs of e turned at
random, block by block (wild bootstrap: Wu 1986, Annals of Statistics 14, 1261-1295; with fixed
regressors, Goncalves & Kilian 2004, J. Econometrics 123, 89-120). A few large steps then cannot
give a small p-value: n of them have 2^n patterns of signs. Of a reference that is at one
of two levels the times of its reversals are tested (`relay_reversals`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from casid.arrays import TINY, FloatArray
from casid.data.record import Record
from casid.errors import DataError
from casid.estimation.covariance import bartlett_lags
from casid.estimation.moments.instruments.relay_reversals import (
    Reversals,
    reversals,
    switching_p_value,
)
from casid.model.quantities import p_statement

Method = Literal["regression", "switching"]

_STANDING = 0.7  # share of the record at two levels that makes a relay of it (a heuristic)

ASSUMES: Mapping[str, str] = {
    "regression": "a reference known without noise, whose own past, as far as the lags reach, "
    "predicts it as well as the past of the outputs does if it is external; innovations of "
    "symmetric distribution, independent from block to block",
    "switching": "thresholds symmetric about zero; if the reference is external, the times for "
    "which it holds a level are normal, of one mean, and no output is steered by them",
}
"""What the p-value rests on, by method."""


@dataclass(frozen=True, slots=True, eq=False)
class Dependence:
    """Whether a reference depends on past outputs.

    Attributes
    ----------
    p_value : of "the reference depends on none of the outputs", for all outputs together.
    by_output : output -> p-value of its own, before the account for their number.
    method : "regression" (1), or "switching" for a reference that is at one of two levels.
    lags : samples of the past used (regression).
    reversals : found in the reference (switching).
    thresholds : output -> its value where the reference leaves the upper level, and minus its value
        where it leaves the lower, as well as one number fits them (switching).
    level : of significance, for `depends`.
    note : what else is to be known, such as why nothing could be tested.
    """

    record: str
    reference: str
    p_value: float
    by_output: Mapping[str, float]
    method: Method
    level: float
    lags: int = 0
    reversals: int = 0
    thresholds: Mapping[str, float] | None = None
    note: str = ""

    @property
    def depends(self) -> bool:
        """True if dependence is shown; False does not show that there is none."""
        return self.p_value < self.level

    @property
    def claim(self) -> str:
        """What instruments made of this reference may claim."""
        if self.depends:
            return (
                f"{self.reference} is fed back from {', '.join(self.culprits)}: it carries past "
                "disturbances. Its past values are instruments only if the equation error is "
                "white, or shorter of memory than the delay taken; present and future values, and "
                "signals simulated from them, are not. Consistency is not to be claimed"
            )
        return (
            f"nothing shows that {self.reference} depends on {', '.join(self.by_output)}; "
            "instruments of it may be used, as far as this test can see"
        )

    @property
    def culprits(self) -> tuple[str, ...]:
        """Outputs whose own p-value is significant for their number, smallest first; at least one
        where the whole is."""
        order = sorted(self.by_output, key=lambda name: self.by_output[name])
        few = [n for n in order if self.by_output[n] * len(order) < self.level]
        return tuple(few or order[:1]) if self.depends else ()

    def references(self) -> tuple[str, ...]:
        """The papers behind the method."""
        return (
            "C. W. J. Granger, Econometrica 37 (1969) 424-438",
            "C. F. J. Wu, Annals of Statistics 14 (1986) 1261-1295: wild bootstrap",
            "S. Goncalves, L. Kilian, J. Econometrics 123 (2004) 89-120: with fixed regressors",
        )

    def __repr__(self) -> str:
        return (
            f"<Dependence of {self.reference} in {self.record}: "
            f"{'shown' if self.depends else 'not shown'}, {p_statement(self.p_value)}, "
            f"{self.method}>"
        )

    def __str__(self) -> str:
        how = f"{self.lags} lags" if self.method == "regression" else f"{self.reversals} reversals"
        lines = [
            f"Does {self.reference} depend on past outputs? {self.record}, {self.method}, {how}",
            f"  {'yes' if self.depends else 'not shown'}, {p_statement(self.p_value, '.3g')}",
        ]
        for name, p in self.by_output.items():
            c = (self.thresholds or {}).get(name, float("nan"))
            lines.append(
                f"  {name:12}  {p_statement(p, '.3g')}"
                + (f"; turns at +-{abs(c):.4g}" if np.isfinite(c) else "")
            )
        lines += [f"  claim         {self.claim}", f"  assumes       {ASSUMES[self.method]}"]
        return "\n".join([*lines, *([f"  note          {self.note}"] if self.note else [])])


def reference_depends_on(
    record: Record,
    reference: str,
    outputs: Sequence[str],
    *,
    method: Method | None = None,
    lags: int | None = None,
    level: float = 0.05,
    draws: int = 1999,
    seed: int = 0,
) -> Dependence:
    """Test whether a declared reference depends on past outputs.

    Parameters
    ----------
    record : with the reference and the outputs; none of their samples missing.
    outputs : channels that the reference might be made of. With "switching", as deviations: its
        thresholds lie at +c and -c.
    method : "regression" or "switching"; default by the reference, "switching" where it is at
        one of two levels for 70 % of the record and reverses at least twice.
    lags : of reference and outputs in (1); default by BIC for the reference's own past, up to 40.
        They must reach over the reference's memory: a square wave of fixed period is predicted by
        its own past only if the lags reach over half a period, and by the output before that.
    level : of significance.
    draws : of the bootstrap; the smallest p-value is 1/(draws + 1).
    seed : of the bootstrap.

    Returns
    -------
    Dependence
        p-values for several outputs: their own each, and one for all (regression: a joint test;
        switching: the smallest times their number, Bonferroni).

    Raises
    ------
    DataError
        If a channel is absent, misses samples or rests, or the record is too short for the lags.

    Notes
    -----
    Dependence that leaves no trace in past outputs is not seen: a reference that shares an unknown
    disturbance with the system needs other evidence. Nor is "not shown" a proof of independence.
    """
    r, y = _signals(record, reference, outputs)
    if not 0 < level < 1 or draws < 19:
        raise DataError(
            f"level = {level!r}, draws = {draws!r}; give a level between 0 and 1, such as 0.05, "
            "and at least 19 draws"
        )
    turns = reversals(r)
    if method is None:
        relay = turns.standing >= _STANDING and len(turns.start) >= 2
        method = "switching" if relay else "regression"
    if method == "switching":
        return _switching(
            (record.name, reference), turns, dict(zip(outputs, y.T, strict=True)), level
        )
    if method != "regression":
        raise DataError(f"method = {method!r}; choose 'regression' or 'switching'")
    n = _own_order(r, min(40, len(r) // (10 * (1 + y.shape[1])))) if lags is None else lags
    if isinstance(n, bool) or n < 1 or len(r) < 5 * n * (1 + y.shape[1]) + 20:
        raise DataError(
            f"{record.name}: {len(r)} samples are too few for {n} lags of {1 + y.shape[1]} "
            "channels; give fewer lags (lags=), fewer outputs or a longer record"
        )
    together, by_column, is_exact = _regression(r, y, n, draws, seed)
    return Dependence(
        record.name,
        reference,
        together,
        dict(zip(outputs, by_column, strict=True)),
        method,
        level,
        lags=n,
        note="the reference's own past predicts it exactly: nothing to test" if is_exact else "",
    )


def _switching(
    names: tuple[str, str],
    turns: Reversals,
    outputs: Mapping[str, FloatArray],
    level: float,
) -> Dependence:
    """The test of the times of reversals; `names` of record and reference."""
    span = max(1, int(np.median(turns.hold) / 50)) if len(turns.hold) else 1
    tested = {n: switching_p_value(turns, y, span) for n, y in outputs.items()}
    by = {n: p for n, (p, _) in tested.items()}
    few = len(turns.start) < 2
    return Dependence(
        *names,
        min(1.0, min(by.values()) * len(by)),
        by,
        "switching",
        level,
        reversals=len(turns.start),
        thresholds={n: c for n, (_, c) in tested.items()},
        note="fewer than two reversals: nothing could be tested" if few else "",
    )


def _signals(
    record: Record, reference: str, outputs: Sequence[str]
) -> tuple[FloatArray, FloatArray]:
    """Reference (N,) and outputs (N, m), checked."""
    if isinstance(outputs, str) or not outputs or reference in outputs:
        raise DataError(
            f"outputs = {outputs!r} of reference {reference!r}; name at least one channel other "
            "than the reference itself, as a list: ['psi']"
        )
    for name in (reference, *outputs):
        values = record[name]
        if record.is_missing(name).any():
            raise DataError(
                f"{record.name}: {name} misses samples; cut the record there (record.between), or "
                "fill the channel beforehand (record.filled)"
            )
        if np.ptp(values) == 0:
            raise DataError(
                f"{record.name}: {name} rests, and a signal at rest depends on nothing; take a "
                "stretch in which it moves"
            )
    return record[reference], np.column_stack([record[n] for n in outputs])


def _lagged(x: FloatArray, lags: int, first: int) -> FloatArray:
    """(N - first, lags) past values x(k-1) .. x(k-lags), k = first .. N - 1."""
    return np.column_stack([x[first - i : len(x) - i] for i in range(1, lags + 1)])


def _own_order(r: FloatArray, largest: int) -> int:
    """Order of an autoregression of the reference by BIC, on the same samples for every order."""
    largest = max(1, largest)
    x = (r - r.mean()) / r.std()
    target, past = x[largest:], _lagged(x, largest, largest)
    best, chosen = np.inf, 1
    for n in range(1, largest + 1):
        e = target - past[:, :n] @ np.linalg.lstsq(past[:, :n], target, rcond=None)[0]
        bic = len(e) * np.log(max(float(e @ e), 1e-28 * len(e)) / len(e)) + n * np.log(len(e))
        if bic < best - 1e-9:
            best, chosen = bic, n
    return chosen


def _basis(columns: FloatArray, beside: FloatArray | None = None) -> FloatArray:
    """Orthonormal basis of the columns' span, less that of the basis `beside`."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), TINY)
    if beside is not None:
        for _ in range(2):  # twice is enough (Giraud et al. 2005)
            scaled = scaled - beside @ (beside.T @ scaled)
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(u[:, s > 1e-8], dtype=np.float64)


def _regression(
    r: FloatArray, y: FloatArray, lags: int, draws: int, seed: int
) -> tuple[float, list[float], bool]:
    """p-value for all outputs, for each by itself, and whether nothing was left to test."""
    x = (r - r.mean()) / r.std()
    z = (y - y.mean(axis=0)) / y.std(axis=0)
    target = x[lags:]
    own = _basis(np.column_stack([np.ones(len(target)), _lagged(x, lags, lags)]))
    e = target - own @ (own.T @ target)
    if np.sqrt(np.mean(e**2)) < 1e-6:
        return 1.0, [1.0] * z.shape[1], True
    past = [_lagged(z[:, i], lags, lags) for i in range(z.shape[1])]
    others = [_basis(p, own) for p in past]
    spaces = [_basis(np.hstack(past), own), *others]
    block = 1 + bartlett_lags(e[:, None], largest=len(e) // 20)
    rng = np.random.default_rng(seed)
    label = np.arange(len(e)) // block
    flips = rng.integers(0, 2, (int(label[-1]) + 1, draws)) * 2.0 - 1.0
    exceeded = np.zeros(len(spaces))
    observed = [_ratio(e[:, None], e @ e, q)[0] for q in spaces]
    for start in range(0, draws, 200):
        turned = e[:, None] * flips[label, start : start + 200]
        left = turned - own @ (own.T @ turned)
        energy = np.einsum("ij,ij->j", left, left)
        for i, q in enumerate(spaces):
            exceeded[i] += np.sum(_ratio(turned, energy, q) >= observed[i] * (1 - 1e-12))
    p = (1 + exceeded) / (draws + 1)
    return float(p[0]), [float(v) for v in p[1:]], False


def _ratio(e: FloatArray, energy: FloatArray, q: FloatArray) -> FloatArray:
    """Energy that the space explains over what it leaves, F up to its degrees of freedom."""
    explained = np.sum((q.T @ e) ** 2, axis=0)
    return np.asarray(explained / np.maximum(energy - explained, TINY))
