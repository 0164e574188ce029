"""Tests of the residual against its noise model: is anything left, and of what kind?

Three questions, each answered at one false-alarm rate and then put together by Holm's rule
(Scand. J. Stat. 6 (1979) 65-70):

- Spectrum. The whitened residual's periodogram has independent exponential ordinates of mean one.
  Sums over bands are Gamma distributed; the normalised cumulative periodogram is a Brownian bridge
  (Bartlett 1954); the largest ordinate has the law of the largest of exponentials (Fisher 1929).
- Dependence. Scores of powers, signs and products of states, inputs and channels recorded beside
  them, and of each growing in time, as forces in every balance and as errors of every output, off
  the baseline's tangent (`signatures`).
- Time. Cumulative sums of the residual and of its square are Brownian bridges, each in units of its
  own long-run deviation (Inclan & Tiao 1994; Sanso, Arago & Carrion 2004, their kappa_2). Of what
  is left in the end also: scores of parameters that come and go (`with_constancy`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from scipy.fft import rfft
from scipy.special import kolmogorov
from scipy.stats import gamma, norm

from casid.arrays import TINY, Array
from casid.data.experiment import Experiment
from casid.diagnosis.evidence.residual.candidate_functions import regressions
from casid.diagnosis.evidence.residual.constancy import Unsteady, unsteady
from casid.diagnosis.evidence.residual.signatures import Regression
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import RESIDUAL, SCORES
from casid.estimation.covariance import bartlett_lags, long_run_covariance
from casid.estimation.feedback import one_sample_late
from casid.estimation.noise.residual_autoregressions import autoregression

ResidualKind = Literal[
    "noise as estimated",
    "a disturbance (random, uncorrelated with inputs and states)",
    "deterministic (depends on inputs or states)",
    "changes in time (mean or power)",
]

NOISE: ResidualKind = "noise as estimated"
DISTURBANCE: ResidualKind = "a disturbance (random, uncorrelated with inputs and states)"
DETERMINISTIC: ResidualKind = "deterministic (depends on inputs or states)"
IN_TIME: ResidualKind = "changes in time (mean or power)"


@dataclass(frozen=True, slots=True)
class Band:
    """The residual's power in one band over what the noise model says."""

    output: str
    low: float  # Hz
    high: float  # Hz
    ratio: float
    p_value: float  # of this band alone, that it is too large


@dataclass(frozen=True, slots=True)
class Correlated:
    """A function of inputs and states that the residual contains."""

    place: str  # balance or output
    function: str  # in words, like "p |p|"
    p_value: float  # for all functions and places together
    share: float  # of what is left that this and up to two more functions explain


@dataclass(frozen=True, slots=True, eq=False)
class ResidualTests:
    """Kind of the residual (noise, disturbance, deterministic), with the p-values behind it."""

    verdict: ResidualKind
    p_spectrum: float
    p_dependence: float
    p_time: float
    adjusted: float  # of the smallest, for the three questions together
    bands: tuple[Band, ...]
    correlated: Correlated | None  # the most significant, whether it is enough or not
    blocks: Array  # (B, 3) start, end [s, records end to end], power over the noise's
    p_mean: float  # that the residual's mean changes by chance
    p_power: float  # that its power changes over time by chance
    p_amplitude: float  # that its power goes with the outputs' amplitude by chance
    innovation_blocks: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """As `blocks`, of the innovations where they are tested in time; none in older files."""
    unsteady: Unsteady | None = None  # the least constant parameter

    def at_level(self, alpha: float) -> ResidualTests:
        """The tests judged at another false-alarm rate."""
        share = self.correlated.share if self.correlated is not None else 0.0
        ps = (self.p_spectrum, self.p_dependence, self.p_time)
        return replace(self, verdict=_verdict(*ps, share, alpha))

    @property
    def loudest(self) -> Band:
        """The band in which most is left, in significance."""
        return min(self.bands, key=lambda b: b.p_value)

    def to_json(self) -> dict[str, Any]:
        """The fields as a report holds them."""
        c = self.correlated
        return {
            "verdict": self.verdict,
            "p_spectrum": self.p_spectrum,
            "p_dependence": self.p_dependence,
            "p_time": self.p_time,
            "adjusted": self.adjusted,
            "bands": [
                {"output": b.output, "low": b.low, "high": b.high, "ratio": b.ratio, "p": b.p_value}
                for b in self.bands
            ],
            "correlated": None
            if c is None
            else {
                "place": c.place,
                "function": c.function,
                "p_value": c.p_value,
                "share": c.share,
            },
            "unsteady": None
            if self.unsteady is None
            else {"parameter": self.unsteady.parameter, "p_value": self.unsteady.p_value},
        }


def residual_tests(
    at: Weighted,
    experiments: Sequence[Experiment],
    recorded: Mapping[str, str] | None = None,
    *,
    alpha: float = 0.05,
    seed: int = 0,
    of_any_spectrum: bool = False,
) -> ResidualTests:
    """Test the residual of a model fitted under its noise.

    Parameters
    ----------
    recorded : channels beside the model's on which it may depend, name -> unit.
    alpha : rate at which a residual that is noise is called something else.
    of_any_spectrum : whether the residual may be a random force of a spectrum that the noise model
        does not have. Where it has another one, the tests in time are those of its innovations: a
        slow force wanders, and has loud and quiet stretches, by chance.
    seed : of the antithetic draw and of the draws that give the family's threshold.

    Notes
    -----
    The laws are those of long records; a white disturbance that the noise model has already counted
    as its own is noise as estimated.
    """
    fit = at.unbiased or at.fit
    criterion, x = fit.criterion, fit.x
    whitened, correlated = _correlated(at, experiments, recorded, alpha=alpha, seed=seed)
    p_dependence = 1.0 if correlated is None else correlated.p_value
    # Gaps would pass for a residual that is too small, in samples and frequencies.
    whitened = [at.noise.completed(white, k) for k, white in enumerate(whitened)]
    bands, p_spectrum = spectral_bands(criterion.outputs, whitened, [d.Ts for d in criterion.data])
    is_coloured = of_any_spectrum and p_spectrum < alpha
    tested_in_time = _innovations(whitened) if is_coloured else whitened
    p_mean, p_power, p_amplitude = _changes(
        tested_in_time, [criterion.simulated(x, k).y for k in range(len(criterion.data))]
    )
    p_time = min(1.0, 3 * min(p_mean, p_power, p_amplitude))
    share = correlated.share if correlated is not None else 0.0
    return ResidualTests(
        verdict=_verdict(p_spectrum, p_dependence, p_time, share, alpha),
        p_spectrum=p_spectrum,
        p_dependence=p_dependence,
        p_time=p_time,
        adjusted=min(1.0, 3 * min(p_spectrum, p_dependence, p_time)),
        bands=tuple(bands),
        correlated=correlated,
        blocks=_blocks(whitened, [d.Ts for d in criterion.data]),
        innovation_blocks=_blocks(tested_in_time, [d.Ts for d in criterion.data]),
        p_mean=p_mean,
        p_power=p_power,
        p_amplitude=p_amplitude,
    )


def depends_beyond_doubt(
    at: Weighted,
    experiments: Sequence[Experiment],
    recorded: Mapping[str, str] | None = None,
    *,
    seed: int = 0,
) -> bool:
    """True if a residual depends on states or inputs whatever random force acts as well.

    The test of the dependence alone, at a level that no refit under that force brings down: the
    functions are regressed off the model's tangent, on which a refit moves. Parameters as of
    `residual_tests`.
    """
    criterion = (at.unbiased or at.fit).criterion
    places = len(criterion.model.balances) + len(criterion.outputs)
    for _, _, regression in regressions(at, experiments, recorded, seed=seed):
        smallest = min((t.adjusted for t in regression.test()), default=1.0)
        if places * smallest < RESIDUAL.beyond_doubt:
            return True
    return False


def with_constancy(
    tests: ResidualTests,
    at: Weighted,
    experiments: Sequence[Experiment],
    recorded: Mapping[str, str] | None = None,
    *,
    alpha: float = 0.05,
    seed: int = 0,
) -> ResidualTests:
    """The tests of a residual with a fourth one over time: that parameters come and go.

    Parameters as of `residual_tests`.
    """
    least = unsteady(at, experiments, recorded, seed=seed)
    if least is None:
        return tests
    p_time = min(1.0, 4 * min(tests.p_mean, tests.p_power, tests.p_amplitude, least.p_value))
    adjusted = min(1.0, 3 * min(tests.p_spectrum, tests.p_dependence, p_time))
    new = replace(tests, p_time=p_time, adjusted=adjusted, unsteady=least)
    return new.at_level(alpha)


def _correlated(
    at: Weighted,
    experiments: Sequence[Experiment],
    recorded: Mapping[str, str] | None,
    *,
    alpha: float,
    seed: int,
) -> tuple[list[Array], Correlated | None]:
    """The whitened residual, (N, ny) a record, and what it is correlated with most."""
    criterion = (at.unbiased or at.fit).criterion
    places = [*criterion.model.balances, *criterion.outputs]
    whitened: list[Array] = []
    found: Correlated | None = None
    for place, named, regression in regressions(at, experiments, recorded, seed=seed):
        whitened = whitened or regression.residuals
        tested = regression.test()
        if not tested:
            continue
        best = min(tested, key=lambda t: t.p_value)
        p = min(1.0, len(places) * best.adjusted)
        share = _share(regression) if p < max(alpha, RESIDUAL.share_p) else 0.0
        if found is None or (p, -share) < (found.p_value, -found.share):
            found = Correlated(place, named[best.group], p, share)
    return whitened, found


def _verdict(
    p_spectrum: float, p_dependence: float, p_time: float, share: float, alpha: float
) -> ResidualKind:
    is_spectral, is_dependent, is_changing = _holm([p_spectrum, p_dependence, p_time], alpha)
    if is_dependent and share >= RESIDUAL.share:
        return DETERMINISTIC
    if is_changing:
        return IN_TIME
    if is_spectral:
        return DISTURBANCE
    return DETERMINISTIC if is_dependent else NOISE


def _holm(p: Sequence[float], alpha: float) -> list[bool]:
    """Which hypotheses are rejected with the family-wise rate `alpha`."""
    out = [False] * len(p)
    for rank, i in enumerate(np.argsort(p)):
        if p[i] >= alpha / (len(p) - rank):
            break
        out[i] = True
    return out


# -- dependence -----------------------------------------------------------------------------------


def _share(regression: Regression) -> float:
    """Share of what is left that the best function and up to two more explain."""
    chosen: list[int] = []
    gain = 0.0
    for k in range(RESIDUAL.functions):
        tested = regression.test(chosen, draws=SCORES.few_draws)
        if not tested:
            break
        best = max(tested, key=lambda t: t.gain)
        if k and best.gain < RESIDUAL.by_chance * best.chance:
            break
        # The best of K explains 2 log K times what each of them does by chance.
        by_choice = best.chance * max(2 * np.log(len(tested)), 1.0)
        gain += max(best.gain - by_choice, 0.0)
        chosen.append(best.group)
    return float(np.clip(gain / max(regression.misfit, regression.misfit_sd), 0.0, 1.0))


# -- spectrum -------------------------------------------------------------------------------------


def spectral_bands(
    outputs: Sequence[str], whitened: Sequence[Array], sample_times: Sequence[float]
) -> tuple[list[Band], float]:
    """Bands of every output over all records, and the p-value of the whole."""
    out: list[Band] = []
    smallest = [1.0]
    for i, name in enumerate(outputs):
        hertz, power = [], []
        for e, Ts in zip(whitened, sample_times, strict=True):
            n = len(e)
            hertz.append(np.arange(1, (n + 1) // 2) / (n * Ts))
            power.append(np.abs(rfft(e[:, i]))[1 : (n + 1) // 2] ** 2 / n)
        f, s = np.concatenate(hertz), np.concatenate(power)
        order = np.argsort(f, kind="stable")
        f, s = f[order], s[order]
        cuts = np.unique(np.geomspace(RESIDUAL.first_band, len(f), RESIDUAL.bands + 1).astype(int))
        cuts[0] = 0
        ps = []
        for a, b in zip(cuts[:-1], cuts[1:], strict=True):
            p = float(gamma.sf(s[a:b].sum(), b - a))
            ps.append(p)
            out.append(Band(name, float(f[a]), float(f[b - 1]), float(s[a:b].mean()), p))
        m = len(s)
        bridge = np.cumsum(s)[:-1] / s.sum() - np.arange(1, m) / m
        p_shape = float(kolmogorov(np.sqrt(m) * np.abs(bridge).max()))
        top = float(s.max() / s.mean())
        p_line = float(-np.expm1(m * np.log1p(-np.exp(-min(top, 700.0)))))
        smallest.append(3 * min(min(1.0, len(ps) * min(ps)), p_shape, p_line))
    return out, min(1.0, len(outputs) * min(smallest))


# -- time -----------------------------------------------------------------------------------------


def _changes(whitened: Sequence[Array], simulated: Sequence[Array]) -> tuple[float, float, float]:
    """p-values of a changing mean, a changing power, and a power that goes with amplitude.

    The amplitude is that of the sample before: in closed loop a sample's own noise may be in it.
    """
    e = np.concatenate(list(whitened))
    y = np.concatenate([one_sample_late(part) for part in simulated])
    ny = e.shape[1]
    square = np.sum(e**2, axis=1)
    p_mean = min(1.0, ny * min(drift_p_value(e[:, i]) for i in range(ny)))
    p_power = drift_p_value(square)
    amplitude = np.sum((y / np.maximum(y.std(axis=0), TINY)) ** 2, axis=1)
    # A sudden peak of the amplitude must not decide alone: ranks in place of values.
    rank = np.argsort(np.argsort(amplitude)) / len(amplitude) - 0.5
    # Ranks of power, too: the law of a sum of squares under a few large residuals is far off.
    height = np.argsort(np.argsort(square)) / len(square) - 0.5
    product = (rank * height)[:, None]
    sd = float(np.sqrt(long_run_covariance(product, bartlett_lags(product))[0, 0]))
    p_amplitude = float(2 * norm.sf(abs(float(product.sum())) / max(sd, TINY)))
    return p_mean, p_power, p_amplitude


def _innovations(whitened: Sequence[Array]) -> list[Array]:
    """Residuals (N, ny) of all records, each output by an autoregression of its own."""
    outputs = range(whitened[0].shape[1])
    models = [autoregression([e[:, i] for e in whitened]) for i in outputs]
    return [np.hstack([m.whiten(e[:, [i]]) for i, m in enumerate(models)]) for e in whitened]


def drift_p_value(values: Array) -> float:
    """p-value of the largest cumulative sum of `values` less their mean."""
    centred = (values - values.mean())[:, None]
    long_run = float(long_run_covariance(centred, bartlett_lags(centred))[0, 0])
    if long_run <= 0:
        return 1.0
    return float(kolmogorov(np.abs(np.cumsum(centred)).max() / np.sqrt(long_run)))


def _blocks(whitened: Sequence[Array], sample_times: Sequence[float]) -> Array:
    """Start, end [s] and mean square of stretches, records end to end."""
    rows, before = [], 0.0
    total = sum(len(e) * Ts for e, Ts in zip(whitened, sample_times, strict=True))
    for e, Ts in zip(whitened, sample_times, strict=True):
        count = max(2, round(RESIDUAL.blocks * len(e) * Ts / total))
        edges = np.linspace(0, len(e), count + 1).astype(int)
        for a, b in zip(edges[:-1], edges[1:], strict=True):
            rows.append([before + a * Ts, before + b * Ts, float(np.mean(e[a:b] ** 2))])
        before += len(e) * Ts
    return np.array(rows)
