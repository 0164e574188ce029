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

from casid.arrays import TINY, Array
from casid.estimation.moments.moment_covariance import (
    are_short,
    combined_covariance,
    moment_covariance,
)
from casid.estimation.moments.stage import StageFit


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
    how : passed to `casid.estimation.moments.moment_covariance.moment_covariance`.
    """
    entries = [(i, k) for i, st in enumerate(stages) for k in range(len(st.parts))]
    sizes = [len(stages[i].equations[k].Z) for i, k in entries]
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(int)
    q = len(prior_names)
    total = q + int(offsets[-1])
    noise = np.zeros((total, total))
    if q:
        noise[:q, :q] = prior_covariance
    noise[q:, q:] = moment_covariance(
        [stages[i].equations[k] for i, k in entries],
        [stages[i].thetas[k] for i, k in entries],
        [stages[i].parts[k].record for i, k in entries],
        how=how,
    )
    names = list(prior_names)
    full: Array = np.zeros((q, total))
    full[:, :q] = np.eye(q)
    alone: Array = full.copy()
    active: list[bool] = []
    residual: list[Array] = []
    statistic_parts: list[Array] = []
    at = 0
    for st in stages:
        held = {*st.solution.at_lower, *st.solution.at_upper}
        free = [f for f in st.free if f not in held]
        normal = np.zeros((len(free), len(free)))
        forced, forced_alone = np.zeros((len(free), total)), np.zeros((len(free), total))
        rows = []
        for k, (e, root) in enumerate(zip(st.equations, st.roots, strict=True)):
            jacobian = jacobian_of(st, k)
            index = {n: c for c, n in enumerate(e.equation.parameters)}
            fixed = st.parts[k].known
            A = root @ e.Phi @ free_slope(st, k, free)
            source = np.zeros((len(e.Z), total))
            column = q + int(offsets[at + k])
            source[:, column : column + len(e.Z)] = np.eye(len(e.Z))
            earlier = source.copy()
            for r, n in enumerate(names):
                if n in index and n not in fixed and n not in st.free:
                    earlier -= np.outer(e.Phi @ jacobian[:, index[n]], full[r])
            normal += A.T @ A
            forced += A.T @ root @ earlier
            forced_alone += A.T @ root @ source
            rows.append((A, root @ earlier, root @ (e.Y - e.Phi @ st.thetas[k])))
        basis = _tangent(st, free)
        reduced = basis.T @ normal @ basis
        scale = 1 / np.sqrt(np.maximum(np.diag(reduced), TINY))
        inverse = (
            basis
            @ (
                np.outer(scale, scale)
                * np.linalg.pinv(reduced * np.outer(scale, scale), rcond=1e-13)
            )
            @ basis.T
        )
        moved, moved_alone = inverse @ forced, inverse @ forced_alone
        for A, direct, value in rows:
            residual.append(direct - A @ moved)
            statistic_parts.append(value)
        wide, wide_alone = np.zeros((len(st.free), total)), np.zeros((len(st.free), total))
        for r, f in enumerate(free):
            wide[st.free.index(f)], wide_alone[st.free.index(f)] = moved[r], moved_alone[r]
        full, alone = np.concatenate([full, wide]), np.concatenate([alone, wide_alone])
        names += list(st.free)
        active += [f in free for f in st.free]
        at += len(st.parts)
    left = np.vstack(residual)
    value = np.concatenate(statistic_parts)
    covariance = left @ noise @ left.T
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    size = np.where(size > 1e-9 * max(float(np.max(size, initial=0.0)), TINY), size, np.inf)
    eigenvalues, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    keep = eigenvalues > 1e-8
    projected = vectors[:, keep].T @ (value / size)

    def spread(maps: Array) -> Array:
        equations = [stages[i].equations[k] for i, k in entries]
        thetas = [stages[i].thetas[k] for i, k in entries]
        if how not in (None, "independent") or not are_short(equations):
            return np.asarray(maps @ noise @ maps.T)
        records = [stages[i].parts[k].record for i, k in entries]
        known = maps[:, :q] @ noise[:q, :q] @ maps[:, :q].T
        return np.asarray(known + combined_covariance(equations, thetas, records, maps[:, q:]))

    everything = spread(full[q:])
    return Propagated(
        names=tuple(names[q:]),
        covariance=everything,
        own=everything if np.array_equal(full, alone) else spread(alone[q:]),
        active=np.array(active),
        statistic=float(np.sum(projected**2 / eigenvalues[keep])),
        degrees=int(keep.sum()),
    )


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
