"""A line of the spectrum and a narrow band of noise, and maxima of the likelihood beside them."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.evidence.whitening.weighted_model import Weighted, minus_log_likelihood
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from tests.diagnosis.search.noise_assumptions.test_disturbance_rival import hull, record

TS, N, AMPLITUDE, FREQUENCY = 2.0, 1500, 1.5e-4, 0.0113  # s, 1, m^3/s, Hz
PARTS = 10  # steps of the simulator a sample
INSTANTS = np.arange(N * PARTS)


def tank() -> casid.Problem:
    m = casid.Model("tank")
    h = m.state("h", "m", start=1.0)
    q = m.input("q", "m^3/s", known=True, hold="zoh")
    a = m.parameter("a", "m^2/s", start=0.02, lower=1e-4)
    A = m.parameter("A", "m^2", start=1.0, lower=0.01)
    m.balance(h, "volume", inertia=A, terms=[q, -a * h])
    m.output("level", h, "m")
    return casid.Problem("tank", m)


def pumped(seed: int) -> casid.Record:
    """A tank into which a further pump runs to and fro, 24 times in the fitted part."""
    return filled(seed, AMPLITUDE * np.sin(2 * np.pi * FREQUENCY * TS / PARTS * INSTANTS + 0.7))


def leaking(seed: int) -> casid.Record:
    """A tank whose inflow wanders by itself, slower than the level follows."""
    rng, pole = np.random.default_rng(100 + seed), np.exp(-TS / PARTS / 200.0)
    white = AMPLITUDE * np.sqrt(1 - pole**2) * rng.standard_normal(len(INSTANTS))
    return filled(seed, lfilter([1.0], [1.0, -pole], white))


def filled(seed: int, inflow: np.ndarray) -> casid.Record:
    """The level of a tank with a recorded inflow, and another (m^3/s) at every `INSTANTS`."""
    rng = np.random.default_rng(seed)
    q = np.repeat(0.02 + 0.005 * rng.standard_normal(N // 50), 50)
    h, step, level = 1.0, TS / PARTS, np.empty(N)
    for i in INSTANTS:
        if i % PARTS == 0:
            level[i // PARTS] = h
        h += step * (q[i // PARTS] + inflow[i] - 0.022 * h) / 0.9
    level += 0.002 * rng.standard_normal(N)
    return casid.Record({"q": q, "level": level}, {"q": "m^3/s", "level": "m"}, Ts=TS)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_a_band_that_the_record_does_not_resolve_is_a_line(seed: int) -> None:
    """Both have three parameters, and both are charged for them."""
    found = casid.diagnose(tank(), pumped(seed), advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("periodic_disturbance", "volume")
    value = {p.name: p.value for p in cause.parameters}
    # Along the line the level resolves 1/T; its phase to a fifth of a cycle over T is enough.
    assert value["frequency"] == pytest.approx(FREQUENCY, abs=0.2 / (0.7 * N * TS))
    # The sensor's noise moves the amplitude by sd |iw A + a| sqrt(2/n) = 6e-6 m^3/s.
    assert np.hypot(value["a_cos"], value["a_sin"]) == pytest.approx(AMPLITUDE, abs=4 * 6e-6)


@functools.cache
def sea() -> tuple[Weighing, Fit, Weighted]:
    """A hull in a sea: the fit, and the model under the disturbance."""
    split = split_records([casid.Experiment(record(1), {}, "sea")], 0.3)
    weighing = Weighing(split.fitted).with_disturbances()
    fit = fit_model(hull().model, split.fitted, FitSettings(starts=1))
    return weighing, fit, weighing.weigh(hull().model, fit, rounds=1)


@pytest.mark.slow
def test_a_model_is_as_likely_as_from_where_an_extension_of_it_ended() -> None:
    """Found from too small a damping, the likelihood of a sea may end at a lower maximum."""
    weighing, _, best = sea()
    assert best.unbiased is not None
    x = best.unbiased.x.copy()
    x[best.criterion.names.index("B")] *= 0.3
    value = best.criterion.evaluate(x).value
    solution = replace(best.fit.solution, x=x, value=value)
    lower = replace(best, fit=replace(best.fit, solution=solution), unbiased=None)
    again = weighing.from_disturbance_of(lower, best)
    # Steps of the likelihood end where they promise less than 0.02 units.
    assert minus_log_likelihood(again) == pytest.approx(minus_log_likelihood(best), abs=0.1)
    assert minus_log_likelihood(again) < minus_log_likelihood(lower) - 1.0
    kept = weighing.from_disturbance_of(best, lower)
    assert minus_log_likelihood(kept) <= minus_log_likelihood(best)


@pytest.mark.slow
def test_the_likelihood_there_is_the_same_in_whatever_units_the_extension_was_fitted() -> None:
    """An extended model is fitted in units of the errors that it leaves, here a fifth of others."""
    weighing, fit, bare = sea()
    weights, once = 5.0 * fit.criterion.weights, FitSettings(starts=1)
    again = fit_model(hull().model, weighing.experiments, once, weights=weights)
    found = weighing.from_disturbance_of(bare, weighing.weigh(hull().model, again, rounds=1))
    assert minus_log_likelihood(found) == pytest.approx(minus_log_likelihood(bare), abs=0.1)


def test_where_the_model_diverges_at_what_an_extension_found_it_is_as_it_was() -> None:
    """A time constant of a fraction of a step, for which the extension alone has the steps."""
    split = split_records([casid.Experiment(leaking(2), {}, "leak")], 0.3)
    weighing = Weighing(split.fitted).with_disturbances()
    fit = fit_model(tank().model, split.fitted, FitSettings(starts=1))
    best = weighing.weigh(fit.criterion.model, fit, rounds=1)
    assert best.full.spectra
    x = best.fit.x.copy()
    x[best.criterion.names.index("a")] = 1e3
    assert not np.isfinite(best.criterion.evaluate(x).value)
    solution = replace(best.fit.solution, x=x)
    stiff = replace(best, fit=replace(best.fit, solution=solution), unbiased=None)
    assert weighing.from_disturbance_of(best, stiff) is best
