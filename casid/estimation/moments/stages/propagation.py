"""How the noise of every record reaches every estimate, through all stages.

At the optimum of stage i, with A_k = Phi_k dg_k/d(free) and D_k = Phi_k dg_k/d(earlier),

    d theta_i = H_i^-1 sum_k A_k' Q_k (s_k - D_k d theta_<i),    H_i = sum_k A_k' Q_k A_k,       (1)

where s_k is the mean of zeta_t L(q) error_t, the only noise there is. (1) is linear in all s_k and
in the errors of what was taken as known, so one matrix holds the whole propagation; a stage that
treats the earlier ones as exact (Linder 2017, Approach 5.1) is (1) with D_k = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import TINY, Array, scaled_inverse
from casid.estimation.moments.equations.moment_covariance import (
    are_short,
    combined_covariance,
    moment_covariance,
)
from casid.estimation.moments.stages.stage import StageFit


@dataclass(frozen=True, slots=True, eq=False)
class Propagated:
    """Covariances of all free parameters in the order of the stages.

    Attributes
    ----------
    names : free parameters; covariance : (n, n), with everything propagated.
    own : (n, n), every stage by itself, the earlier ones and the known values taken as exact.
    active : (n,) bool, False at a bound.
    statistic, degrees : overidentification test (Sargan 1958, Hansen 1982), chi squared with that
        many degrees of freedom where model, instruments and known values are right.
    """

    names: tuple[str, ...]
    covariance: Array
    own: Array
    active: Array
    statistic: float
    degrees: int

    @property
    def p_value(self) -> float:
        """Probability of a larger statistic where nothing is wrong; 1 without surplus moments."""
        from scipy.stats import chi2

        return float(chi2.sf(self.statistic, self.degrees)) if self.degrees else 1.0


def propagate(
    stages: Sequence[StageFit],
    prior_names: Sequence[str] = (),
    prior_covariance: Array | None = None,
    *,
    how: Any = None,
) -> Propagated:
    """Equation (1) over all stages.

    Parameters
    ----------
    prior_names, prior_covariance : known values that are uncertain, (q,) and (q, q).
    how : passed to `casid.estimation.moments.equations.moment_covariance.moment_covariance`.
    """
    noise = _Noise(stages, prior_covariance, len(prior_names), how)
    linear = _Linear(prior_names, noise.size)
    for st, columns in zip(stages, noise.columns, strict=True):
        linear.add(st, columns)
    statistic, degrees = _overidentification(
        np.vstack(linear.residual), np.concatenate(linear.moments), noise.covariance
    )
    q = len(prior_names)
    everything = noise.spread(linear.full[q:])
    is_all = np.array_equal(linear.full, linear.alone)
    return Propagated(
        names=tuple(linear.names[q:]),
        covariance=everything,
        own=everything if is_all else noise.spread(linear.alone[q:]),
        active=np.array(linear.active),
        statistic=statistic,
        degrees=degrees,
    )


class _Noise:
    """All sources of noise: errors of known values (q,), then the means s_k of every part."""

    def __init__(
        self, stages: Sequence[StageFit], prior_covariance: Array | None, q: int, how: Any
    ) -> None:
        self.q, self.how = q, how
        self.equations = [e for st in stages for e in st.equations]
        self.thetas = [theta for st in stages for theta in st.thetas]
        self.records = [part.record for st in stages for part in st.parts]
        ends = iter((q + np.cumsum([len(e.Z) for e in self.equations])).tolist())
        self.columns: list[list[slice]] = []  # of each stage, the sources of its parts
        for st in stages:
            sizes = [len(e.Z) for e in st.equations]
            self.columns.append([slice(end - n, end) for n, end in zip(sizes, ends, strict=False)])
        self.size = q + sum(len(e.Z) for e in self.equations)
        self.covariance: Array = np.zeros((self.size, self.size))
        if q:
            self.covariance[:q, :q] = prior_covariance
        self.covariance[q:, q:] = moment_covariance(
            self.equations, self.thetas, self.records, how=how
        )

    def spread(self, maps: Array) -> Array:
        """Covariance (n, n) of maps (n, size) times the noise."""
        q = self.q
        if self.how not in (None, "independent") or not are_short(self.equations):
            return np.asarray(maps @ self.covariance @ maps.T)
        known = maps[:, :q] @ self.covariance[:q, :q] @ maps[:, :q].T
        combined = combined_covariance(self.equations, self.thetas, self.records, maps[:, q:])
        return np.asarray(known + combined)


class _Linear:
    """Errors of the parameters as linear maps of the noise, stage by stage.

    Attributes
    ----------
    full, alone : (n, size), by (1), and with D_k = 0.
    residual, moments : of each part, the map of R (s - Phi d theta), and its value.
    """

    def __init__(self, prior_names: Sequence[str], size: int) -> None:
        self.names = list(prior_names)
        self.size = size
        self.full: Array = np.eye(len(prior_names), size)
        self.alone: Array = self.full.copy()
        self.active: list[bool] = []
        self.residual: list[Array] = []
        self.moments: list[Array] = []

    def add(self, st: StageFit, columns: Sequence[slice]) -> None:
        """The parameters of one more stage, its parts' noise at `columns`."""
        held = st.solution.active
        free = [f for f in st.free if f not in held]
        normal = np.zeros((len(free), len(free)))
        forced, forced_alone = (np.zeros((len(free), self.size)) for _ in range(2))
        rows = []
        for k, (e, root) in enumerate(zip(st.equations, st.roots, strict=True)):
            A = root @ e.Phi @ free_slope(st, k, free)
            source = np.zeros((len(e.Z), self.size))
            source[:, columns[k]] = np.eye(len(e.Z))
            driven = source - self._earlier(st, k)
            normal += A.T @ A
            forced += A.T @ root @ driven
            forced_alone += A.T @ root @ source
            rows.append((A, root @ driven))
            self.moments.append(root @ (e.Y - e.Phi @ st.thetas[k]))
        inverse = _inverse(normal, _tangent(st, free))
        moved, moved_alone = inverse @ forced, inverse @ forced_alone
        self.residual += [direct - A @ moved for A, direct in rows]
        wide, wide_alone = (np.zeros((len(st.free), self.size)) for _ in range(2))
        place = [st.free.index(f) for f in free]
        wide[place], wide_alone[place] = moved, moved_alone
        self.full = np.concatenate([self.full, wide])
        self.alone = np.concatenate([self.alone, wide_alone])
        self.names += list(st.free)
        self.active += [f in free for f in st.free]

    def _earlier(self, st: StageFit, k: int) -> Array:
        """D_k d theta_<i of (1): the errors of what part k takes as known."""
        e, jacobian = st.equations[k], jacobian_of(st, k)
        index = {n: c for c, n in enumerate(e.equation.parameters)}
        total = np.zeros((len(e.Z), self.size))
        for row, n in zip(self.full, self.names, strict=True):
            if n in index and n not in st.parts[k].known and n not in st.free:
                total += np.outer(e.Phi @ jacobian[:, index[n]], row)
        return total


def _inverse(normal: Array, basis: Array) -> Array:
    """The inverse of normal (n, n) on the span of basis (n, r), by a scaled pseudo-inverse."""
    return np.asarray(basis @ scaled_inverse(basis.T @ normal @ basis) @ basis.T)


def _overidentification(residual: Array, moments: Array, noise: Array) -> tuple[float, int]:
    """Hansen's statistic of moments (m,), residual (m, size) times the noise, and its degrees."""
    covariance = residual @ noise @ residual.T
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    size = np.where(size > 1e-9 * max(float(np.max(size, initial=0.0)), TINY), size, np.inf)
    eigenvalues, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    keep = eigenvalues > 1e-8
    projected = vectors[:, keep].T @ (moments / size)
    return float(np.sum(projected**2 / eigenvalues[keep])), int(keep.sum())


def jacobian_of(st: StageFit, k: int) -> Array:
    """d theta / d all parameters of part k at the estimate, (ntheta, np)."""
    e = st.equations[k].equation
    return np.asarray(e.jacobian([st.values[k][n] for n in e.parameters])[1])


def free_slope(st: StageFit, k: int, free: Sequence[str]) -> Array:
    """d theta / d `free` of part k, (ntheta, len(free)); zero for what its load case fixes."""
    parameters = st.equations[k].equation.parameters
    moves = np.array([f not in st.parts[k].known for f in free], dtype=bool)
    slope = jacobian_of(st, k)[:, [parameters.index(f) for f in free]]
    return np.where(moves, slope, 0.0)


def _tangent(st: StageFit, free: Sequence[str]) -> Array:
    """Basis of the directions that the user's constraints leave, (nfree, r)."""
    names = st.solution.names
    rows = st.solution.constraint_jacobian
    if not rows.size or not set(free) <= set(names):
        return np.eye(len(free))
    own = [j for j, n in enumerate(names) if n not in st.free]
    if own:  # lifted: eliminate theta from the constraints
        u, s, _ = np.linalg.svd(rows[:, own])
        rank = int(np.sum(s > 1e-12 * s[0])) if len(s) else 0
        rows = u[:, rank:].T @ rows
    rows = rows[:, [names.index(f) for f in free]]
    if not rows.size:
        return np.eye(len(free))
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    _, s, vt = np.linalg.svd(rows / np.where(size > 0, size, 1.0))
    return np.asarray(vt[int(np.sum(s > 1e-10)) :].T)
