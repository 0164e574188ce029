"""Noise on a measured input biases least squares; the equations with its covariances do not.

The truth is a difference equation of its own: v' = -a v + b u, with u a line between samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest

import casid
from analysis.coverage.systems import rig_model, rig_motion
from casid.estimation.errors_in_variables import removal
from casid.estimation.errors_in_variables.equations import columns_of, equations, flat_noise
from casid.estimation.errors_in_variables.input_noise import input_noise
from casid.estimation.errors_in_variables.removal import Corrected, without_input_noise
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.simulation_error import SimulationError
from tests.support import ventilated_room

A, B, TS = 2.0, 3.0, 0.05
INPUT, OUTPUT = 0.5, 0.02
ONE_START = FitSettings(starts=1)

RECORDS = 20
OF_MEAN, OF_VARIANCE = 0.22, 0.32  # standard deviations of mean and variance of so many N(0, 1)


def slow_input(N: int, rng: np.random.Generator) -> np.ndarray:
    """Unit variance, hardly any power above a tenth of the band."""
    u = np.convolve(rng.standard_normal(N + 60), np.hanning(60), "same")[30:-30]
    return u / np.std(u)


def response(u: np.ndarray, a: float = A, b: float = B) -> np.ndarray:
    """v from rest: exact for straight lines between the samples."""
    pole = np.exp(-a * TS)
    whole = (1 - pole) / a
    later = (TS - whole) / (a * TS)  # weight of the sample at the end
    v = np.zeros(len(u))
    for k in range(len(u) - 1):
        v[k + 1] = pole * v[k] + b * ((whole - later) * u[k] + later * u[k + 1])
    return v


def model(known: bool = False, stable: bool = True) -> casid.Model:
    m = casid.Model("first order")
    v = m.state("v", "m/s")
    u = m.input("u", "m/s^2", known=known)
    a = m.parameter("a", "1/s", start=1.5, lower=0.0 if stable else -np.inf)
    b = m.parameter("b", "", start=2.5)
    m.derivative(v, -a * v + b * u)
    m.output("v", v, "m/s")
    return m


def record(
    seed: int, *, N: int = 1500, input_sd: float = INPUT, cubic: float = 0.0
) -> casid.Record:
    rng = np.random.default_rng(seed)
    u = slow_input(N, rng)
    y = response(u) + OUTPUT * rng.standard_normal(N)
    y += cubic * y**3
    measured = u + input_sd * rng.standard_normal(N)
    return casid.Record({"u": measured, "v": y}, {"u": "m/s^2", "v": "m/s"}, Ts=TS)


@cache
def fitted(seed: int, **given: float):
    return fit_model(model(), [casid.Experiment(record(seed, **given), {}, "r")], ONE_START)


def test_simulated_noise_has_the_same_power_at_every_frequency() -> None:
    for n in (100, 101):
        w = flat_noise(n, np.random.default_rng(1))
        assert np.abs(np.fft.rfft(w)) ** 2 / n == pytest.approx(1.0)


def test_the_equations_are_the_slope_of_the_likelihood_of_errors_in_variables() -> None:
    """The slope of -1/2 sum |r|^2 / S(theta), S with the theta of the simulation, linear model."""
    data = [casid.Experiment(record(3), {}, "r")]
    fit = fit_model(model(stable=False), data, ONE_START)
    c, x = fit.criterion, fit.x + np.array([0.05, -0.05, 0.0])
    noise = estimate_noise(c, x)
    sd = {"u": noise.source_sd["u"]}
    score = equations(columns_of(c, x, sd), noise, sd).score

    def value(at: np.ndarray) -> float:
        same = estimate_noise(c, at, known={"u": sd["u"], "v": float(noise.output_sd[0])})
        residual = c.simulated(at, 0).residual * c.weights
        return -0.5 * float(np.sum(same.whiten(residual[:, :, None], 0) ** 2))

    for i, step in ((0, 1e-4), (1, 1e-4)):
        moved = step * np.eye(len(x))[i]
        slope = (value(x + moved) - value(x - moved)) / (2 * step)
        # What differs is leakage at the ends of the record: of order a / (N Ts) of the terms.
        assert score[i] == pytest.approx(slope, rel=0.03)


@pytest.mark.slow
def test_estimates_with_a_noisy_input_scatter_about_the_truth_as_their_errors_say() -> None:
    """20 records: least squares is wrong by several standard errors, the estimate by none."""
    truth, z, plain = np.array([A, B]), [], []
    for seed in range(RECORDS):
        fit = fitted(seed)
        found = without_input_noise(fit, {})
        assert found.covariance is not None
        z.append((found.fit.x[:2] - truth) / np.sqrt(np.diag(found.covariance)[:2]))
        plain.append(fit.x[:2] - truth)
    z, plain = np.array(z), np.array(plain)
    bias = np.abs(plain.mean(axis=0)) / plain.std(axis=0)
    assert bias.max() > 1.0
    assert np.all(np.abs(z.mean(axis=0)) < 3 * OF_MEAN)
    assert np.all(np.abs(z.var(axis=0) - 1.0) < 3 * OF_VARIANCE)
    covered = np.mean(np.abs(z) < 1.96)  # of 40: sd of a share of 95 % is 3.4 % at least
    assert covered > 0.95 - 3 * 0.034


@pytest.mark.slow
def test_missing_samples_of_an_output_leave_the_equations_without_bias() -> None:
    """20 records that miss a quarter of the output, a long gap among it: as for complete ones."""
    truth, z, plain, wider = np.array([A, B]), [], [], []
    for seed in range(RECORDS):
        r = record(seed)
        missing = np.random.default_rng((seed, 1)).random(r.N) < 0.2
        missing[600:700] = True
        gappy = casid.Experiment(replace(r, missing={"v": missing}), {}, "r")
        fit = fit_model(model(), [gappy], ONE_START)
        found = without_input_noise(fit, {})
        assert found.covariance is not None
        error = np.sqrt(np.diag(found.covariance)[:2])
        z.append((found.fit.x[:2] - truth) / error)
        plain.append(fit.x[:2] - truth)
        if seed < 5:
            whole = without_input_noise(fitted(seed), {})
            assert whole.covariance is not None
            wider.append(error / np.sqrt(np.diag(whole.covariance)[:2]))
    z, plain = np.array(z), np.array(plain)
    assert (np.abs(plain.mean(axis=0)) / plain.std(axis=0)).max() > 1.0
    assert np.all(np.abs(z.mean(axis=0)) < 3 * OF_MEAN)
    assert np.all(np.abs(z.var(axis=0) - 1.0) < 3 * OF_VARIANCE)
    # Of the information a share of at most 1 - 0.2533 is left; what a gap hides of noise that the
    # system remembers its neighbours show in part.
    ratio = np.mean(wider, axis=0)
    assert np.all(ratio > 1.0)
    assert np.all(ratio < 1.2 / np.sqrt(1 - 0.2533))


def test_a_negligible_bias_that_is_not_removed_is_no_reason_to_warn() -> None:
    fit = fitted(1)
    found = Corrected(fit, input_sd={"u": 0.1}, bias={"a": 1e-5}, why_not="there is no root")
    assert found.noisy == ()
    assert "moves no unknown by more than 0.1 standard errors" in found.text
    assert found.text.endswith("is not counted, since there is no root")
    larger = replace(found, bias={"a": 0.5})
    assert larger.noisy == ("u",)
    assert "may bias a by up to 0.5 times its standard error" in larger.text


def test_a_stated_noise_is_used_and_one_that_is_stated_as_zero_is_not_sought() -> None:
    fit = fitted(1)
    found = without_input_noise(fit, {"u": INPUT})
    assert found.input_sd == {"u": pytest.approx(INPUT)}
    none = without_input_noise(fit, {"u": 0.0})
    assert none.fit is fit
    assert none.covariance is None
    assert none.text == ""


def test_an_input_that_is_declared_known_is_taken_as_it_is() -> None:
    experiment = casid.Experiment(record(1), {}, "r")
    estimate = casid.identify(casid.Problem("p", model(known=True)), experiment)
    least = fit_model(model(known=True), [experiment], FitSettings())
    assert estimate.method == "simulation error, single shooting"
    assert estimate["a"] == pytest.approx(least.values["a"], rel=1e-9)
    assert "noise on inputs" not in estimate.evidence
    # It has noise all the same, and the warning of feedback says that this may be so.
    assert any("or where an input has noise" in w for w in estimate.warnings)


def test_an_input_without_noise_leaves_least_squares_as_it_is() -> None:
    """The channel's own floor bounds its noise: so little moves nothing."""
    fit = fitted(1, input_sd=1e-4)
    found = without_input_noise(fit, {})
    assert found.fit is fit
    assert not found.is_removed
    assert not found.why_not
    assert found.text == "noise on inputs moves no unknown by more than 0.1 standard errors"


def test_the_noise_is_bounded_by_the_floor_of_the_channel() -> None:
    """A residual that is misfit shows more than the input can have."""
    fit = fitted(1, cubic=0.2)
    found = input_noise(fit.criterion, fit.x, {})
    assert found.noise.source_sd["u"] > 1.3 * INPUT
    assert found.bounded == ("u",)
    # 1500 samples: sd of a floor of 5.5 %.
    assert found.sd["u"] == pytest.approx(INPUT, rel=3 * 0.055)
    assert found.most["u"] >= found.sd["u"]


def test_what_the_residual_shows_is_used_where_the_floor_does_not_contradict_it() -> None:
    """It is the more exact: 1.3 % of a standard deviation against 5.5 %."""
    shown = []
    for seed in range(12):
        fit = fitted(seed)
        found = input_noise(fit.criterion, fit.x, {})
        assert found.bounded == ()
        assert found.sd["u"] == pytest.approx(found.noise.source_sd["u"])
        shown.append(found.sd["u"])
    assert np.mean(shown) == pytest.approx(INPUT, rel=3 * 0.013 / np.sqrt(12) + 0.01)
    error = found.noise.variance_error("u") / (2 * INPUT)
    assert np.std(shown) == pytest.approx(error, rel=3 / np.sqrt(2 * 11))


def test_the_floor_is_used_where_the_residual_cannot_tell_and_agrees() -> None:
    """A tenth of the sensor's noise in the residual: its size is seen by the channel itself."""
    quiet = INPUT / 30
    at_floor = []
    for seed in range(8):
        fit = fitted(seed, input_sd=quiet)
        found = input_noise(fit.criterion, fit.x, {})
        at_floor.append("u" in found.at_floor)
        if at_floor[-1]:
            assert found.sd["u"] == pytest.approx(quiet, rel=3 * 0.055)
    assert np.mean(at_floor) >= 0.75  # they agree at a level of 95 %


def test_what_an_output_feels_at_once_is_told_from_its_own_noise_by_the_floor() -> None:
    """v = R u + a slow state: the residual shows the sum of both, in lines all alike."""
    m = casid.Model("cell")
    x, u = m.state("x", "V"), m.input("u", "A", hold="zoh")
    R = m.parameter("R", "ohm", start=0.03, lower=0.0)
    a = m.parameter("a", "1/s", start=0.1, lower=1e-3)
    b = m.parameter("b", "V/(A*s)", start=0.002)
    m.derivative(x, -a * x + b * u)
    m.output("v", R * u + x, "V")
    own, quiet = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.choice([-1.5, 0.0, 1.0, 2.5], 60), 50)
        slow = np.zeros(3000)
        for k in range(2999):
            slow[k + 1] = np.exp(-0.05) * slow[k] + 0.02 * (1 - np.exp(-0.05)) * u[k]
        columns = {"v": 0.045 * u + slow + 0.8e-3 * rng.standard_normal(3000)}
        columns["u"] = u + 0.05 * rng.standard_normal(3000)
        data = casid.Record(columns, {"u": "A", "v": "V"}, Ts=1.0)
        fit = fit_model(m, [casid.Experiment(data, {}, "r")], ONE_START)
        found = input_noise(fit.criterion, fit.x, {})
        assert found.agree == ("u",)
        own.append(found.sd["u"])
        quiet.append(found.noise.output_sd[0])
    # 3000 samples, seen through third differences: a standard error of 2.4 % each, and what steps
    # leave in it. The sum has one of 1.3 %, so that its rest, an eighth, has one of 18 %.
    assert own == pytest.approx([0.05] * 6, rel=3 * 0.024 + 0.015)
    assert np.mean(own) == pytest.approx(0.05, rel=3 * 0.024 / np.sqrt(6) + 0.015)
    assert np.mean(quiet) == pytest.approx(0.8e-3, rel=3 * 0.18 / np.sqrt(6) + 0.11)


@pytest.mark.slow
def test_noise_that_biases_little_still_counts_in_the_errors() -> None:
    """An input that moves slow states: noise next to nothing in the residual, all of it slow."""
    m = casid.Model("slow")
    T, u = m.state("T", "K"), m.input("u", "K")
    R = m.parameter("R", "s", start=80.0, lower=1.0)
    m.derivative(T, (u - T) / R)
    m.output("T", T, "K")
    z = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        t = np.arange(2000.0)
        u = 4 * np.sin(2 * np.pi * t / 144) + 3 * np.sin(2 * np.pi * t / 1000)
        y = np.zeros(2000)
        pole = np.exp(-1 / 100.0)
        later = 1 - 100 * (1 - pole)
        for k in range(1999):
            y[k + 1] = pole * y[k] + (1 - pole - later) * u[k] + later * u[k + 1]
        columns = {"u": u + 0.5 * rng.standard_normal(2000)}
        columns["T"] = y + 0.05 * rng.standard_normal(2000)
        record = casid.Record(columns, {"u": "K", "T": "K"}, Ts=1.0)
        fit = fit_model(m, [casid.Experiment(record, {}, "r")], ONE_START)
        found = without_input_noise(fit, {})
        assert found.covariance is not None
        z.append((found.fit.values["R"] - 100.0) / np.sqrt(found.covariance[0, 0]))
    assert np.var(z) < 1 + 3 * np.sqrt(2 / 29)
    assert abs(np.mean(z)) < 3 / np.sqrt(30)


def test_a_force_elsewhere_gets_no_part_of_the_noise_without_evidence() -> None:
    """Two balances, noise on the force in one: both move the same resonance."""
    system = rig_model()
    motion = rig_motion()
    shares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        columns = {"F": motion.inputs["F"] + 0.3 * rng.standard_normal(3000)}
        for name, values in motion.outputs.items():
            columns[name] = values + 0.002 * rng.standard_normal(3000)
        record = casid.Record(columns, {"F": "N", "x": "m", "X": "m"}, Ts=motion.Ts)
        fit = fit_model(system, [casid.Experiment(record, {}, "r")], ONE_START)
        found = input_noise(fit.criterion, fit.x, {})
        shares.append(found.noise.source_sd["second"])
        # An error of 4 % at the floor, of 10 % by one resonance in two outputs.
        assert found.sd["F"] == pytest.approx(0.3, rel=4 * (0.04 if found.at_floor else 0.1))
    assert shares == [0.0] * 6


def test_misfit_is_not_taken_for_noise_of_the_input() -> None:
    """The residual is more than sensors and inputs: least squares stays, and the result says so."""
    problem = casid.Problem("p", model())
    estimate = casid.identify(problem, casid.Experiment(record(2, cubic=0.2), {}, "r"))
    assert estimate.method == "simulation error, single shooting"
    assert "not removed" in estimate.evidence["noise on inputs"]
    assert any("not removed" in w for w in estimate.warnings)
    assert "is not included" in estimate.assumes


def test_the_result_says_that_the_bias_was_removed_and_how_large_it_was() -> None:
    experiment = casid.Experiment(record(1), {}, "r")
    estimate = casid.identify(casid.Problem("p", model()), experiment)
    assert estimate.method.endswith("without the bias of input noise")
    assert "biases least squares" in estimate.evidence["noise on inputs"]
    assert "bias of the inputs' noise is removed" in estimate.assumes
    assert estimate.to_json()["evidence"] == dict(estimate.evidence)
    assert "of 20 lags" in estimate.whiteness["v"]
    assert "incomplete" not in estimate.whiteness["v"]  # of the residual without its colour


def test_the_errors_contain_those_of_the_sizes_of_the_noise() -> None:
    """A stated noise is exact: where it is found, the covariance is no smaller."""
    fit = fitted(4)
    found = without_input_noise(fit, {})
    assert found.covariance is not None
    assert found.input_sd is not None
    sizes = estimate_noise(fit.criterion, found.fit.x)
    known = {**found.input_sd, "v": float(sizes.output_sd[0])}
    stated = without_input_noise(fit, known)
    assert stated.covariance is not None
    assert stated.fit.x == pytest.approx(found.fit.x, rel=1e-2)
    wider = np.diag(found.covariance)[:2] / np.diag(stated.covariance)[:2]
    # Of 100 records estimates scatter by 0.072 where the sizes are found, by 0.069 where stated.
    assert np.all(wider > 1.0)
    assert np.all(wider < 1.3)


@pytest.mark.parametrize("sd", [0.0, 1e-13])
def test_a_variance_that_a_solver_leaves_of_zero_adds_nothing_to_the_errors(sd) -> None:
    """A change of rounding over a variance of 1e-26 was a derivative: errors a hundredfold."""
    fit = fitted(4)
    at = input_noise(fit.criterion, fit.x, {})
    root = removal._Root(fit, {}, fit.solution.is_free, at, 0)
    none = replace(root.found, noise=replace(root.found.noise, source_sd={"u": sd}))
    assert none.noise.variance_error("u") > 1e-3
    root.found = none
    root._evaluate()
    assert np.all(root._slope_by_variance("source", "u") == 0.0)
    root.found = replace(none, noise=replace(none.noise, source_sd={"u": 0.3}))
    root._evaluate()
    assert np.any(root._slope_by_variance("source", "u") != 0.0)


def test_a_root_whose_inputs_have_no_noise_names_none() -> None:
    bias = {"a": 0.02}
    at = Corrected(fitted(4), covariance=np.eye(3), input_sd={"u": 0.0}, bias=bias)
    assert at.text == "noise on inputs moves no unknown by more than 0.1 standard errors"


def test_a_covariance_is_that_of_least_squares_where_nothing_is_noisy() -> None:
    """Without noise on inputs the slope and the variance of the equations are T'T."""
    c = SimulationError(model(), [casid.Experiment(record(5, input_sd=0.0), {}, "r")])
    noise = estimate_noise(c, c.start, known={"u": 0.0})
    at = equations(columns_of(c, c.start, {"u": 0.0}), noise, {})
    assert np.array_equal(at.slope, at.matrix)
    assert np.array_equal(at.variance, at.matrix)


GRAVITY = 9.81


def beam_model() -> casid.Model:
    m = casid.Model("ball on a beam")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    u = m.input("u", "rad")
    k = m.parameter("k", "1", start=0.5, lower=-5.0, upper=5.0)
    b = m.parameter("b", "m/s^2", start=0.0, lower=-0.5, upper=0.5)
    m.derivative(x, v)
    m.derivative(v, k * GRAVITY * u + b)
    m.output("y", x, "m")
    return m


def beam_record(seed: int, stiffness: float, input_sd: float) -> casid.Record:
    """A ball under control, x'' = g u / 2 + 0.004 + stiffness x, in steps of 5 ms: k = 0.5."""
    rng, N, Ts, fine = np.random.default_rng(seed), 181, 0.1, 20
    wanted = 0.04 * np.repeat(rng.choice([-1, 1], N // 30 + 1), 30)[:N]
    x = v = u = 0.0
    angle, place = [], []
    for goal in wanted:
        angle.append(u)
        place.append(x)
        command = np.clip(0.12 * (goal - x) - 0.12 * v, -0.018, 0.018)
        new = u + 0.5 * (command - u)
        for j in range(fine):
            between = u + (new - u) * (j + 0.5) / fine
            v += (0.5 * GRAVITY * between + 0.004 + stiffness * x) * Ts / fine
            x += v * Ts / fine
        u = new
    columns = {"u": np.array(angle) + input_sd * rng.standard_normal(N)}
    columns["y"] = np.array(place) + 3e-4 * rng.standard_normal(N)
    return casid.Record(columns, {"u": "rad", "y": "m"}, Ts=Ts)


def beam_fit(*given: float):
    return fit_model(beam_model(), [casid.Experiment(beam_record(*given), {}, "r")], ONE_START)


def error_at(found: Corrected) -> float:
    residual = found.fit.criterion.simulated(found.fit.x, 0).residual
    return float(np.sqrt(np.mean(residual**2)))


@pytest.mark.parametrize(("seed", "stiffness"), [(2, 0.1), (5, 0.1), (3, -0.3)])
def test_no_input_has_more_noise_than_its_own_spectrum_behind_integrators_too(seed, stiffness):
    """The misfit of a drifting model lies in few lines: a variance that it shows has a wide error.

    That error is no reason to think the channel noisier than its own spectrum near Nyquist is.
    """
    fit = beam_fit(seed, stiffness, 2e-4)
    at = input_noise(fit.criterion, fit.x, {})
    above = 1 + 3 * np.sqrt(2) * at.errors["u"] / at.floors["u"]
    assert at.sd["u"] ** 2 <= above * at.floors["u"]
    assert at.most["u"] < np.std(fit.criterion.data[0].u[:, 0]) / 3
    found = without_input_noise(fit, {})
    assert not found.is_removed
    assert found.fit is fit
    assert "it is not removed, since" in found.text


@pytest.mark.slow
def test_the_noise_at_the_start_of_the_search_is_that_which_least_squares_leaves():
    """Nothing is missing. Taken for the residual of a weighted fit, that of least squares shows no
    noise of the input: least squares would be called free of bias, and its error far too small.

    Behind two integrators few lines show the noise, and some records show too little: two of these
    estimates are 3.7 and 5.6 standard errors off. The middle of all is judged; of normal ones the
    median of |z| is 0.67, of nine it scatters by 0.26.
    """
    z, sizes = [], []
    for seed in range(12):
        found = without_input_noise(beam_fit(seed, 0.0, 2e-4), {})
        if found.covariance is not None:
            assert found.input_sd is not None
            sizes.append(found.input_sd["u"])
            z.append((found.fit.x[0] - 0.5) / np.sqrt(found.covariance[0, 0]))
    assert len(z) >= 8
    assert min(sizes) > 1e-5
    assert np.median(sizes) == pytest.approx(2e-4, rel=0.5)
    assert 0.1 < np.median(np.abs(z)) < 0.67 + 3 * 0.26


def test_an_integrator_may_simulate_worse_at_the_root_as_far_as_its_noise_explains():
    """Nothing is missing: least squares follows the drift of the noise, the root does not."""
    fit = beam_fit(11, 0.0, 1e-3)
    found = without_input_noise(fit, {})
    assert found.covariance is not None
    assert error_at(found) > 5 * error_at(Corrected(fit))
    assert abs(found.fit.x[0] - 0.5) < 3 * np.sqrt(found.covariance[0, 0])


def test_a_root_that_simulates_worse_is_not_taken_where_least_squares_leaves_more_than_noise():
    """A spring that the model lacks: misfit is no noise, whatever the spectra of few lines say."""
    fit = beam_fit(4, 0.05, 2e-4)
    found = without_input_noise(fit, {})
    assert found.fit is fit
    assert "not removed, since that raises the error" in found.text
    assert "the model is incomplete" in found.text


def test_a_root_that_simulates_worse_is_not_taken_where_least_squares_leaves_less_than_noise():
    """A noise is stated that is 25 times what there is: least squares would be left with more."""
    fit = beam_fit(2, 0.0, 2e-4)
    found = without_input_noise(fit, {"u": 5e-3})
    assert found.fit is fit
    assert found.text.endswith("the inputs have less noise than that")


def test_a_step_to_where_the_simulation_overflows_ends_the_search(monkeypatch) -> None:
    """A pole of 1000 per second is e^1000 after one: least squares is kept, and it is said."""
    data = [casid.Experiment(record(3), {}, "r")]
    fit = fit_model(model(stable=False), data, ONE_START)
    least_squares = dict(fit.values)

    def away(at, free, least):
        return np.where(np.array(fit.criterion.names) == "a", -1e3, 0.0), 1.0, 1.0

    monkeypatch.setattr(removal, "step", away)
    monkeypatch.setattr(removal, "REMOVAL", replace(removal.REMOVAL, longest_step=1.0))
    found = without_input_noise(fit, {})
    assert "overflows" in found.why_not
    assert found.fit.values == least_squares


def errors_of(
    models: Callable[[], casid.Model],
    record_of: Callable[[int], casid.Record],
    truth: Mapping[str, float],
    records: int,
) -> np.ndarray:
    """(records, parameters) what the estimates err by, in their standard errors."""
    z = []
    for seed in range(records):
        fit = fit_model(models(), [casid.Experiment(record_of(seed), {}, "r")], ONE_START)
        found = without_input_noise(fit, {})
        assert found.covariance is not None
        sd = dict(zip(fit.criterion.names, np.sqrt(np.diag(found.covariance)), strict=True))
        z.append([(found.fit.values[n] - true) / sd[n] for n, true in truth.items()])
    return np.array(z)


@pytest.mark.parametrize("records", [8, pytest.param(60, marks=pytest.mark.slow)])
def test_errors_are_those_of_noise_that_is_multiplied(records: int) -> None:
    """Its power goes with the state: by an average response the leak had a third of its error."""
    truth = {"each": ventilated_room.EACH, "leak": ventilated_room.LEAK}
    z = errors_of(ventilated_room.model, ventilated_room.record, truth, records)
    assert np.all(np.abs(np.mean(z, axis=0)) < 3 / np.sqrt(records))
    assert np.all(np.mean(np.square(z), axis=0) < 1 + 3 * np.sqrt(2 / records))


def rubbing() -> casid.Model:
    """A mass on a spring, with dry friction that holds it where its noisy force rests."""
    m = casid.Model("rubbing")
    x, v, F = m.state("x", "m"), m.state("v", "m/s"), m.input("F", "N", hold="zoh")
    k, d = m.parameter("k", "N/m", start=30.0), m.parameter("d", "N s/m", start=0.5, lower=0.0)
    dry = m.parameter("F_c", "N", start=0.5, lower=0.0)
    terms = [F, -k * x, -d * v, -dry * ca.tanh(v / 0.05)]
    m.derivative(x, v)
    m.balance(v, "mass", inertia=m.constant("m", 1.0, "kg"), terms=terms, unit="N")
    m.output("x", x, "m")
    return m


def rubbed(seed: int) -> casid.Record:
    """It rests half of the time."""
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.choice([0.0, 0.0, 3.0, 6.0], 20) * rng.choice([-1, 1], 20), 150)
    y, at, speed, h = np.empty(3000), 0.0, 0.0, 1e-3
    for i in range(3000):
        y[i] = at
        for _ in range(10):
            a = force[i] - 40.0 * at - 0.8 * speed - np.tanh(speed / 0.05)
            at, speed = at + h * (speed + h / 2 * a), speed + h * a
    columns = {"x": y + 1e-3 * rng.standard_normal(3000)}
    columns["F"] = force + 0.3 * rng.standard_normal(3000)
    return casid.Record(columns, {"x": "m", "F": "N"}, Ts=0.01)


@pytest.mark.parametrize("records", [6, pytest.param(40, marks=pytest.mark.slow)])
def test_errors_are_those_of_noise_that_friction_lets_through_now_and_then(records: int) -> None:
    """It moves a mass that slides, and none that sticks: an average of both is neither."""
    z = errors_of(rubbing, rubbed, {"k": 40.0, "d": 0.8, "F_c": 1.0}, records)
    # What friction that is not linear leaves is half a standard error at most.
    assert np.all(np.abs(np.mean(z, axis=0)) < 0.5 + 3 / np.sqrt(records))
    assert np.all(np.mean(np.square(z), axis=0) < 1.25 + 3 * np.sqrt(2 / records))
