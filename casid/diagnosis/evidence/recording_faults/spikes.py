"""Outliers: isolated spikes of a residual, found without a model of what else is missing.

With d_k = r_k - (r_{k-1} + r_{k+1}) / 2 a smooth misfit cancels; under white noise of variance
sigma^2, d has 1.5 sigma^2 and correlations -2/3 and 1/6. Large spikes stand out alone. Many small
ones show in the fourth moment of d, whose mean Hermite polynomial has, under normal noise,

    mean(h^4 - 6 h^2 + 3),   h = d / sd(d)                                                    (1)

the variance 24 (1 + 2 (2/3)^4 + 2 (1/6)^4) / N (Isserlis) and a tail that is far from normal: in
600 samples it is beyond 3.7 standard deviations twenty times as often. It is made normal by

    (1 - 2/(9 a) - ((1 - 2/a) / (1 + x sqrt(2/(a - 4))))^(1/3)) / sqrt(2/(9 a))                (2)

x the kurtosis in its standard deviations and a a function of N (Anscombe and Glynn, Biometrika 70,
227-234, 1983), for as many independent samples as leave (1) that variance. Many small ones show in
a mixture of normal distributions fitted to d, too.

Errors of a sensor or logger know nothing of the inputs. Spikes that follow the inputs' steps more
often than other samples do (Mann and Whitney 1947) are a fast response that the model lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from scipy.optimize import minimize
from scipy.stats import mannwhitneyu, norm

from casid.arrays import TINY, Array, BoolArray, robust_sd
from casid.diagnosis.thresholds import OUTLIERS, STEPS


@dataclass(frozen=True, slots=True, eq=False)
class Spikes:
    """Isolated spikes in one channel."""

    channel: str
    masks: tuple[Array, ...]  # a record (N,) bool
    count: int
    share: float
    size: float  # median height, channel's unit
    energy: float  # sum of squares that they carry
    p_value: float
    heights: tuple[Array, ...] = ()  # a record (spikes,): over the mean of its neighbours
    measured: tuple[Array, ...] = ()  # a record (spikes,): what was recorded there
    limit: float = 0.0  # standard deviations of d that each of them exceeds
    level: float = 0.05  # at which they were found


def find_spikes(
    channel: str,
    residuals: Sequence[Array],
    alpha: float,
    *,
    inputs: Sequence[Array] = (),
    anew: Sequence[Array] = (),
    simulated: Sequence[Array] = (),
    behind: Sequence[Array] = (),
    largest_share: float = OUTLIERS.largest_share,
) -> Spikes | None:
    """Samples that differ from both neighbours more than noise ever would.

    A sample is a spike when |d_k| exceeds the Gaussian threshold for all samples together at
    `alpha`, and the neighbours show half of it, turned round. Where (1) exceeds its own threshold
    and a mixture fits with few and clearly larger errors, samples that are rather of the larger
    kind are spikes as well. Scale: the larger of the median absolute deviation and the spread of
    the central 98 %, so that quantised records (many equal samples) do not count as noise-free.

    `inputs` (N, nu) of each record, where given: spikes that follow their steps are left alone.
    `anew`, where given: the samples of each record at which its simulation starts anew; what jumps
    there is no spike.
    `simulated` (N,) of each record, where given: what stands out in the simulation and not in the
    record, as a vibration of a poor fit that dies away in its first samples, is no error of it.
    `behind` (N,) of each record, where given: samples at which a step of the residual is taken as a
    spike is, as what an input did in a gap lasts.
    Returns None where there are none, or so many that they are not exceptions.
    """
    total = sum(len(r) for r in residuals)
    differences = [from_neighbours(r) for r in residuals]
    for d, starts in zip(differences, anew, strict=False):
        d[starts], d[starts - 1] = 0.0, 0.0
    long = [d for d in differences if len(d) >= OUTLIERS.shortest]
    if not long:
        return None
    sds = [_scale(d) for d in differences]
    largest = max(_largest(d) / s for d, s in zip(long, map(_scale, long), strict=True))
    p = min(2 * total * float(norm.sf(largest)), 1.0)
    threshold = float(norm.isf(alpha / (2 * total)))
    together = np.concatenate([d[1:-1] / s for d, s in zip(differences, sds, strict=True) if s > 0])
    fourth = fourth_moment_deviate(together)
    if _is_white(differences) and float(norm.sf(fourth)) < alpha:
        if (cut := _mixture_cut(together, largest_share)) is not None:
            threshold = min(threshold, cut)
            p = min(p, float(norm.sf(fourth)))
    tops = zip_longest(differences, sds, behind)
    masks = [_tops(d, sd, threshold, may_last) for d, sd, may_last in tops]
    for mask, response in zip(masks, _responses(masks, inputs, alpha), strict=False):
        mask &= ~response
    for mask, d, y in zip(masks, differences, simulated, strict=False):
        mask &= ~_is_of_model(d, from_neighbours(y), threshold)
    heights = [np.abs(d[mask]) for d, mask in zip(differences, masks, strict=True)]
    height = np.concatenate(heights)
    if not 0 < height.size <= largest_share * total:
        return None
    return Spikes(
        channel=channel,
        masks=tuple(masks),
        count=height.size,
        share=height.size / total,
        size=float(np.median(height)),
        energy=float(np.sum(height**2)),
        p_value=float(min(1.0, max(p, TINY))),
        heights=tuple(heights),
        limit=threshold,
        level=alpha,
    )


def spread_of_differences(residual: Array) -> float:
    """Standard deviation of d of a residual, without the tails."""
    return _scale(from_neighbours(residual))


def starts_apart(residual: Array, alpha: float) -> bool:
    """True if the first sample alone is far off: it was taken before the inputs had acted.

    What an output owes to inputs at once, a model has from the first sample on; a system that was
    at rest before the record has it a little later.
    """
    sd = _scale(from_neighbours(residual))
    if sd <= 0.0:
        return False
    first, second = np.abs(np.diff(residual[:3]))
    # Differences of two samples have 2 variances, those from two neighbours 1.5.
    limit = float(norm.isf(alpha / (2 * len(residual)))) * sd * np.sqrt(2 / 1.5)
    return bool(first > limit and second < OUTLIERS.neighbours[1] * first)


def _tops(d: Array, sd: float, threshold: float, may_last: Array | None) -> BoolArray:
    """Samples (N,) at which d exceeds `threshold` standard deviations, one a spike.

    A spike's neighbours show half of it, with the other sign: they are left out.

    Parameters
    ----------
    may_last : (N,) samples at which a step is taken as a spike is; None: no sample.
    """
    mask = np.zeros(len(d), dtype=bool)
    for k in np.flatnonzero(np.abs(d) > threshold * sd).tolist() if sd > 0 else ():
        is_top = np.abs(d[k]) >= np.abs(d[k - 1 : k + 2]).max()
        lasts = may_last is not None and bool(may_last[k])
        mask[k] = is_top and _stands_alone(d, k, sd, lasts=lasts)
    return mask


def _is_of_model(d: Array, of_model: Array, threshold: float) -> Array:
    """Samples (N,) that stand out of a simulation, and less so of its record."""
    stands_out = np.abs(of_model) > threshold * _scale(of_model)
    return np.asarray(stands_out & (np.abs(d + of_model) < OUTLIERS.in_record * np.abs(d)))


def _responses(masks: Sequence[Array], inputs: Sequence[Array], alpha: float) -> list[Array]:
    """Spikes (N,) of each record that respond to inputs: none, if they do not follow steps."""
    out = [np.zeros(len(mask), dtype=bool) for mask in masks]
    if not any(mask.any() for mask in masks):
        return out
    steps = [_latest_steps(u) for u in inputs]
    spiky = np.concatenate(masks)
    for i in range(min((s.shape[1] for s in steps), default=0)):
        size = np.concatenate([s[:, i] for s in steps])
        if np.ptp(size) == 0.0 or spiky.all():
            continue
        p = float(mannwhitneyu(size[spiky], size[~spiky], alternative="greater").pvalue)
        if p < alpha / steps[0].shape[1]:
            usual = float(np.quantile(size[~spiky], OUTLIERS.usual_steps))
            out = [
                a | (mask & (s[:, i] > usual)) for a, mask, s in zip(out, masks, steps, strict=True)
            ]
    return out


def _latest_steps(u: Array) -> Array:
    """The largest step (N, nu) of each input within the last samples; a record begins with one."""
    size = np.abs(np.diff(u, axis=0, prepend=u[:1]))
    size[0] = size.max(axis=0, initial=0.0)
    latest = size.copy()
    for lag in range(1, OUTLIERS.after_steps + 1):
        latest[lag:] = np.maximum(latest[lag:], size[:-lag])
    return latest


def from_neighbours(r: Array) -> Array:
    """d (N,) of a residual; zero at the ends and in records too short to judge."""
    d = np.zeros(len(r))
    if len(r) >= OUTLIERS.shortest:
        d[1:-1] = r[1:-1] - 0.5 * (r[:-2] + r[2:])
    return d


def _is_white(differences: Sequence[Array]) -> bool:
    """True if d has the correlations of white noise; a misfit has others."""
    power = sum(float(d @ d) for d in differences)
    one, two = (
        sum(float(d[:-lag] @ d[lag:]) for d in differences if len(d) > lag) / max(power, TINY)
        for lag in (1, 2)
    )
    far = max(abs(one + 2 / 3), abs(two - 1 / 6))
    return far < OUTLIERS.like_white


def _stands_alone(d: Array, k: int, sd: float, *, lasts: bool) -> bool:
    """False where a large d has not half of it, with the other sign, on both sides.

    Beside a step of the residual, or a part of it that goes on from sample to sample, one side
    shows nothing; it is half on average all the same, which is enough of what `lasts`. By noise
    alone the sides of a spike differ by sqrt(5/3) standard deviations. The first and the last
    sample have no d: the other side says it.
    """
    if abs(d[k]) < OUTLIERS.large * sd:
        return True
    beside = np.array([-d[j] / d[k] for j in (k - 1, k + 1) if 0 < j < len(d) - 1])
    least, most = OUTLIERS.neighbours
    uneven = max(STEPS.uneven, STEPS.by_noise * np.sqrt(5 / 3) * sd / abs(d[k]))
    return bool(least < beside.mean() < most and (lasts or np.ptp(beside) < uneven))


def _largest(d: Array) -> float:
    return float(np.max(np.abs(d), initial=0.0))


def _scale(d: Array) -> float:
    """Standard deviation of d without its tails."""
    if len(d) < OUTLIERS.shortest:
        return 0.0
    core = np.sort(np.abs(d[1:-1]))
    mad = robust_sd(core)
    body = core[: int(OUTLIERS.body * len(core))]
    # Standard deviation of a normal cut off at its central 96 %, undone.
    spread = float(np.sqrt(np.mean(body**2))) / 0.880
    return max(mad, spread, TINY)


def fourth_moment_deviate(h: Array) -> float:
    """The standard normal deviate (2) of (1), scaled by the variance of the differences."""
    n = len(h) / (1 + 2 * (2 / 3) ** 4 + 2 * (1 / 6) ** 4)  # of independent ones, as uncertain
    kurtosis = float(np.mean(h**4) / max(float(np.mean(h**2)), TINY) ** 2)
    mean, variance = 3 * (n - 1) / (n + 1), 24 * n * (n - 2) * (n - 3) / (n + 1) ** 2
    x = (kurtosis - mean) / np.sqrt(variance / ((n + 3) * (n + 5)))
    skewness = 6 * (n * n - 5 * n + 2) / ((n + 7) * (n + 9))
    skewness *= np.sqrt(6 * (n + 3) * (n + 5) / (n * (n - 2) * (n - 3)))
    a = 6 + 8 / skewness * (2 / skewness + np.sqrt(1 + 4 / skewness**2))
    shifted = 1 + x * np.sqrt(2 / (a - 4))
    root = np.cbrt((1 - 2 / a) / shifted) if shifted > 0 else np.inf
    return float((1 - 2 / (9 * a) - root) / np.sqrt(2 / (9 * a)))


def _mixture_cut(h: Array, largest_share: float) -> float | None:
    """|h| beyond which a sample is rather an error than noise; None if errors are not few.

    A spike of variance w shows in h with s + w where it occurs and s + w / 4 beside it, twice.
    Shares and variances by maximum likelihood; a tail that is merely heavy, or noise whose size
    changes, fits with a large share of errors hardly larger.
    """
    counts, edges = np.histogram(
        np.minimum(np.abs(h), OUTLIERS.farthest), 600, (0.0, OUTLIERS.farthest)
    )
    square = (0.5 * (edges[1:] + edges[:-1])) ** 2

    def parts(x: Array) -> tuple[float, float, list[Array]]:
        """Share of spikes, w / s, and the log densities of noise, spikes and what is beside."""
        share = OUTLIERS.fitted_share / (1 + float(np.exp(-x[0])))
        s, w = float(np.exp(x[1])), float(np.exp(x[2]))
        kinds = ((1 - 3 * share, s), (share, s + w), (2 * share, s + w / 4))
        logs = [np.log(weight) - 0.5 * np.log(v) - 0.5 * square / v for weight, v in kinds]
        return share, w / s, logs

    def loss(x: Array) -> float:
        return -float(counts @ np.logaddexp.reduce(parts(x)[2])) / len(h)

    best = minimize(
        loss,
        np.array([-3.0, 0.0, 2.0]),
        method="Nelder-Mead",
        options={"maxiter": 400, "xatol": 1e-3, "fatol": 1e-8},
    )
    share, ratio, (noise, spike, beside) = parts(best.x)
    # The largest share is of what is found; of those there are, not all rise from the noise.
    if share > OUTLIERS.undetected_share * largest_share or ratio < OUTLIERS.faintest:
        return None
    is_spike = spike > np.logaddexp(noise, beside)
    return float(edges[int(np.argmax(is_spike))]) if np.any(is_spike) else None
