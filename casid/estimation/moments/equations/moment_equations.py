"""Moment equations: the data of least squares and instrumental variables.

One output of one record gives the regression left_t = columns_t' theta + error_t, and instruments
zeta_t turn it into

    Y - Phi theta = mean zeta_t L(q) error_t,   Y = mean zeta_t L left_t,
    Phi = mean zeta_t L columns_t',                                                          (1)

Linder (2017), (2.42)-(2.43) and (5.2)-(5.3). Least squares is the case zeta = L columns. Estimators
use the data through (1) alone, a few numbers whatever the length of the record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import DataError
from casid.estimation.cross_moments.column_products import column_means, column_products
from casid.estimation.cross_moments.moments import Moments, moments
from casid.estimation.moments.equations.long_run_covariance import cross_covariances, memory
from casid.estimation.moments.equations.parts import Part
from casid.estimation.moments.instruments.instruments import Simulated
from casid.linear.sampled.difference_equation import DifferenceEquation
from casid.linear.sampled.lagged_columns import Column

Weighting = Literal["2sls", "optimal", "identity"]


class Whitener(Protocol):
    """A prefilter L(q), such as the inverse of a noise model."""

    def whiten(self, x: Array) -> Array:
        """L(q) x for (N,) samples, at rest before."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class MomentEquations:
    """Equations (1) of one part, with what their covariance needs.

    Attributes
    ----------
    Phi : (nz, ntheta), Y : (nz,), Z : (nz, nz) mean zeta zeta', second : (ntheta + 1, ntheta + 1)
        mean of [left, columns] with itself; with instruments every mean of products is a
        covariance, as the columns' own means are taken off; N : samples in the means.
    """

    name: str
    equation: DifferenceEquation
    instruments: tuple[Column, ...]
    is_least_squares: bool
    Phi: Array
    Y: Array
    Z: Array
    second: Array
    N: int
    signals: Mapping[str, Array] = field(default_factory=dict)  # from which the means were taken
    _whitener: list[Array] = field(default_factory=list, init=False, repr=False)  # once computed

    @classmethod
    def from_moments(
        cls,
        equation: DifferenceEquation,
        sums: Moments,
        instruments: Sequence[Column] | None = None,
        *,
        name: str = "moments",
        signals: Mapping[str, Array] | None = None,
    ) -> MomentEquations:
        """The equations from additive sums; instruments None: least squares.

        Raises
        ------
        DataError
            If the sums hold too few samples for the coefficients.
        """
        n = sums.N
        if n <= 2 * len(equation.columns):
            raise DataError(
                f"{name}: {n} samples for {len(equation.columns)} coefficients; "
                "give a longer record"
            )
        phi = (equation.left, *equation.columns)
        second = sums.between(phi, phi) / n
        if instruments is None:
            return cls(
                name,
                equation,
                equation.columns,
                True,
                second[1:, 1:],
                second[1:, 0],
                second[1:, 1:],
                second,
                n,
                signals or {},
            )
        zeta = tuple(instruments)
        cross = sums.between(zeta, phi) / n
        return cls(
            name,
            equation,
            zeta,
            False,
            cross[:, 1:],
            cross[:, 0],
            sums.between(zeta, zeta) / n,
            second,
            n,
            signals or {},
        )

    # -- solving -----------------------------------------------------------------------------

    def whitener(self) -> Array:
        """W (r, nz) with W Z W' = I on the span of the instruments that the data excite."""
        if not self._whitener:
            size = np.sqrt(np.maximum(np.diag(self.Z), 0.0))
            size = np.where(size > 0, size, 1.0)
            values, vectors = np.linalg.eigh(self.Z / np.outer(size, size))
            keep = values > 1e-12 * max(float(values[-1]), TINY)
            self._whitener.append((vectors[:, keep] / np.sqrt(values[keep])).T / size)
        return self._whitener[0]

    def unconstrained(self) -> Array:
        """theta (ntheta,) of two-stage least squares, no physics used."""
        w = self.whitener()
        return np.asarray(np.linalg.lstsq(w @ self.Phi, w @ self.Y, rcond=None)[0])

    def error_power(self, theta: Array) -> float:
        """Mean square of the equation error at theta (ntheta,)."""
        v = np.concatenate([[1.0], -theta])
        return max(float(v @ self.second @ v), TINY)

    def root_weight(self, weighting: Weighting, theta: Array, covariance: Array | None) -> Array:
        """R (r, nz) with R'R = Q of (2.42), so that ||R (Y - Phi theta)||^2 is a sum of N terms.

        ``"2sls"``: Q = N/sigma^2 (mean zeta zeta')^-1, the projection on the instruments. It does
        not depend on their scaling or on which of their combinations are used, is the best weight
        where L(q) error is white, and lets records of any length and noise be added. ``"optimal"``:
        Q = N S^-1, the best weight for coloured errors. ``"identity"``: Q = N I.
        """
        if weighting == "identity":
            return np.asarray(np.sqrt(self.N) * np.eye(len(self.Z)))
        if weighting == "optimal":
            if covariance is None:
                raise ValueError("the optimal weighting needs the covariance of the moments")
            w = self.whitener()
            values, vectors = np.linalg.eigh(w @ covariance @ w.T)
            keep = values > 1e-10 * values[-1]
            return np.asarray(np.sqrt(self.N) * (vectors[:, keep] / np.sqrt(values[keep])).T @ w)
        return np.asarray(np.sqrt(self.N / self.error_power(theta)) * self.whitener())

    def error(self, theta: Array) -> Array:
        """L(q) (left - columns' theta) at every sample the means were taken from, (N,)."""
        weights: dict[str, Array] = {}
        for value, column in zip([1.0, *(-theta)], self._phi, strict=True):
            for channel, lag, weight in column.taps:
                taps = weights.setdefault(channel, np.zeros(self._reach + 1))
                taps[lag] += value * weight
        out: Array | None = None
        for channel, taps in weights.items():
            used = np.flatnonzero(taps)
            last = int(used[-1]) if used.size else 0
            part = np.convolve(
                self.signals[channel][self.start - last :], taps[: last + 1], "valid"
            )
            out = part if out is None else np.add(out, part, out=out)
        assert out is not None
        return out

    @property
    def _phi(self) -> tuple[Column, ...]:
        return (self.equation.left, *self.equation.columns)

    @property
    def _reach(self) -> int:
        return max(c.order for c in self._phi)

    @property
    def start(self) -> int:
        """The first sample that enters the means."""
        return max(c.order for c in (self.equation.left, *self.equation.columns, *self.instruments))

    # -- relevance of instruments -------------------------------------------------------------

    def correlation(self, *, with_memory: bool = True) -> Correlation:
        """Relevance of the instruments: canonical correlations with the regressors, and their rank.

        `with_memory` counts independent samples, else every sample counts as one.
        """
        w = self.whitener()
        scale = np.sqrt(np.maximum(np.diag(self.second)[1:], TINY))
        values, vectors = np.linalg.eigh(self.second[1:, 1:] / np.outer(scale, scale))
        root = (vectors / np.sqrt(np.maximum(values, 1e-15 * values[-1]))).T / scale
        u, s, vt = np.linalg.svd(w @ self.Phi @ root.T, full_matrices=False)
        full = np.zeros(len(scale))
        full[: len(s)] = np.clip(s, 0.0, 1.0)
        k = len(s) - 1
        a, b = u[:, k] @ w, vt[k] @ root
        effective = float(self.N)
        if with_memory and self.signals and not self.is_least_squares:
            start = self.start
            za = _combine(self.instruments, a, self.signals, start)
            pb = _combine(self.equation.columns, b, self.signals, start)
            za, pb = za - za.mean(), pb - pb.mean()
            half = min(max(memory(za), memory(pb)), len(za) // 4)
            ra, rb = cross_covariances(za, za, half), cross_covariances(pb, pb, half)
            spread = float(np.sum(ra * rb) / max(ra[half] * rb[half], TINY))
            effective = self.N / max(spread, 1e-3)
        return Correlation(
            full,
            dict(zip(self.equation.coefficients, (b / np.max(np.abs(b))).tolist(), strict=True)),
            effective,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Correlation:
    """Canonical correlations of instruments and regressors, the smallest last.

    Attributes
    ----------
    weakest : coefficient -> share in the direction of the smallest correlation.
    effective_samples : number of independent samples in this direction, given its memory.
    """

    canonical: Array
    weakest: Mapping[str, float]
    effective_samples: float

    @property
    def rank(self) -> int:
        """Rank of Phi: directions whose correlation is more than chance (99.9 %)."""
        from scipy.special import chdtri

        return int(np.sum(self.effective_samples * self.canonical**2 > chdtri(1, 1e-3)))


def _combine(
    columns: Sequence[Column], weights: Array, signals: Mapping[str, Array], start: int
) -> Array:
    total: Array | None = None
    for weight, column in zip(weights, columns, strict=True):
        part = weight * column.samples(signals, start)
        total = part if total is None else total + part
    assert total is not None
    return total


def moment_equations(
    part: Part,
    simulated: Simulated | None,
    prefilter: Whitener | None = None,
    *,
    burn: int = 0,
) -> MomentEquations:
    """The equations (1) of a part.

    Parameters
    ----------
    simulated : instruments, or None for least squares.
    prefilter : L(q), applied to outputs, inputs and instruments alike.
    burn : samples left out at the start, beside the transient of the instruments.

    Raises
    ------
    DataError
        If the transient leaves too few samples.
    """
    equation = part.equation
    signals: dict[str, Array] = dict(part.signals)
    own = {} if simulated is None else dict(simulated.signals)
    if prefilter is not None:
        signals, own = (
            {k: prefilter.whiten(v) for k, v in group.items()} for group in (signals, own)
        )
    phi = (equation.left, *equation.columns)
    zeta = simulated.columns if simulated is not None else ()
    order = max(c.order for c in (*phi, *zeta))
    n = len(next(iter(signals.values())))
    skip = max(burn, min(simulated.transient, n // 4) if simulated else 0)
    if n - skip <= 4 * (len(phi) + len(zeta)) + order:
        raise DataError(
            f"{part.name}: {n - skip} samples are left for {len(phi) + len(zeta)} moments; "
            "give a longer record, or fewer lags"
        )
    signals = {k: v[skip:] for k, v in signals.items()}
    N = n - skip - order
    second = _own_products(part, phi, signals, skip + order, prefilter is None) / N
    if simulated is None:
        return MomentEquations(
            part.name, equation, equation.columns, True,
            second[1:, 1:], second[1:, 0], second[1:, 1:], second, N, signals,
        )  # fmt: skip
    # What comes from the instruments alone is the same for all data that meet them.
    key = (skip, order)
    kept = simulated.kept.get(key) if prefilter is None else None
    if kept is None:
        is_centred = prefilter is None and simulated.centred_from == skip
        own = {k: v[skip:] if is_centred else v[skip:] - v[skip:].mean() for k, v in own.items()}
        centre = column_means(zeta, own, order)
        own_products = column_products(zeta, zeta, own, order) / N
        kept = own, own_products - np.outer(centre, centre), centre
        if prefilter is None:
            simulated.kept[key] = kept
    signals |= kept[0]
    cross = _finite(column_products(zeta, phi, signals, order), signals) / N
    # A constant error, a gyro's bias, stays without effect only if every column has mean zero. It
    # is not enough that the signals have: lags that a filter makes all but dependent, A(q) y = B(q)
    # u, leave a combination in which the means alone are left, and a constant is among the span.
    first = skip + order
    means = part.kept_means.get(first) if prefilter is None else None
    if means is None:
        means = column_means(phi, signals, order)
        if prefilter is None:
            part.kept_means[first] = means
    cross -= np.outer(kept[2], means)
    second = second - np.outer(means, means)
    return MomentEquations(
        part.name, equation, zeta, False, cross[:, 1:], cross[:, 0], kept[1], second, N, signals
    )


def _own_products(
    part: Part, phi: Sequence[Column], signals: Mapping[str, Array], first: int, is_kept: bool
) -> Array:
    """sum of phi_t phi_t' from t = first on; those of the whole record are kept with the part.

    `signals` begin where the transients end.
    """
    order = max(c.order for c in phi)
    if not is_kept:
        n = len(next(iter(part.signals.values())))
        start = first - (n - len(next(iter(signals.values()))))
        return _finite(column_products(phi, phi, signals, start), signals)
    if order not in part.kept:
        whole = column_products(phi, phi, part.signals, order)
        part.kept[order] = _finite(whole, part.signals)
    total: Array = part.kept[order]
    if first > order and first not in part.kept:
        head = {k: v[:first] for k, v in part.signals.items()}
        part.kept[first] = np.asarray(total - column_products(phi, phi, head, order))
    return np.asarray(part.kept[max(first, order)])


def _finite(sums: Array, signals: Mapping[str, Array]) -> Array:
    """The sums, refused where a sample is not finite."""
    if not np.isfinite(sums).all():
        moments(signals, 0)  # says where, and how to fix it
    return sums


# -- the covariance of the moments ----------------------------------------------------------------
