"""Score tests of every effect at once, at one family-wise false-alarm rate.

For candidate j with whitened sensitivity psi_j at its null value, Gamma the regression on the
baseline's own sensitivities T, and e the whitened residual,

    z_j = (psi_j - T Gamma_j)' e + c_j - Gamma_j' c_T                                          (1)

is a Lagrange multiplier score that is orthogonal to small errors of the baseline's estimate. The
corrections c remove what noise on a measured input gives to sensitivity and residual alike:
E[psi' e] = -E[(d psi w)' (G w)], estimated by simulating with antithetic noise added to the inputs.
(1) is linear in the baseline's error, and the noise of an input biases the baseline itself: a least
squares estimate may be wrong by several standard errors, in directions of which the record says
little. So it is first moved to the root of

    T' e + c_T = 0                                                                             (2)

whose left side has mean zero at the truth. Between its samples a measured input is not known: a
line misses a first-order response of time constant T as a delay of Ts^2 / 12 T would. The p of a
score is the largest under what a delay of up to `SCORES.between_samples` could give to it
(Armstrong and Kolesar, Econometrica 86 (2018) 655-683: tests that are aware of a bounded bias).

The scores' covariance is robust to what whitening left (Newey and West 1987); the threshold for the
whole family comes from Gaussian draws with that covariance (Romano and Wolf 2005).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from casid.arrays import TINY, Array, basis_of
from casid.diagnosis.evidence.scores.signature_columns import Columns, extended_columns, without
from casid.diagnosis.evidence.scores.window_states import left_by_states, states_of_windows
from casid.diagnosis.thresholds import PREWHITENING, SCORES
from casid.errors import SolveError
from casid.estimation.covariance import bartlett_lags, long_run_covariance
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.effect import Effect
from casid.model.effects.names import ACTS_LATE


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
    visible: float  # share of the signature outside the baseline's tangent space; see `_reach`
    starts: Mapping[str, float] = field(default_factory=dict)  # first guesses beside `step`

    @property
    def is_visible(self) -> bool:
        """True if the record shows it, or shows little of it that explains what noise cannot."""
        hardly = self.visible > SCORES.hardly_detectable and self.unrobust > SCORES.much
        return self.visible > SCORES.undetectable or hardly


@dataclass(frozen=True, slots=True, eq=False)
class ScoreTable:
    """All candidates' tests with the angles between their signatures."""

    scores: tuple[Score, ...]
    cosines: Array  # (K, K) of whitened, projected signatures
    lags: int
    family: Family
    peaks: tuple[Score, ...] = ()  # lines of the residual's spectrum, tested beside the scores
    overflowing: tuple[Effect, ...] = ()  # not tested: their sensitivities overflow

    @property
    def tested(self) -> tuple[Score, ...]:
        """Every candidate that this record could show, peaks among them."""
        return tuple(s for s in (*self.scores, *self.peaks) if s.is_visible)

    @property
    def smallest(self) -> Score | None:
        """The most significant candidate."""
        return min(self.tested, key=lambda s: (s.adjusted, s.p_value), default=None)

    def adjusted(self, key: tuple[str, str]) -> float:
        """Smallest family-wise p of an effect, over its variants."""
        return min((s.adjusted for s in self.tested if s.effect.key == key), default=1.0)

    def with_peaks(self, peaks: Sequence[Score]) -> ScoreTable:
        """The table with spectral lines added, whose p-values are over all frequencies.

        Scores and peaks are two families that hardly know of each other: the smallest p of both
        together is as small as p with probability 1 - (1 - F(p)) (1 - p).
        """
        if not peaks:
            return self

        def both(p: float, one: float, other: float) -> float:
            """Family-wise p over two families, from that of each; no less than `p` itself."""
            return float(
                min(
                    1.0,
                    max(
                        -np.expm1(np.log1p(-min(one, 0.999999)) + np.log1p(-min(other, 0.999999))),
                        p,
                    ),
                )
            )

        return replace(
            self,
            scores=tuple(
                replace(s, adjusted=both(s.p_value, s.adjusted, s.p_value)) for s in self.scores
            ),
            peaks=tuple(
                replace(s, adjusted=both(s.p_value, self.family(s.p_value), s.p_value))
                for s in peaks
            ),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """Distribution of the smallest p of all candidates where nothing is missing."""

    smallest: Array  # (draws,) sorted, of Gaussian scores with the candidates' covariance
    count: int  # candidates

    def __call__(self, p: float) -> float:
        """Family-wise p; below the resolution of the draws, Bonferroni's bound."""
        draws = len(self.smallest)
        bound = min(1.0, self.count * p)
        if not draws:
            return bound
        drawn = (int(np.searchsorted(self.smallest, p, side="right")) + 1) / (draws + 1)
        return min(bound, drawn) if drawn > SCORES.resolved / draws else bound


@dataclass(frozen=True, slots=True, eq=False)
class _Projected:
    """Scores of K signatures of unit size, off the baseline's tangent."""

    z: Array  # (K,) of (1)
    left: Array  # (K,) squares of each signature outside the tangent
    share: Array  # (K,) the same of what the initial states of windows leave of it
    size: Array  # (K,) of each signature before it was scaled
    gram: Array  # (K, K) of the projected signatures
    covariance: Array  # (K, K) of z
    visible: Array  # (K,) bool
    finite: Array  # (K,) bool: its sensitivities do not overflow
    lags: int
    n: int  # samples

    def taken(self, order: Sequence[int]) -> _Projected:
        """The columns of these numbers."""
        k, both = list(order), np.ix_(order, order)
        return _Projected(
            *(self.z[k], self.left[k], self.share[k], self.size[k]),
            *(self.gram[both], self.covariance[both], self.visible[k]),
            *(self.finite[k], self.lags, self.n),
        )


def _projected(name: str, columns: Columns, input_sd: Mapping[str, float], seed: int) -> _Projected:
    """(1) for every signature of a model by name, with the covariance of all."""
    wide = columns.wide
    x, ny = wide.start, len(wide.outputs)
    sd = np.array([input_sd.get(n, 0.0) for n in wide.model.inputs])
    rng = np.random.default_rng(seed)
    parts: list[tuple[Array, Array, Array]] = []
    drawn: list[tuple[Array, Array, Array]] = []
    for k in range(len(wide.data)):
        parts.append(columns.of_record(x, k))
        if np.any(sd > 0):
            drawn.append(columns.antithetic(x, k, sd, rng))
    e, tangent, rest = (_joined([part[i] for part in parts]) for i in range(3))
    parts.clear()
    # Signatures are as long as all records: they are scaled and projected where they are.
    size = np.sqrt(np.maximum(np.einsum("ij,ij->j", rest, rest), TINY))
    finite = np.isfinite(size)
    rest[:, ~finite], size[~finite] = 0.0, 1.0
    rest /= size
    _require_finite(name, tangent, e)
    reach = _reach(columns, tangent, rest)
    # Columns of T may be nearly dependent: project by an orthonormal basis.
    t_size = np.sqrt(np.maximum(np.einsum("ij,ij->j", tangent, tangent), TINY))
    tangent /= t_size
    u, s, vt = np.linalg.svd(tangent, full_matrices=False)
    keep = s > 1e-8 * s[0]
    gamma = (vt[keep].T / s[keep]) @ (u[:, keep].T @ rest)
    _take_out(rest, tangent, gamma)
    left = np.einsum("ij,ij->j", rest, rest)
    share = left / reach
    z = rest.T @ e
    # Score of the baseline itself, zero at its minimum except for the bias just corrected.
    per_sample = np.einsum("kij,ki->kj", rest.reshape(-1, ny, len(size)), e.reshape(-1, ny))
    hardly = (share > SCORES.hardly_detectable) & (z**2 > SCORES.much * left)
    visible = (share > SCORES.undetectable) | hardly
    lags = bartlett_lags(per_sample[:, visible]) if visible.any() else 0
    n = len(per_sample)
    covariance = long_run_covariance(per_sample, lags)
    del per_sample
    if drawn:
        moved, turned, given = (_joined([d[i] for d in drawn]) for i in range(3))
        drawn.clear()
        moved = left_by_states(tangent[:, states_of_windows(wide, columns.tangent)], moved)
        given /= size
        given[:, ~(finite & np.isfinite(given).all(axis=0))] = 0.0
        _take_out(given, turned / t_size, gamma)
        given = np.einsum("kij,ki->kj", given.reshape(-1, ny, len(size)), moved.reshape(-1, ny))
        z -= given.sum(axis=0)
        # One draw is as far from its mean as chance has it: that is uncertainty, too.
        covariance = covariance + long_run_covariance(given, lags)
    return _Projected(z, left, share, size, rest.T @ rest, covariance, visible, finite, lags, n)


def _reach(columns: Columns, tangent: Array, rest: Array) -> Array:
    """(K,) squares of signatures of unit size that the initial states of windows leave of them.

    An unstable model magnifies whatever acts on it until a window ends, as it does an error of the
    state in which that begins: nearly all of a signature is then that growth. What the parameters
    have in common with it is their part in the rest. 1 where no record is cut.
    """
    states = states_of_windows(columns.wide, columns.tangent)
    if not states:
        return np.ones(rest.shape[1])
    taken = basis_of(tangent[:, states]).T @ rest
    left = 1.0 - np.einsum("ij,ij->j", taken, taken)
    return np.asarray(np.maximum(left, SCORES.least_reach))


def score_test(
    fit: Fit,
    effects: Sequence[Effect],
    *,
    input_sd: Mapping[str, float],
    draws: int = SCORES.draws,
    seed: int = 0,
) -> ScoreTable:
    """Test every effect against the fitted model (see the module's docstring).

    Parameters
    ----------
    fit : whitened simulation error of the model without the effects, near its minimum.
    input_sd : standard deviation of the white noise of each measured input.
    """
    if not effects:
        return ScoreTable((), np.empty((0, 0)), 0, Family(np.empty(0), 0))
    columns = extended_columns(fit, effects)
    return scores_of(columns, fit.criterion, input_sd=input_sd, draws=draws, seed=seed)


def scores_of(
    columns: Columns,
    criterion: SimulationError,
    *,
    input_sd: Mapping[str, float],
    draws: int = SCORES.draws,
    seed: int = 0,
) -> ScoreTable:
    """`score_test` of columns that are at hand, at the start of their criterion.

    Parameters
    ----------
    criterion : of the model without the effects.
    draws : 0: the family's p is Bonferroni's bound.
    """
    both = _projected(criterion.model.name, columns, input_sd, seed)
    judged = columns.judged
    kept = [j for j in range(len(judged)) if both.finite[j] and both.finite[judged[j]]]
    effects = [columns.effects[j] for j in kept]
    at = both.taken([judged[j] for j in kept])
    z, left, share, size, visible = at.z, at.left, at.share, at.size, at.visible
    sd_z = np.sqrt(np.maximum(np.diag(at.covariance), TINY))
    possible = _between_samples(criterion, effects, np.abs(at.gram) * size)
    ratio, bias = (np.where(visible, a / sd_z, 0.0) for a in (z, possible))
    freedom = max(SCORES.freedom_per_lag * at.n / (at.lags + 1), SCORES.least_freedom)
    one = np.array([eff.sided == "positive" or eff.test == "clip" for eff in effects])
    # P(|t + b| > |z|) at the largest bias b, whichever its sign.
    near, far = np.abs(ratio) - bias, np.abs(ratio) + bias
    two = student.sf(near, freedom) + student.sf(far, freedom)
    p = np.where(one, student.sf(ratio - bias, freedom), np.minimum(two, 1.0))
    p = np.where(visible, np.clip(p, TINY, 1.0), 1.0)
    family = _family_of(at.covariance, visible, one, freedom, draws, seed)
    adjusted = np.where(visible, [family(float(each)) for each in p], 1.0)
    plain = both.taken(kept)
    norms = np.sqrt(np.maximum(plain.left, TINY))
    scores = tuple(
        Score(
            effect=eff,
            z=float(ratio[j]),
            p_value=float(p[j]),
            adjusted=float(adjusted[j]),
            energy=float(left[j] * size[j] ** 2),
            step=float(z[j] / max(left[j], TINY) / size[j]) if visible[j] else 0.0,
            unrobust=float(z[j] ** 2 / left[j])
            if visible[j] and not (one[j] and z[j] < 0)
            else 0.0,
            visible=float(share[j]),
        )
        for j, eff in enumerate(effects)
    )
    return ScoreTable(
        scores,
        plain.gram / np.outer(norms, norms),
        at.lags,
        family,
        overflowing=tuple(e for j, e in enumerate(columns.effects) if j not in kept),
    )


def _require_finite(name: str, tangent: Array, e: Array) -> None:
    if not (np.all(np.isfinite(tangent)) and np.all(np.isfinite(e))):
        raise SolveError(
            f"{name}: its sensitivities overflow; no effect can be tested. Shorten the "
            "window, or change the parameters that make it grow"
        )


def _between_samples(
    criterion: SimulationError, effects: Sequence[Effect], response: Array
) -> Array:
    """Error (K,) of the scores by measured inputs that are not linear between their samples.

    `response` (K, K): score of each effect, without its sign, to a unit of each other.
    """
    inputs = criterion.model.inputs
    Ts = max(d.Ts for d in criterion.data)
    late = [
        j
        for j, e in enumerate(effects)
        if e.kind == "time_delay"
        and e.shape != ACTS_LATE
        and e.where in inputs
        and (inputs[e.where].kind, inputs[e.where].hold) == ("measured", "foh")
    ]
    return np.asarray(SCORES.between_samples * Ts * response[:, late].sum(axis=1))


def has_finite_tangent(fit: Fit) -> bool:
    """True if the model's own sensitivities do not overflow, so that effects can be tested."""
    columns = Columns(fit.criterion, range(len(fit.x)))
    return all(
        np.all(np.isfinite(part))
        for k in range(len(fit.criterion.data))
        for part in columns.of_record(fit.x, k)
    )


class Step(NamedTuple):
    """A step of a search.

    Attributes
    ----------
    x : (n,) where it leads.
    length : in standard errors, before it is shortened.
    value : of the criterion where it begins.
    """

    x: Array
    length: float
    value: float


def step_without_bias(
    criterion: SimulationError, x: Array, input_sd: Mapping[str, float], *, seed: int = 0
) -> Step:
    """One Gauss-Newton step from `x` towards the root of (2).

    The matrix is T'T less what noise on the inputs gives to it. Where noise gives nearly all, the
    step is held short rather than turned round.
    """
    n = len(x)
    columns = Columns(criterion, range(n))
    value, gradient, matrix, noise = 0.0, np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
    sd = np.array([input_sd.get(name, 0.0) for name in criterion.model.inputs])
    rng = np.random.default_rng(seed)
    states = states_of_windows(criterion, range(n))
    for k in range(len(criterion.data)):
        r, t, _ = columns.of_record(x, k)
        value += 0.5 * float(r @ r)
        gradient += t.T @ r
        matrix += t.T @ t
        if np.any(sd > 0):
            moved, turned, _ = columns.antithetic(x, k, sd, rng)
            moved = left_by_states(t[:, states], moved)
            gradient -= turned.T @ moved
            noise += turned.T @ turned
    if not all(np.all(np.isfinite(part)) for part in (matrix, noise, gradient)):
        return Step(x, 0.0, value)  # the sensitivities overflow: no step can be trusted
    size = np.sqrt(np.maximum(np.diag(matrix), TINY))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    seen = values > 1e-12 * values[-1]
    root = vectors[:, seen] / np.sqrt(values[seen]) / size[:, None]  # root' (T'T) root = 1
    share, axes = np.linalg.eigh(np.eye(int(seen.sum())) - root.T @ noise @ root)
    step = axes @ (
        (axes.T @ (root.T @ gradient)) / np.maximum(share, PREWHITENING.least_information)
    )
    length = float(np.linalg.norm(step))
    step *= min(1.0, PREWHITENING.longest_step / max(length, TINY))
    lower, upper = (
        np.array([getattr(v, side) for v in criterion.variables]) for side in ("lower", "upper")
    )
    return Step(np.clip(x + root @ step, lower, upper), length, value)


def scan(fit: Fit, own: str | None, effects: Sequence[Effect]) -> Array:
    """Sum of squares that each effect would leave in the place of the parameter `own`, (K,).

    Linear in the effects, about a fit that already has one of their kind: the residual with that
    one taken out is regressed on each candidate's sensitivity and the other unknowns'. A fit that
    has none of the kind is given no `own`.
    """
    e, psi = regressed(fit, own, effects)
    size = np.maximum(np.einsum("ij,ij->j", psi, psi), TINY)
    return np.asarray(e @ e - (psi.T @ e) ** 2 / size)


def scan_pairs(
    fit: Fit, own: str | None, firsts: Sequence[Effect], lasts: Sequence[Effect]
) -> Array:
    """As `scan`, of each of `firsts` less each of `lasts` in the place of the parameter, (K, L)."""
    e, psi = regressed(fit, own, [*firsts, *lasts])
    products, along = psi.T @ psi, psi.T @ e
    size, k = np.diag(products), len(firsts)
    left = size[:k, None] + size[None, k:] - 2 * products[:k, k:]
    return np.asarray(e @ e - (along[:k, None] - along[None, k:]) ** 2 / np.maximum(left, TINY))


def regressed(fit: Fit, own: str | None, effects: Sequence[Effect]) -> tuple[Array, Array]:
    """Residual without the parameter `own` (M,) and signatures (M, K), off all other tangents.

    Parameters
    ----------
    own : a parameter of the fit that is taken out, as in `scan`; None where there is none. A large
        gain is taken out of the simulation: under one of -1 no other gain of the channel does
        anything.
    """
    base, columns = fit.criterion, extended_columns(fit, effects)
    wide = columns.wide
    x, is_gain = wide.start, any(e.is_new_gain for e in effects[:1])
    if own is not None and is_gain and abs(fit.values[own]) > SCORES.small_gain:
        x = without(wide, x, [own])
    parts = [columns.of_record(x, k) for k in range(len(wide.data))]
    e, t_all, psi = (_joined([part[i] for part in parts]) for i in range(3))
    parts.clear()
    rest = t_all
    if own is not None:
        mine = base.names.index(own)
        e = e + t_all[:, mine] * x[columns.tangent[mine]]
        rest = np.delete(t_all, mine, axis=1)
    rest = rest / np.sqrt(np.maximum(np.einsum("ij,ij->j", rest, rest), TINY))
    q, _ = np.linalg.qr(rest)
    e = e - q @ (q.T @ e)
    psi = psi[:, : len(effects)]
    _take_out(psi, q, q.T @ psi)
    return e, psi


def _joined(parts: list[Array]) -> Array:
    """Records one after another, the one itself where it is alone; empties the list."""
    out = parts[0] if len(parts) == 1 else np.concatenate(parts)
    parts.clear()
    return out


def _take_out(columns: Array, of: Array, gamma: Array) -> None:
    """columns -= of @ gamma, in place, some rows at a time."""
    for first in range(0, len(columns), SCORES.rows):
        rows = slice(first, first + SCORES.rows)
        columns[rows] -= of[rows] @ gamma


def _family_of(
    covariance: Array, visible: Array, one_sided: Array, freedom: float, draws: int, seed: int
) -> Family:
    """The smallest p among the visible candidates in Gaussian draws (Romano and Wolf 2005)."""
    index = np.flatnonzero(visible)
    if not index.size or not draws:
        return Family(np.zeros(0), len(index))
    sd = np.sqrt(np.maximum(np.diag(covariance)[index], TINY))
    correlation = covariance[np.ix_(index, index)] / np.outer(sd, sd)
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(seed)
    normal = rng.standard_normal((draws, len(index))) @ root.T
    chi = np.sqrt(rng.chisquare(freedom, draws) / freedom)
    sample = normal / chi[:, None]
    # The smallest p is that of the largest deviation of either kind: two tails are enough.
    one = one_sided[index]
    largest = np.where(one, sample, np.abs(sample))
    tails = []
    for part, sides in ((largest[:, one], 1), (largest[:, ~one], 2)):
        if part.shape[1]:
            tails.append(sides * student.sf(part.max(axis=1), freedom))
    return Family(np.sort(np.min(tails, axis=0)), len(index))
