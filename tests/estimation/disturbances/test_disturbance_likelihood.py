"""Parameters that are likeliest under a force which the model itself passes on to its outputs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter, lsim

import casid
from casid.arrays import Array
from casid.diagnosis.evidence.whitening.prewhitening import Weighing, use_samples_of
from casid.diagnosis.evidence.whitening.weighted_model import minus_log_likelihood
from casid.errors import SolveError
from casid.estimation.disturbances.disturbance_likelihood import (
    DisturbanceLikelihood,
    errors,
    likeliest,
)
from casid.estimation.noise.whittle_scoring import LONGEST, At, step
from casid.estimation.simulation.fit import FitSettings, fit_model

TS, N, PARTS = 0.5, 600, 10
B, C, K = 0.06, 0.36, -0.02
SD = 1e-3


def rolling(lower: float = 0.0) -> casid.Problem:
    m = casid.Model("rolling")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    delta = m.input("delta", "rad", known=True)
    b = m.parameter("B", "1/s", start=0.05, lower=lower, upper=1.0)
    c = m.parameter("C", "1/s^2", start=0.3, lower=0.01, upper=5.0)
    k = m.parameter("K", "1/s^2", start=-0.03, lower=-1.0, upper=1.0)
    m.derivative(phi, p)
    m.balance(p, "torque", inertia=1, terms=[-b * p, -c * phi, k * delta], unit="rad/s^2")
    m.output("roll", phi, "rad")
    m.output("gyro", p, "rad/s")
    return casid.Problem("rolling", m)


def record(seed: int, height: float) -> casid.Record:
    """(s^2 + B s + C) phi = K delta + w, exactly between points a tenth of a sample apart."""
    rng, step = np.random.default_rng(seed), TS / PARTS
    t = step * np.arange(PARTS * (N - 1) + 1)
    delta = np.repeat(rng.choice([-0.3, 0.0, 0.3], N // 20 + 1), 20)[:N]
    fine = np.interp(t, TS * np.arange(N), delta)
    # A sea of order two about 0.7 rad/s, in its steady state.
    r = np.exp(-0.12 * step)
    a = [1.0, -2 * r * np.cos(0.7 * step), r * r]
    w = lfilter([1.0], a, rng.standard_normal(len(t) + 4000))[4000:]
    force = K * fine + height * w / np.std(w)
    A = np.array([[0.0, 1.0], [-C, -B]])
    _, y, _ = lsim((A, [[0.0], [1.0]], np.eye(2), np.zeros((2, 1))), force, t, X0=[0.02, 0.0])
    y = y[::PARTS] + SD * rng.standard_normal((N, 2))
    units = {"delta": "rad", "roll": "rad", "gyro": "rad/s"}
    return casid.Record({"delta": delta, "roll": y[:, 0], "gyro": y[:, 1]}, units, Ts=TS)


def weighed(seed: int, height: float):
    """The simulation-error fit to a record, and the noise found there."""
    problem = rolling()
    experiments = [casid.Experiment(record(seed, height))]
    fit = fit_model(problem.model, experiments, FitSettings(starts=1), throw=False)
    weighing = Weighing(experiments).with_disturbances()
    return problem, weighing, fit, weighing.estimated(fit)


def test_the_gradient_is_that_of_the_likelihood() -> None:
    """Central differences, in units of the root of the information: to 1e-3 of one."""
    _, _, fit, at = weighed(1, 3e-3)
    search = DisturbanceLikelihood(fit.criterion, at.full, {}, [None])
    z = np.concatenate([fit.x, search.start])
    z[fit.criterion.names.index("B")] = 0.08
    here = search.at(z)
    size = np.sqrt(np.diag(here.information))
    found: list[float] = []
    for k in range(len(z)):
        h = 1e-3 / size[k] * np.eye(len(z))[k]
        found.append((search.at(z + h).value - search.at(z - h).value) / 2e-3)
    assert np.abs(np.array(found) - here.gradient / size).max() < 1e-3 * max(
        1.0, float(np.abs(found).max())
    )


def test_a_point_at_which_the_spectrum_is_singular_is_no_point_of_it() -> None:
    """The search takes a shorter step from it, as from where the simulation diverges."""
    _, _, fit, at = weighed(1, 3e-3)
    search = DisturbanceLikelihood(fit.criterion, at.full, {}, [None])
    z = np.concatenate([fit.x, search.start])
    assert np.isfinite(search.at(z).value)
    z[len(fit.x) :] = -1e4  # logarithms of variances that are zero then
    assert search.at(z).value == np.inf


def test_a_point_beside_which_the_responses_overflow_is_no_point_of_it(monkeypatch) -> None:
    """Its slopes are no numbers, and no step leads on from there: the start is kept."""
    _, _, fit, at = weighed(2, 2e-3)
    search = DisturbanceLikelihood(fit.criterion, at.full, {}, [None])
    z = np.concatenate([fit.x, search.start])
    assert np.isfinite(search.at(z).value)
    own = DisturbanceLikelihood._response

    def overflows(self, x, e, omega, *, states=None, is_beside=False):
        found = own(self, x, e, omega)
        assert found.gain is not None
        gain = np.full_like(found.gain, np.nan if is_beside else 1.0)
        return dataclasses.replace(found, gain=gain)

    monkeypatch.setattr(DisturbanceLikelihood, "_response", overflows)
    assert search.at(z).value == np.inf
    assert np.array_equal(likeliest(fit.criterion, fit.x, at.full), fit.x)


def test_a_variance_of_next_to_nothing_holds_nothing_else_back() -> None:
    """The information on its logarithm is all but zero, and its own step would be long.

    The others, here of information 1 each, go where they are likeliest by themselves.
    """
    _, _, fit, at = weighed(1, 3e-3)
    search = DisturbanceLikelihood(fit.criterion, at.full, {}, [None])
    z = np.concatenate([fit.x, search.start])
    wanted = np.full(len(z), 1e-4)
    wanted[len(fit.x)] = 1e5 * LONGEST
    information = np.eye(len(z))
    information[len(fit.x), len(fit.x)] = 1e-9
    at = At(0.0, -information @ wanted, information)
    found = step(z, at, 0.0, search.lower, search.upper)
    wanted[len(fit.x)] = LONGEST
    assert found == pytest.approx(wanted, rel=1e-9)


def estimated(seeds: range, height: float) -> tuple[Array, Array]:
    """(n, 2) of B and C as simulation errors estimate them, and as the likelihood does."""
    simulated, found = [], []
    for seed in seeds:
        _, _, fit, at = weighed(seed, height)
        x = likeliest(fit.criterion, fit.x, at.full)
        places = [fit.criterion.names.index(n) for n in ("B", "C")]
        simulated.append(fit.x[places] - [B, C])
        found.append(x[places] - [B, C])
    return np.array(simulated), np.array(found)


@pytest.mark.slow
def test_a_sea_is_taken_for_what_determines_the_roll() -> None:
    """A resonance of width B under a force known but for its spectrum: over T seconds

    var(B) is about 2 B / T at best, 0.02^2 here (autoregressive process of order two in continuous
    time), and the spectrum of the force, of the same order two, costs a factor of up to four.
    """
    simulated, found = estimated(range(10), 3e-3)
    spread = np.sqrt(2 * B / (N * TS))
    assert np.sqrt(np.mean(found[:, 0] ** 2)) < 2 * spread
    assert np.mean(found**2) < 0.5 * np.mean(simulated**2)


@pytest.mark.parametrize("seed", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_the_model_is_likelier_than_where_the_simulation_errs_least(seed: int) -> None:
    problem, weighing, fit, at = weighed(seed, 3e-3)
    found = weighing.weigh(problem.model, fit)
    assert found.unbiased is not None
    assert 0.0 < found.unbiased.values["B"] < 0.2
    assert "torque" in found.full.spectra
    least = weighing._whitened(problem.model, at)
    assert minus_log_likelihood(found) < minus_log_likelihood(least)


def test_without_a_sea_the_estimate_hardly_moves() -> None:
    """Both estimates are those of white noise; the taper leaves half of the information.

    So they differ by less than twice the standard error, of which three are allowed.
    """
    _, _, fit, at = weighed(1, 0.0)
    x = likeliest(fit.criterion, fit.x, at.full)
    assert np.all(np.abs(x - fit.x) < 3 * errors(fit.criterion, x, at.full))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_few_missing_samples_move_the_estimate_by_little_of_its_error(seed: int) -> None:
    """Of a process that is far slower than its samples their neighbours tell nearly all.

    Each of the two searches ends within sqrt(2 0.02) = 0.2 standard errors of its minimum.
    """
    problem, weighing, fit, at = weighed(seed, 3e-3)
    whole = likeliest(fit.criterion, fit.x, at.full)
    error = errors(fit.criterion, whole, at.full)
    holes = np.random.default_rng(seed).random(N) < 0.03
    gapped = record(seed, 3e-3).mark_missing("gyro", holes)
    weighing = Weighing([casid.Experiment(gapped)]).with_disturbances()
    again = fit_model(problem.model, weighing.experiments, FitSettings(starts=1), throw=False)
    at = weighing.estimated(again)
    found = likeliest(again.criterion, again.x, at.full)
    places = [fit.criterion.names.index(n) for n in ("B", "C", "K")]
    assert np.all(np.abs(found - whole)[places] < 0.5 * error[places])


def test_a_record_that_misses_most_samples_stays_as_it_is() -> None:
    _, _, fit, at = weighed(1, 0.0)
    fit.criterion.data[0].used[:] = np.arange(N)[:, None] % 3 == 0
    assert likeliest(fit.criterion, fit.x, at.full) is fit.x


def left_out(samples: int):
    """A fit of which the first samples are left out, as of a late input, and one that has all."""
    out = []
    for count in (samples, 0):
        problem, weighing, fit, _ = weighed(1, 3e-3)
        for d in fit.criterion.data:
            d.used[:count] = False
        fit.criterion.simulated(fit.x + 1e-9, 0)  # it keeps the residuals of its last simulation
        out.append((problem, weighing, fit))
    return out


def test_first_samples_that_are_left_out_do_not_keep_parameters_from_the_likeliest() -> None:
    """Six of 600 move none by its error: of the peak at 0.7 rad/s, 6 of 500 lines are others."""
    (_, _, some), (_, weighing, all_) = left_out(6)
    noise = weighing.estimated(all_).full
    found = [likeliest(each.criterion, all_.x, noise) for each in (some, all_)]
    sd = errors(all_.criterion, found[1], noise)
    places = [all_.criterion.names.index(n) for n in "BCK"]
    moved, apart = ((found[0] - x)[places] / sd[places] for x in (all_.x, found[1]))
    assert np.abs(moved).max() > 2.0
    assert np.abs(apart).max() < 1.0


def test_a_model_is_no_less_likely_for_samples_that_it_leaves_out() -> None:
    """Of n values with noise known the sum of squares, halved, has the variance n / 2."""
    (_, weighing, some), (_, _, all_) = left_out(6)
    at, whole = weighing.estimated(some), weighing.estimated(all_)
    x = all_.x
    values = []
    for each in (at, whole):
        noise = dataclasses.replace(whole.full, used=at.full.used if each is at else ())
        c = weighing.criterion(each.model, noise, all_.values, each.criterion)
        use_samples_of(c, each.criterion)
        value = c.evaluate(x).value
        fit = dataclasses.replace(
            all_, criterion=c, solution=dataclasses.replace(all_.solution, value=value, x=x)
        )
        values.append(dataclasses.replace(each, fit=fit, noise=noise, unbiased=None))
    kept, complete = values
    counted = complete.criterion
    assert minus_log_likelihood(kept) - minus_log_likelihood(complete) > 40.0
    gap = minus_log_likelihood(kept, counted) - minus_log_likelihood(complete, counted)
    assert abs(gap) < 4 * np.sqrt(12 / 2)


def test_a_point_at_which_the_response_diverges_is_none_of_the_search(monkeypatch) -> None:
    """A trial step there is shortened; it does not end the search."""
    _, _, fit, at = weighed(1, 3e-3)
    search = DisturbanceLikelihood(fit.criterion, at.full, {}, [None])
    z = np.concatenate([fit.x, search.start])

    def diverges(*_, **__):
        raise SolveError("the response to noise overflows")

    monkeypatch.setattr(search, "_response", diverges)
    assert search.at(z).value == np.inf
