"""Variances and spectra of noise along a path: of a tank with short draws, and of a jacket."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import casid
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import multiplied_inputs
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.noise.varying_likelihood import (
    filters_along,
    is_white,
    with_likeliest_noise,
    with_spectra_along,
)
from casid.estimation.noise.varying_response import with_varying_response
from casid.estimation.noise.varying_steps import steps_along
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.simulation_error import SimulationError
from tests.support import cooled_jacket, drawn_tank
from tests.support.drawn_tank import FLOW, OUTPUT


def at_the_truth(
    seed: int, missing: Mapping[str, np.ndarray] | None = None
) -> tuple[SimulationError, np.ndarray, list[np.ndarray]]:
    """A record's criterion, the true unknowns, and the residual there."""
    record = replace(drawn_tank.record(seed), missing=missing or {})
    criterion = SimulationError(drawn_tank.model(), [casid.Experiment(record, {}, "r")])
    true = {**drawn_tank.TRUTH, "top(0)": 323.15, "bottom(0)": 308.15}
    x = np.array([true[name] for name in criterion.names])
    return criterion, x, [criterion.simulated(x, 0).residual]


def found_in(criterion: SimulationError, x: np.ndarray, **known: float) -> NoiseModel:
    return with_varying_response(estimate_noise(criterion, x, known=known), criterion, x, known)


def check(noise: NoiseModel) -> None:
    error = noise.variance_error("flow") / (2 * FLOW)
    assert 0.01 * FLOW < error < 0.05 * FLOW
    assert noise.source_sd["flow"] == pytest.approx(FLOW, abs=3 * error)
    assert max(noise.source_sd["upper"], noise.source_sd["lower"]) < 10.0  # W; the draws: 10 kW
    # What each sample shows of a sensor's noise the noise of the flow hides in part.
    assert noise.output_sd == pytest.approx([OUTPUT, OUTPUT], rel=0.35)


def test_noise_of_a_meter_is_found_where_draws_last_a_sample():
    """By the average response it is forces of hundreds of W in four of eight records."""
    for seed in range(3):
        criterion, x, residuals = at_the_truth(seed)
        noise = found_in(criterion, x)
        check(noise)
        assert is_white(noise, criterion.data, residuals)


def test_samples_that_are_missing_do_not_count():
    missing = {"T_top": np.random.default_rng(1).random(drawn_tank.SAMPLES) < 0.2}
    criterion, x, residuals = at_the_truth(1, missing)
    noise = found_in(criterion, x)
    check(noise)
    assert is_white(noise, criterion.data, residuals)


def test_a_variance_that_is_known_stays():
    criterion, x, _ = at_the_truth(2)
    noise = found_in(criterion, x, flow=1.3 * FLOW, T_top=2 * OUTPUT)
    assert noise.varying
    assert noise.source_sd["flow"] == pytest.approx(1.3 * FLOW)
    assert noise.output_sd[0] == pytest.approx(2 * OUTPUT)
    assert noise.variance_error("flow") == 0.0


def test_the_likeliest_variances_are_those_wherever_they_are_begun():
    """The likelihood falls to all sides by as much as their errors say."""
    criterion, x, residuals = at_the_truth(3)
    steps = [steps_along(criterion, x, 0)]

    def along(output: float, flow: float) -> NoiseModel:
        noise = estimate_noise(criterion, x)
        sources = {**dict.fromkeys(noise.source_sd, 0.0), "flow": flow}
        noise = replace(noise, output_sd=np.full(2, output), source_sd=sources)
        return replace(noise, varying=filters_along(noise, steps) or ())

    ends = [
        with_likeliest_noise(along(output * OUTPUT, flow * FLOW), steps, criterion, residuals)
        # Next to them, and where all are a billion times too large, as a misfit leaves them.
        for output, flow in ((0.5, 2.0), (2.0, 0.5), (3e4, 3e4))
    ]
    for end in ends[1:]:
        assert end.source_sd["flow"] == pytest.approx(ends[0].source_sd["flow"], rel=0.005)
        for i, name in enumerate(("T_top", "T_bottom")):
            key = ("output", name)
            error = ends[0].covariance[key, key] ** 0.5 / (2 * ends[0].output_sd[i])
            # It ends where a step promises 0.02 units of log-likelihood, 0.2 standard errors.
            assert end.output_sd[i] == pytest.approx(ends[0].output_sd[i], abs=0.4 * error)

    least = ends[0].minus_log_likelihood(residuals)
    sd = ends[0].source_sd["flow"]
    step = 2 * ends[0].variance_error("flow") / sd**2  # of the variance's logarithm
    for sign in (-1.0, 1.0):
        noise = replace(
            ends[0], source_sd={**ends[0].source_sd, "flow": sd * np.exp(sign * step / 2)}
        )
        beside = replace(noise, varying=filters_along(noise, steps) or ())
        fallen = beside.minus_log_likelihood(residuals) - least
        # Two standard errors: two units, and more where the others do not follow.
        assert 1.6 < fallen < 4.0


@pytest.mark.parametrize("times", [0.3, 3.0])
def test_the_spectrum_of_a_force_is_likelier_than_the_truth_by_chance_alone(times: float):
    """Twice the gain over the true noise is chi-squared, by its three parameters (Wilks)."""
    gains = []
    for seed in range(4):
        criterion, x, noise = jacket(seed)
        residuals, steps = [criterion.simulated(x, 0).residual], [steps_along(criterion, x, 0)]
        begun = replace(noise, spectra={"heat": DisturbanceSpectrum(times / cooled_jacket.MEMORY)})
        filters = filters_along(begun, steps)
        assert filters is not None
        found = with_likeliest_noise(replace(begun, varying=filters), steps, criterion, residuals)
        least = found.minus_log_likelihood(residuals)
        gains.append(2 * (noise.minus_log_likelihood(residuals) - least))
        # The average responses, which hold the shapes of the spectra, have them as well.
        before, after = (n.responses[0].gain2[:, 0, -1] for n in (begun, found))
        shapes = [
            n.spectra["heat"].at(n.responses[0].omega, cooled_jacket.TS) for n in (begun, found)
        ]
        assert np.allclose(after * shapes[0], before * shapes[1])
    assert min(gains) > -0.1  # where a step promises 0.02 units, the search ends
    assert max(gains) < chi2.isf(1e-3 / len(gains), 3)


def test_a_white_force_gets_the_spectrum_that_it_has_along_the_path():
    """By Schwarz, of one more parameter; it is as likely as the truth, up to chance (Wilks)."""
    for seed in range(3):
        criterion, x, true = jacket(seed)
        residuals, steps = [criterion.simulated(x, 0).residual], [steps_along(criterion, x, 0)]
        white = replace(true, spectra={}, source_sd={"heat": 3 * cooled_jacket.FORCE})
        white = replace(white, varying=filters_along(white, steps) or ())
        white = with_likeliest_noise(white, steps, criterion, residuals)
        found = with_spectra_along(white, steps, criterion, residuals)
        assert list(found.spectra) == ["heat"]
        gain = white.minus_log_likelihood(residuals) - found.minus_log_likelihood(residuals)
        assert gain > 0.5 * np.log(criterion.n_samples)
        beyond = true.minus_log_likelihood(residuals) - found.minus_log_likelihood(residuals)
        assert -0.1 < 2 * beyond < chi2.isf(1e-3, 3)
        # A force that has one gets no other.
        assert with_spectra_along(found, steps, criterion, residuals) is found


def test_a_force_that_is_white_stays_so():
    criterion, x, noise = jacket(0)
    steps, rng = [steps_along(criterion, x, 0)], np.random.default_rng(5)
    white = replace(noise, spectra={}, source_sd={"heat": 500.0})
    white = replace(white, varying=filters_along(white, steps) or ())
    drawn = white.varying[0].coloured(rng.standard_normal((cooled_jacket.SAMPLES, 1, 1)))
    residuals = [drawn[:, :, 0] / white.weights]
    assert with_spectra_along(white, steps, criterion, residuals) is white


def test_samples_that_a_criterion_leaves_out_are_no_measured_zeros():
    """What is left of a slow force is as likely as before; zeros in between contradict it."""
    criterion, _, noise = jacket(1)
    steps = [v.steps for v in noise.varying if v.steps is not None]
    slow = replace(noise, spectra={"heat": DisturbanceSpectrum(0.1 / cooled_jacket.MEMORY)})
    slow = replace(slow, source_sd={"heat": 30 * cooled_jacket.FORCE})
    slow = replace(slow, varying=filters_along(slow, steps) or ())
    white = np.random.default_rng(2).standard_normal((cooled_jacket.SAMPLES, 1, 1))
    columns = slow.varying[0].coloured(white)
    late = replace(criterion.data[0], used=np.arange(cooled_jacket.SAMPLES)[:, None] >= 300)
    left = columns * late.used[:, :, None]
    size = float(np.sum(slow.whitener([late])(left, 0) ** 2))
    freedom = cooled_jacket.SAMPLES - 300
    assert size == pytest.approx(freedom, abs=4 * np.sqrt(2 * freedom))
    assert float(np.sum(slow.whiten(left, 0) ** 2)) > 2 * freedom


def jacket(seed: int) -> tuple[SimulationError, np.ndarray, NoiseModel]:
    """A record's criterion, the true unknowns, and the true noise along them."""
    j = cooled_jacket
    criterion = SimulationError(j.model(), [casid.Experiment(j.record(seed), {}, "r")])
    true = {"V": j.VOLUME, "UA": j.UA, "T(0)": 310.0}
    x = np.array([true[name] for name in criterion.names])
    noise = estimate_noise(criterion, x)
    noise = replace(
        noise,
        output_sd=np.array([j.OUTPUT]),
        source_sd={**dict.fromkeys(noise.source_sd, 0.0), "heat": j.FORCE},
        spectra={"heat": DisturbanceSpectrum(1 / j.MEMORY)},
    )
    return (
        criterion,
        x,
        replace(noise, varying=filters_along(noise, [steps_along(criterion, x, 0)])),
    )


def test_an_input_that_is_added_leaves_the_slopes_alone():
    criterion, *_ = at_the_truth(0)
    assert multiplied_inputs(criterion) == ("flow",)


@pytest.mark.parametrize("missing", [[], [0], [700], [300, 1100]])
def test_the_drift_of_a_free_cart_is_no_noise_of_its_sensor_whichever_samples_are_missing(missing):
    """Metres of drift beside millimetres of noise; a lost sample leaves metres in every line.

    m v' = c u + w - b u v, u the flow about the cart, in steps that are exact for both held.
    """
    m = casid.Model("cart")
    p, v, u = m.state("p", "m"), m.state("v", "m/s"), m.input("u", "m/s", hold="zoh")
    b = m.parameter("b", "kg/m", start=3.0, lower=0.1)
    m.derivative(p, v)
    m.balance(v, "push", inertia=100.0, terms=[20.0 * u, -b * u * v], unit="N")
    m.output("position", p, "m")
    rng = np.random.default_rng(5)
    N, Ts, sd = 1500, 0.1, 0.004
    flow = np.repeat(rng.uniform(0.2, 1.0, N // 30), 30)
    x, course = np.zeros(2), np.zeros(N)
    for k in range(N):
        course[k] = x[0]
        rate = 3.0 * flow[k] / 100.0
        end, fade = (20.0 * flow[k] + 40.0 * rng.normal()) / (3.0 * flow[k]), np.exp(-rate * Ts)
        left = (x[1] - end) * (1 - fade) / rate
        x = np.array([x[0] + end * Ts + left, end + (x[1] - end) * fade])
    channels = {"u": flow + 0.02 * rng.normal(size=N), "position": course + sd * rng.normal(size=N)}
    lost = {"position": np.isin(np.arange(N), missing)} if missing else {}
    record = casid.Record(channels, {"u": "m/s", "position": "m"}, Ts=Ts, missing=lost)
    fit = fit_model(m, [casid.Experiment(record, {}, "r")], FitSettings(starts=1))
    noise = found_in(fit.criterion, fit.x)
    assert fit.criterion.simulated(fit.x, 0).residual.std() > 500 * sd
    assert noise.output_sd == pytest.approx([sd], rel=0.1)  # 1500 samples know it to 3 %
