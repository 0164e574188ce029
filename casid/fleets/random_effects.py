"""A parameter over assets and voyages: its mean, what differs between and within, and drifts.

    y_ij = mu + beta t_ij + u_i + v_i t_ij + w_ij + e_ij                                       (1)

for record j of asset i at time t (centred, in units of its standard deviation): u between assets
N(0, tau_b^2), v drifts of their own N(0, tau_d^2), w within an asset from record to record
N(0, tau_w^2), e the error of the estimate N(0, s_ij^2) with its reported s. The three variances
maximise the restricted likelihood (Patterson and Thompson, Biometrika 58 (1971) 545-554; for
meta-analysis Viechtbauer, J. Educ. Behav. Stat. 30 (2005) 261-293): DerSimonian and Laird's model
(Control. Clin. Trials 7 (1986) 177-188) with a level more and a drift. mu and beta are generalised
least squares, u_i and v_i the best linear unbiased predictions, which are shrunk towards the fleet
the more, the less their own records determine them (Robinson, Stat. Sci. 6 (1991) 15-32).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import TINY, Array
from casid.fleets.thresholds import EFFECTS

SOURCES = (
    "R. DerSimonian, N. Laird, Control. Clin. Trials 7 (1986) 177-188: random effects",
    "H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545-554: restricted likelihood",
    "G. K. Robinson, Stat. Sci. 6 (1991) 15-32: shrunk estimates",
)
"""Papers behind the random effects."""


@dataclass(frozen=True, slots=True)
class AssetEffect:
    """One asset's own value of a parameter, in its unit.

    Attributes
    ----------
    records : that it is estimated from.
    mean, mean_error : at the middle of the asset's own records, shrunk towards the fleet.
    drift, drift_error : its change per unit of time, the fleet's included, shrunk.
    p_value : that it drifts as the fleet does, from its own records alone.
    """

    asset: str
    records: int
    mean: float
    mean_error: float
    drift: float
    drift_error: float
    p_value: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mean, normal."""
        return self.mean - 1.96 * self.mean_error, self.mean + 1.96 * self.mean_error


@dataclass(frozen=True, slots=True)
class ParameterEffects:
    """One parameter over the fleet, in its unit.

    Attributes
    ----------
    records : estimates that it is made of.
    mean, mean_error : of the fleet, in the middle of its records in time.
    between, within : standard deviation from asset to asset, and from record to record of one
        asset beyond what the errors of the estimates explain.
    drift, drift_error : of the fleet per unit of time; NaN where all records are of one time.
    middle, unit_of_time : the time of `mean`, and the seconds of a unit of `drift` where times are
        dates (a year), else 1.
    assets : each asset's own.
    """

    name: str
    unit: str
    records: int
    mean: float
    mean_error: float
    between: float
    within: float
    drift: float
    drift_error: float
    middle: float
    unit_of_time: float
    assets: tuple[AssetEffect, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Estimates of one parameter: values (n,), standard errors (n,), times (n,), assets (n,)."""

    name: str
    unit: str
    value: Array
    error: Array
    when: Array
    asset: Sequence[str]

    @property
    def usable(self) -> Sample | None:
        """What has a finite value and error; None of fewer than three."""
        keep = np.isfinite(self.value) & np.isfinite(self.error) & (self.error > 0)
        if keep.sum() < EFFECTS.fewest:
            return None
        assets = [a for a, k in zip(self.asset, keep, strict=True) if k]
        return Sample(
            self.name, self.unit, self.value[keep], self.error[keep], self.when[keep], assets
        )


def parameter_effects(sample: Sample, *, unit_of_time: float = 1.0) -> ParameterEffects | None:
    """Random effects (1) of one parameter; None of fewer than three estimates.

    Parameters
    ----------
    unit_of_time : of the times, in which drifts are reported.
    """
    used = sample.usable
    if used is None:
        return None
    model = _Mixed.of(used)
    variances = model.restricted_maximum()
    return _effects(used, model, variances, unit_of_time)


@dataclass(frozen=True, slots=True, eq=False)
class _Mixed:
    """(1) in units in which the values are of size one."""

    y: Array  # (n,)
    s2: Array  # (n,) variances of the errors
    X: Array  # (n, p) fixed: one, and time where there is more than one
    group: Array  # (n,) int, asset
    m: int  # assets
    origin: float
    scale: float
    middle: float
    span: float  # standard deviation of the times

    @classmethod
    def of(cls, sample: Sample) -> _Mixed:
        origin = float(np.median(sample.value))
        scale = 1.48 * float(np.median(np.abs(sample.value - origin)))
        scale = max(scale, float(np.median(sample.error)), TINY)
        middle, span = float(np.mean(sample.when)), float(np.std(sample.when))
        t = (sample.when - middle) / span if span > 0 else np.zeros(len(sample.when))
        X = np.column_stack([np.ones(len(t)), t] if span > 0 else [np.ones(len(t))])
        names = list(dict.fromkeys(sample.asset))
        group = np.array([names.index(a) for a in sample.asset])
        y = (sample.value - origin) / scale
        s2 = (sample.error / scale) ** 2
        return cls(y, s2, X, group, len(names), origin, scale, middle, span)

    def pieces(self, variances: Array) -> tuple[Array, Array, Array, Array]:
        """W = 1/(s^2 + tau_w^2) (n,), K = (G^-1 + Z'WZ)^-1 (m, p, p), Z'WX, Z'Wy by asset.

        Z = X: each asset has an own mean and drift.
        """
        within, own = variances[0], np.maximum(variances[1:], 1e-12)
        w = 1.0 / (self.s2 + within)
        p = self.X.shape[1]
        ztz, zty = np.zeros((self.m, p, p)), np.zeros((self.m, p))
        np.add.at(ztz, self.group, (w[:, None] * self.X)[:, :, None] * self.X[:, None, :])
        np.add.at(zty, self.group, (w * self.y)[:, None] * self.X)
        K = np.linalg.inv(ztz + np.diag(1.0 / own))
        return w, K, ztz, zty

    def fixed(self, variances: Array) -> tuple[Array, Array, float]:
        """Generalised least squares: beta (p,), X'V^-1X (p, p), minus twice the likelihood."""
        w, K, ztz, zty = self.pieces(variances)
        own = np.maximum(variances[1:], 1e-12)
        xvx = ztz.sum(axis=0) - np.einsum("mij,mjk,mkl->il", ztz, K, ztz)
        xvy = zty.sum(axis=0) - np.einsum("mij,mjk,mk->i", ztz, K, zty)
        yvy = float(w @ self.y**2 - np.einsum("mi,mij,mj->", zty, K, zty))
        beta = np.linalg.solve(xvx, xvy)
        log_v = -np.log(w).sum() - np.linalg.slogdet(K)[1].sum() + self.m * np.log(own).sum()
        value = log_v + np.linalg.slogdet(xvx)[1] + yvy - float(xvy @ beta)
        return beta, xvx, float(value)

    def _at_logs(self, log: Array) -> float:
        """The restricted likelihood at the logarithms of the variances."""
        return self.fixed(np.exp(log))[2]

    def restricted_maximum(self) -> Array:
        """tau_w^2, tau_b^2, tau_d^2 (the last where there are times), of size one at most.

        From several starts, as variances at zero are local optima.
        """
        from scipy.optimize import minimize

        p = self.X.shape[1]
        best, found = math.inf, np.zeros(1 + p)
        for start in (-1.0, -3.0, -6.0):
            result = minimize(
                self._at_logs,
                np.full(1 + p, start),
                method="L-BFGS-B",
                bounds=[(-23.0, 9.0) for _ in range(1 + p)],
            )
            if float(result.fun) < best:
                best, found = float(result.fun), np.exp(result.x)
        return np.where(found > EFFECTS.none, found, 0.0)


def _effects(
    sample: Sample, model: _Mixed, variances: Array, unit_of_time: float
) -> ParameterEffects:
    beta, xvx, _ = model.fixed(variances)
    covariance = np.linalg.inv(xvx)
    _, K, ztz, zty = model.pieces(variances)
    per_time = model.scale / model.span * unit_of_time if model.span > 0 else math.nan
    has_time = model.X.shape[1] > 1
    assets = []
    names = list(dict.fromkeys(sample.asset))
    for i, name in enumerate(names):
        u = K[i] @ (zty[i] - ztz[i] @ beta)
        # Error of beta + u: C (I - KA)' ... of both together (Robinson 1991, equation 4.3).
        keep = np.eye(len(beta)) - K[i] @ ztz[i]
        both = K[i] + keep @ covariance @ keep.T
        mine = model.group == i
        at = np.array([1.0, float(model.X[mine, 1].mean())]) if has_time else np.ones(1)
        mean = float(at @ (beta + u))
        error = math.sqrt(max(float(at @ both @ at), 0.0))
        drift = drift_error = math.nan
        p = 1.0
        if has_time:
            drift = float(beta[1] + u[1]) * per_time
            drift_error = math.sqrt(max(float(both[1, 1]), 0.0)) * per_time
            p = _drifts_alone(ztz[i], zty[i], float(beta[1]), float(covariance[1, 1]))
        assets.append(
            AssetEffect(
                name,
                int(mine.sum()),
                model.origin + model.scale * mean,
                model.scale * error,
                drift,
                drift_error,
                p,
            )
        )
    return ParameterEffects(
        name=sample.name,
        unit=sample.unit,
        records=len(sample.value),
        mean=model.origin + model.scale * float(beta[0]),
        mean_error=model.scale * math.sqrt(float(covariance[0, 0])),
        between=model.scale * math.sqrt(float(variances[1])),
        within=model.scale * math.sqrt(float(variances[0])),
        drift=float(beta[1]) * per_time if has_time else math.nan,
        drift_error=math.sqrt(float(covariance[1, 1])) * per_time if has_time else math.nan,
        middle=model.middle,
        unit_of_time=unit_of_time,
        assets=tuple(assets),
    )


def _drifts_alone(information: Array, moments: Array, fleet: float, variance: float) -> float:
    """p that an asset's own regression on time has the fleet's slope."""
    from scipy.special import ndtr

    if np.linalg.matrix_rank(information, hermitian=True) < len(information):
        return 1.0
    own = np.linalg.solve(information, moments)[1]
    spread = math.sqrt(float(np.linalg.inv(information)[1, 1]) + variance)
    return 2.0 * float(ndtr(-abs(own - fleet) / spread))
