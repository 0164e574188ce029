"""Score tests of every effect at once, at one family-wise false-alarm rate.

For candidate j with whitened sensitivity psi_j at its null value, Gamma the regression on the
baseline's own sensitivities T, and e the whitened residual,

    z_j = (psi_j - T Gamma_j)' e + c_j - Gamma_j' c_T                                          (1)

is a Lagrange multiplier score that does not feel small errors of the baseline's estimate. The
corrections c remove what noise on a measured input gives to sensitivity and residual alike:
E[psi' e] = -E[(d psi w)' (G w)], estimated by simulating with antithetic noise added to the inputs.
(1) is linear in the baseline's error, and the noise of an input biases the baseline itself: a least
squares estimate may be wrong by several standard errors, in directions of which the record tells
little. So it is first moved to the root of

    T' e + c_T = 0                                                                             (2)

whose left side has mean zero at the truth. The scores' covariance is robust to what whitening left
(Newey and West 1987); the threshold for the whole family comes from Gaussian draws with that
covariance (Romano and Wolf 2005).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import t as student

from casid.effects import Effect, extend_all
from casid.errors import ModelError
from casid.model import Model
from casid.simulation_error import Fit, SimulationError
from casid.uncertainty import bartlett_lags, long_run_covariance

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """One candidate's test."""

    effect: Effect
    z: float  # standardised, robust
    p_value: float  # of this candidate alone
    adjusted: float  # family-wise
    energy: float  # psi' psi of the projected signature: what one unit of the parameter gives
    step: float  # first guess of the parameter
    unrobust: float  # Lagrange multiplier statistic with unit variance, chi^2(1)
    visible: float  # share of the signature outside the baseline's tangent space


@dataclass(frozen=True, slots=True, eq=False)
class ScoreTable:
    """All candidates' tests with the angles between their signatures."""

    scores: tuple[Score, ...]
    cosines: Array  # (K, K) of whitened, projected signatures
    lags: int

    @property
    def smallest(self) -> Score | None:
        """The most significant candidate."""
        tested = [s for s in self.scores if s.visible > INVISIBLE]
        return min(tested, key=lambda s: (s.adjusted, s.p_value), default=None)


INVISIBLE = 1e-4


def score_test(
    fit: Fit,
    effects: Sequence[Effect],
    *,
    input_sd: Mapping[str, float],
    draws: int = 4000,
    seed: int = 0,
) -> ScoreTable:
    """Test every effect against the fitted model (see the module's docstring).

    Parameters
    ----------
    fit : whitened simulation error of the model without the effects, near its minimum.
    input_sd : standard deviation of the white noise of each measured input.
    """
    base = fit.criterion
    smooth = [e for e in effects if e.test == "score"]
    clipped = [e for e in effects if e.test == "clip"]
    model, names = extend_all(base.model, smooth)
    wide = _widened(fit, model)
    x = wide.start
    position = {n: i for i, n in enumerate(wide.names)}
    tangent = [position[n] for n in base.names]
    candidate = [position[n] for n in names]
    tangent_parts, psi_parts, e_parts = [], [], []
    drawn: list[tuple[Array, Array, Array]] = []
    rng = np.random.default_rng(seed)
    inputs = list(wide.model.inputs)
    for k in range(len(wide.data)):
        r, t, psi = _columns(wide, x, k, tangent, candidate, clipped, None)
        e_parts.append(r)
        tangent_parts.append(t)
        psi_parts.append(psi)
        sd = np.array([input_sd.get(n, 0.0) for n in inputs])
        if np.any(sd > 0):
            drawn.append(_antithetic(wide, x, k, tangent, candidate, clipped, sd, rng))
    ny = len(wide.outputs)
    e, t_all, psi = (np.concatenate(p) for p in (e_parts, tangent_parts, psi_parts))
    size = np.sqrt(np.maximum(np.einsum("ij,ij->j", psi, psi), 1e-300))
    unit_psi = psi / size
    # Columns of T may be nearly dependent: project by an orthonormal basis.
    t_size = np.sqrt(np.maximum(np.einsum("ij,ij->j", t_all, t_all), 1e-300))
    u, s, vt = np.linalg.svd(t_all / t_size, full_matrices=False)
    keep = s > 1e-8 * s[0]
    gamma = (vt[keep].T / s[keep]) @ (u[:, keep].T @ unit_psi)
    rest = unit_psi - (t_all / t_size) @ gamma
    left = np.einsum("ij,ij->j", rest, rest)
    z = rest.T @ e
    # Score of the baseline itself, zero at its minimum except for the bias just corrected.
    per_sample = np.add.reduceat(rest * e[:, None], np.arange(0, len(e), ny), axis=0)
    visible = left > INVISIBLE
    lags = bartlett_lags(per_sample[:, visible]) if visible.any() else 0
    covariance = long_run_covariance(per_sample, lags)
    if drawn:
        moved, turned, changed = (np.concatenate([d[i] for d in drawn]) for i in range(3))
        given = (changed / size - (turned / t_size) @ gamma) * moved[:, None]
        z -= given.sum(axis=0)
        # One draw is as far from its mean as chance has it: that is uncertainty, too.
        given = np.add.reduceat(given, np.arange(0, len(e), ny), axis=0)
        covariance = covariance + long_run_covariance(given - given.mean(axis=0), lags)
    sd_z = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    ratio = np.where(visible, z / sd_z, 0.0)
    freedom = max(1.5 * len(per_sample) / (lags + 1), 4.0)
    one = np.array([eff.sided == "positive" or eff.test == "clip" for eff in effects])
    p = np.where(one, student.sf(ratio, freedom), 2 * student.sf(np.abs(ratio), freedom))
    p = np.where(visible, np.clip(p, 1e-300, 1.0), 1.0)
    adjusted = _family_wise(p, covariance, visible, one, freedom, draws, seed)
    norms = np.sqrt(np.maximum(left, 1e-300))
    cosines = (rest.T @ rest) / np.outer(norms, norms)
    scores = tuple(
        Score(
            effect=eff,
            z=float(ratio[j]),
            p_value=float(p[j]),
            adjusted=float(adjusted[j]),
            energy=float(left[j] * size[j] ** 2),
            step=float(z[j] / max(left[j], 1e-300) / size[j]) if visible[j] else 0.0,
            unrobust=float(z[j] ** 2 / left[j])
            if visible[j] and not (one[j] and z[j] < 0)
            else 0.0,
            visible=float(left[j]),
        )
        for j, eff in enumerate([*smooth, *clipped])
    )
    return ScoreTable(scores, cosines, lags)


LONGEST = 25.0
"""Length of one step towards (2), in standard errors: further away nothing is linear."""


def step_without_bias(
    criterion: SimulationError, x: Array, input_sd: Mapping[str, float], *, seed: int = 0
) -> tuple[Array, float]:
    """One Gauss-Newton step from `x` towards the root of (2), and its length in standard errors.

    The matrix is T'T less what noise on the inputs gives to it. Where noise gives nearly all, the
    step is held short rather than turned round.
    """
    n = len(x)
    gradient, matrix, noise = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
    sd = np.array([input_sd.get(name, 0.0) for name in criterion.model.inputs])
    rng = np.random.default_rng(seed)
    for k in range(len(criterion.data)):
        r, t, _ = _columns(criterion, x, k, range(n), [], [], None)
        gradient += t.T @ r
        matrix += t.T @ t
        if np.any(sd > 0):
            moved, turned, _ = _antithetic(criterion, x, k, range(n), [], [], sd, rng)
            gradient -= turned.T @ moved
            noise += turned.T @ turned
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    seen = values > 1e-12 * values[-1]
    root = vectors[:, seen] / np.sqrt(values[seen]) / size[:, None]  # root' (T'T) root = 1
    share, axes = np.linalg.eigh(np.eye(int(seen.sum())) - root.T @ noise @ root)
    step = axes @ ((axes.T @ (root.T @ gradient)) / np.maximum(share, 0.2))
    length = float(np.linalg.norm(step))
    step *= min(1.0, LONGEST / max(length, 1e-300))
    lower, upper = (
        np.array([getattr(v, side) for v in criterion.variables]) for side in ("lower", "upper")
    )
    return np.clip(x + root @ step, lower, upper), length


def scan(fit: Fit, own: str, effects: Sequence[Effect]) -> Array:
    """Sum of squares that each effect would leave in the place of the parameter `own`, (K,).

    Linear in the effects, about a fit that already has one of their kind: the residual with that
    one taken out is regressed on each candidate's sensitivity and the other unknowns'.
    """
    base = fit.criterion
    model, names = extend_all(base.model, effects)
    wide = _widened(fit, model)
    position = {n: i for i, n in enumerate(wide.names)}
    tangent = [position[n] for n in base.names]
    candidate = [position[n] for n in names]
    parts = [
        _columns(wide, wide.start, k, tangent, candidate, [], None) for k in range(len(wide.data))
    ]
    e, t_all, psi = (np.concatenate([part[i] for part in parts]) for i in range(3))
    mine = base.names.index(own)
    e = e + t_all[:, mine] * fit.x[mine]
    rest = np.delete(t_all, mine, axis=1)
    rest = rest / np.sqrt(np.maximum(np.einsum("ij,ij->j", rest, rest), 1e-300))
    q, _ = np.linalg.qr(rest)
    e = e - q @ (q.T @ e)
    psi = psi - q @ (q.T @ psi)
    size = np.maximum(np.einsum("ij,ij->j", psi, psi), 1e-300)
    return np.asarray(e @ e - (psi.T @ e) ** 2 / size)


def _widened(fit: Fit, model: Model) -> SimulationError:
    """The criterion of a fit for a model with more parameters, all of them at their start."""
    base = fit.criterion
    wide = SimulationError(
        model,
        base.experiments,
        own=base.own,
        weights=base.weights,
        whiten=base.whiten,
        substeps=base.substeps,
        start=fit.values,
    )
    for d, own in zip(wide.data, base.data, strict=True):
        d.used[:] &= own.used
    return wide


def _antithetic(
    wide: SimulationError,
    x: Array,
    k: int,
    tangent: Sequence[int],
    candidate: Sequence[int],
    clipped: Sequence[Effect],
    sd: Array,
    rng: np.random.Generator,
) -> tuple[Array, Array, Array]:
    """What one draw of noise on the inputs adds to `_columns`, its even part left out.

    Channels without noise take no part in the draw: candidates that bring one leave it as it is.
    """
    w = np.zeros(wide.data[k].u.shape)
    noisy = np.flatnonzero(sd > 0)
    w[:, noisy] = sd[noisy] * rng.standard_normal((len(w), len(noisy)))
    up, down = (_columns(wide, x, k, tangent, candidate, clipped, sign * w) for sign in (1.0, -1.0))
    return 0.5 * (up[0] - down[0]), 0.5 * (up[1] - down[1]), 0.5 * (up[2] - down[2])


def _columns(
    wide: SimulationError,
    x: Array,
    k: int,
    tangent: Sequence[int],
    candidate: Sequence[int],
    clipped: Sequence[Effect],
    added: Array | None,
) -> tuple[Array, Array, Array]:
    """Whitened residual, baseline tangent and candidate signatures, samples by outputs stacked."""
    d = wide.data[k]
    if added is not None:
        d = replace(d, u=d.u + added)
    at = wide.simulated(x, k, signals=d)
    extra = np.zeros((*at.y.shape, len(clipped)))
    for j, effect in enumerate(clipped):
        if effect.variant is None:
            raise ModelError(f"{effect!r} has no level to test at")
        i = wide.outputs.index(effect.where)
        y = at.y[:, i]
        extra[:, i, j] = (np.clip(y, -effect.variant, effect.variant) - y) * d.used[:, i]
    stack = np.concatenate([at.residual[:, :, None], at.jacobian, extra], axis=2)
    stack *= wide.weights[None, :, None]
    if wide.whiten is not None:
        stack = wide.whiten(stack, k)
    n = at.jacobian.shape[2]
    flat = stack.reshape(-1, stack.shape[2])
    columns = [1 + i for i in candidate] + [1 + n + j for j in range(len(clipped))]
    return flat[:, 0], flat[:, [1 + i for i in tangent]], flat[:, columns]


def _family_wise(
    p: Array,
    covariance: Array,
    visible: Array,
    one_sided: Array,
    freedom: float,
    draws: int,
    seed: int,
) -> Array:
    """Adjusted p-values by min-p draws; below their resolution, Bonferroni's bound."""
    index = np.flatnonzero(visible)
    out = np.ones(len(p))
    if not index.size:
        return out
    sd = np.sqrt(np.maximum(np.diag(covariance)[index], 1e-300))
    correlation = covariance[np.ix_(index, index)] / np.outer(sd, sd)
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((draws, len(index))) @ root.T
    chi = np.sqrt(rng.chisquare(freedom, draws) / freedom)
    sample = normal / chi[:, None]
    one = one_sided[index]
    worst = np.where(one, sample, np.abs(sample))
    tail = np.where(one, student.sf(worst, freedom), 2 * student.sf(worst, freedom))
    smallest = np.sort(tail.min(axis=1))
    for i in index:
        drawn = (np.searchsorted(smallest, p[i], side="right") + 1) / (draws + 1)
        out[i] = min(1.0, len(index) * p[i], drawn if drawn > 20 / draws else 1.0)
    return out
