"""Noise of sensors and of measured inputs is told apart by what the model does to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.input_noise_floor import input_noise_floor
from casid.estimation.noise.noise_floor import is_held
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import Response, noise_response
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.records.signals import signals_of
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.effects.channels.actuator_effects import actuator_lag
from casid.model.effects.channels.channel_effects import sensor_lag
from problems import pendulum
from tests.support import truth

OUTPUT, INPUT = 0.01, 0.01  # rad/s, m/s^2: the truth's white noise


def record_of(hidden: truth.TruthRecord) -> casid.Record:
    return casid.Record(
        {n: c for n, c in hidden.columns.items() if n != "t"},
        {n: u for n, u in hidden.units.items() if n != "t"},
        Ts=hidden.Ts,
    )


def fitted(seed: int, duration: float = 60.0):
    hidden = truth.cart_pendulum(seed=seed, duration=duration)
    experiment = casid.Experiment(record_of(hidden), {}, "r")
    criterion = SimulationError(pendulum.problem.model, [experiment])
    return hidden, minimize_simulation_error(criterion)


def test_the_noise_of_gyro_and_accelerometer_is_recovered():
    """The resonance amplifies the accelerometer's noise: colour tells the two apart."""
    found = []
    for seed in range(40, 46):
        _, fit = fitted(seed)
        noise = estimate_noise(fit.criterion, fit.x)
        found.append([noise.output_sd[0], noise.source_sd["accel"]])
    mean = np.mean(found, axis=0)
    # 6000 white samples: sd of an sd 0.9 %. The input's shows within the resonance only, some 3 %
    # of the band and twice as many samples as bins there: 5 % a record, 2 % for the mean of six.
    assert mean[0] == pytest.approx(OUTPUT, rel=0.02)
    assert mean[1] == pytest.approx(INPUT, rel=0.05)
    assert np.all(np.abs(np.array(found)[:, 0] / OUTPUT - 1) < 0.05)
    assert np.all(np.abs(np.array(found)[:, 1] / INPUT - 1) < 0.20)


def test_a_known_noise_is_used_and_not_estimated():
    _, fit = fitted(40)
    noise = estimate_noise(fit.criterion, fit.x, known={"gyro": 0.0123})
    assert noise.output_sd[0] == pytest.approx(0.0123, rel=1e-9)


def test_the_floor_is_the_rms_error_of_the_true_model():
    """(1) integrated over frequency is the variance of what the true parameters leave."""
    hidden, fit = fitted(41)
    noise = estimate_noise(fit.criterion, fit.x)
    rms = float(np.std(hidden.columns["gyro"] - fit.criterion.simulate(fit.x, 0)[0][:, 0]))
    assert noise.floor(0)[0] == pytest.approx(rms, rel=0.05)


def test_whitened_residuals_of_the_model_are_white_and_of_unit_size():
    _, fit = fitted(41)
    noise = estimate_noise(fit.criterion, fit.x)
    c = fit.criterion
    r = noise.whiten(c.simulated(fit.x, 0).residual[:, :, None] * c.weights[:, None], 0)[:, 0, 0]
    assert np.std(r) == pytest.approx(1.0, rel=4 / np.sqrt(2 * len(r)) + 0.02)
    spectrum = np.abs(np.fft.rfft(r)) ** 2 / len(r)
    parts = [p.mean() for p in np.array_split(spectrum[1:], 10)]
    # 300 bins each, exponential: sd 6 %; four of them, and the fit's own error.
    assert parts == pytest.approx(np.ones(10), abs=0.25)


def test_the_response_is_that_of_the_linear_model():
    """G(i w) of (7.24), times (sin x / x)^4, x = w Ts / 2, for straight lines between samples."""
    _, fit = fitted(41)
    r = noise_response(fit.criterion, fit.x, 0)
    v, c = fit.values, pendulum.problem.model.parameters
    S = c["M"].value * c["z_g"].value
    I_2 = v["I_x"] + c["M"].value * c["z_g"].value ** 2 - c["z_s"].value * S
    w = r.omega / 0.01
    s = 1j * w
    G = s / (I_2 * s**2 + v["d"] * s + v["k"])
    j = r.sources.index("torque")
    band = (w > 0.5) & (w < 40.0)  # above, the spectrum folds
    G = G * np.sinc(w * 0.01 / (2 * np.pi)) ** 2
    assert r.gain2[band, 0, j] == pytest.approx(np.abs(G[band]) ** 2, rel=1e-3)
    i = r.sources.index("accel")
    assert r.gain2[band, 0, i] == pytest.approx(S**2 * np.abs(G[band]) ** 2, rel=1e-3)


@pytest.mark.parametrize("hold", ["bandlimited", "foh"])
def test_noise_of_an_input_acts_as_what_the_input_is_between_its_samples(hold):
    """1 / (1 + (w tau)^2) of a band-limited input; of straight lines that of their exact samples.

    The windowed sinc is exact to 2e-4 up to 0.9 of half the sampling rate. With x' = (u - x) / tau
    and lines x(k + 1) = a x(k) + (1 - a - b) u(k) + b u(k + 1), b = 1 - tau / Ts (1 - a).
    """
    Ts, tau = 0.02, 0.03
    m = casid.Model("lag")
    x, u = m.state("x", "m"), m.input("u", "m", hold=hold)
    m.derivative(x, (u - x) / m.constant("tau", tau, "s"))
    m.output("y", x, "m")
    rng = np.random.default_rng(3)
    channels = {"u": rng.standard_normal(200), "y": rng.standard_normal(200)}
    record = casid.Record(channels, {"u": "m", "y": "m"}, Ts=Ts)
    c = SimulationError(m, [casid.Experiment(record, {}, "r")], substeps=8)
    r = noise_response(c, c.start, 0)
    w = r.omega[r.omega < 0.9 * np.pi]
    z, a = np.exp(1j * w), np.exp(-Ts / tau)
    b = 1 - tau / Ts * (1 - a)
    expected = {
        "bandlimited": 1 / (1 + (w * tau / Ts) ** 2),
        "foh": np.abs((1 - a - b + z * b) / (z - a)) ** 2,
    }
    found = r.gain2[: len(w), 0, r.sources.index("u")]
    np.testing.assert_allclose(found, expected[hold], rtol=2e-3)


def test_the_quiet_part_of_an_inputs_spectrum_bounds_its_noise():
    hidden = truth.cart_pendulum(seed=41)
    experiment = casid.Experiment(record_of(hidden), {}, "r")
    model = pendulum.problem.model
    bound = input_noise_floor([signals_of(model, experiment)], list(model.inputs))
    # The quietest 5 of 20 bands of 150 bins (sd of a power 8 %, tapered 10 %) lie below the mean.
    assert 0.85 * INPUT < bound["accel"] < 1.1 * INPUT


def test_inputs_that_act_alike_share_what_is_found_and_the_rest_is_a_disturbance():
    """Gains of 1, 2 and 1 with bounds of 3 and 2: together 9 + 16 of the variance at most."""
    gain2 = np.ones((5, 1, 3)) * np.array([1.0, 4.0, 1.0])
    response = Response(np.linspace(0, np.pi, 5), gain2, ("a", "b", "force"))

    def noise(variance: float) -> NoiseModel:
        sd = {"a": variance**0.5, "b": 0.0, "force": 0.0}
        return NoiseModel(np.ones(1), sd, [response], np.ones(1), (("a", "b", "force"),))

    bounds = {"a": 3.0, "b": 2.0}
    assert noise(25.0 / 4).of_inputs(bounds) == pytest.approx({"a": 1.5, "b": 1.0})
    assert noise(100.0).of_inputs(bounds) == pytest.approx(bounds)
    assert noise(0.0).of_inputs(bounds) == {"a": 0.0, "b": 0.0}


def test_a_force_with_a_spectrum_of_its_own_is_no_noise_of_an_input_that_acts_alike():
    """Waves beside a measured wind: the wind's noise is what is white, whatever the waves are."""
    response = Response(np.linspace(0, np.pi, 5), np.ones((5, 1, 2)), ("wind", "force"))
    noise = NoiseModel(
        np.ones(1),
        {"wind": 0.5, "force": 10.0},
        [response],
        np.ones(1),
        (("wind", "force"),),
        spectra={"force": DisturbanceSpectrum(2.0, 0.1)},
    )
    assert noise.of_inputs({"wind": 3.0}) == pytest.approx({"wind": 0.5})


def mean_bound(seed: int, draws: int, *lengths: int) -> float:
    """Of the noise of an input, over draws of white noise of size one in records so long."""
    rng, model = np.random.default_rng(seed), pendulum.problem.model
    units = {"gyro": "rad/s", "accel": "m/s^2"}
    found = []
    for _ in range(draws):
        made = []
        for N in lengths:
            channels = dict(zip(units, rng.standard_normal((2, N)), strict=True))
            record = casid.Record(channels, units, Ts=0.02)
            made.append(signals_of(model, casid.Experiment(record, {}, f"{N} samples")))
        found.append(input_noise_floor(made, list(model.inputs))["accel"])
    return float(np.mean(found))


def test_the_bound_on_an_inputs_noise_is_that_of_white_noise_however_short_the_record():
    """Uncorrected, the quietest quarter of forty parts would lie a fifth below."""
    # sd of one bound is near 4 %, of the mean of twenty 1 %
    assert mean_bound(3, 20, 1400, 1400) == pytest.approx(1.0, abs=0.04)


def test_the_bound_on_an_inputs_noise_is_that_of_white_noise_in_records_of_unlike_length():
    """As if all parts scattered like those of the shorter, it would lie a sixth too high."""
    # sd of one bound is near 8 %, of the mean of thirty 1.5 %
    assert mean_bound(4, 30, 1400, 360) == pytest.approx(1.0, abs=0.08)


def driven(extend=lambda m: m) -> SimulationError:
    """A damped mass driven by a measured force, its position measured; 60 s at 50 Hz."""
    m = casid.Model("damped mass")
    x, v = m.state("x", "m", initial=0.0), m.state("v", "m/s", initial=0.0)
    force = m.input("force", "N", hold="foh")
    k = m.parameter("k", "N/m", start=40.0)
    m.derivative(x, v)
    m.balance(v, "forces", inertia=1.0, terms=[-k * x, -3.0 * v, force])
    m.output("position", x, "m")
    columns = {"force": np.zeros(3000), "position": np.zeros(3000)}
    record = casid.Record(columns, {"force": "N", "position": "m"}, Ts=0.02)
    return SimulationError(extend(m), [casid.Experiment(record, {}, "r")], weights=np.ones(1))


def at(criterion: SimulationError, value: float) -> np.ndarray:
    return np.array([v.start if v.name == "k" else value for v in criterion.variables])


TAU = 0.15
STAGES = {
    "actuator lag": (lambda m: actuator_lag(m, "force", 1.0).extend(m), -1),
    "sensor lag of the input": (lambda m: sensor_lag(m, "force", 1.0).extend(m), +1),
    "sensor lag of the output": (lambda m: sensor_lag(m, "position", 1.0).extend(m), -1),
}


@pytest.mark.parametrize("stage", STAGES)
def test_what_lags_passes_noise_as_its_equation_says(stage):
    """|G|^2 is that without the lag times (1 + w^2 tau^2) to the power -1, or +1 where undone."""
    extend, power = STAGES[stage]
    bare, lagging = driven(), driven(extend)
    before = noise_response(bare, bare.start, 0)
    after = noise_response(lagging, at(lagging, TAU), 0)
    w = before.omega / 0.02
    low = w < 20.0  # samples a tenth of that period: joined by lines they are 2 % short there
    expected = (1 + (w * TAU) ** 2) ** power
    found = after.gain2[:, 0, 0] / before.gain2[:, 0, 0]
    assert found[low] == pytest.approx(expected[low], rel=0.06)
    # A force that nobody models knows of the output's sensor, and of no input's.
    force = after.gain2[:, 0, 1] / before.gain2[:, 0, 1]
    assert force[low] == pytest.approx(
        expected[low] if stage == "sensor lag of the output" else np.ones(low.sum()), rel=0.06
    )


@pytest.mark.parametrize("stage", STAGES)
def test_the_response_with_a_lag_is_that_of_the_simulation(stage):
    """One noisy sample, simulated, has |G|^2 for its periodogram at every frequency."""
    lagging = driven(STAGES[stage][0])
    x = at(lagging, TAU)
    r = noise_response(lagging, x, 0)
    d = lagging.data[0]
    u = np.zeros_like(d.u)
    u[1000, list(lagging.model.inputs).index("force")] = 1.0
    y = lagging.simulate(x, 0, signals=replace(d, u=u))[0][:, 0]
    spectrum = np.abs(np.fft.rfft(y, 6000)) ** 2
    # What rings on at the end, 40 s later, is exp(-1.5 * 40) of it.
    assert r.gain2[1:, 0, 0] == pytest.approx(spectrum[1:], rel=1e-6, abs=1e-9 * spectrum.max())


def test_a_sensor_that_lags_does_not_filter_its_own_noise():
    lagging = driven(STAGES["sensor lag of the output"][0])
    r = noise_response(lagging, at(lagging, TAU), 0)
    noise = NoiseModel(np.array([0.1]), {"force": 0.0, "forces": 0.0}, [r], np.ones(1))
    assert noise.spectrum(0) == pytest.approx(np.full((3001, 1), 0.01))


def test_whitening_in_groups_is_whitening_column_by_column():
    _, fit = fitted(41, duration=20.0)
    noise = estimate_noise(fit.criterion, fit.x)
    columns = np.random.default_rng(0).standard_normal((2000, 1, 19))
    once = noise.whiten(columns, 0)
    each = [noise.whiten(columns[:, :, [j]], 0) for j in range(19)]
    assert any(noise.source_sd.values())
    assert once == pytest.approx(np.concatenate(each, axis=2), abs=1e-12)


def test_a_command_that_repeats_its_values_has_no_noise():
    """Its steps reach up to Nyquist; noise would not give the same number twice."""
    rng = np.random.default_rng(5)
    held = np.repeat(rng.choice([-3.0, 0.0, 6.0], 60), 20)
    assert is_held([held])
    assert not is_held([held + 0.01 * rng.standard_normal(len(held))])


def test_the_likelihood_of_a_record_does_not_depend_on_the_weights_of_its_outputs():
    """Weighted by w, the residual is w times as large and so is its standard deviation."""
    experiment = casid.Experiment(record_of(truth.cart_pendulum(seed=43, duration=20.0)), {}, "r")
    found = []
    for weight in (1.0, 50.0):
        criterion = SimulationError(
            pendulum.problem.model, [experiment], weights=np.array([weight])
        )
        x = criterion.start
        noise = estimate_noise(criterion, x)
        e = (weight * criterion.simulated(x, 0).residual)[:, :, None]
        white = noise.whiten(e, 0)
        found.append(float(np.sum(white**2)) + noise.log_determinant(0, e.shape[0]))
    assert found[1] == pytest.approx(found[0], rel=1e-9)


def test_the_noise_of_an_output_scales_with_its_unit_however_small_beside_anothers():
    """y = g x: the noise found is g times that of x, nanometres beside metres."""
    rng = np.random.default_rng(4)
    t = 0.1 * np.arange(400)
    x, v = np.exp(-0.05 * t), -0.05 * np.exp(-0.05 * t)
    noise = 0.01 * rng.standard_normal((2, t.size))
    found = []
    for gain in (1.0, 1e-7):
        m = casid.Model("decay")
        state, a = m.state("x", "m"), m.parameter("a", "1/s", start=0.05)
        m.derivative(state, -a * state)
        m.output("near", gain * state, "m")
        m.output("speed", m.der(state), "m/s")
        columns = {"near": gain * (x + noise[0]), "speed": v + noise[1]}
        record = casid.Record(columns, {"near": "m", "speed": "m/s"}, Ts=0.1)
        criterion = SimulationError(m, [casid.Experiment(record, {}, "r")])
        at = minimize_simulation_error(criterion)
        found.append(estimate_noise(at.criterion, at.x).output_sd / [gain, 1.0])
    assert found[1] == pytest.approx(found[0], rel=1e-3)
    assert found[0] == pytest.approx([0.01, 0.01], rel=4 / np.sqrt(2 * 400))  # four sd of an sd


def cell(
    seed: int, input_sd: float = 0.01, output_sd: float = 0.004, N: int = 1500
) -> casid.Record:
    """A capacitor of 70 F under a measured current that is held for some 50 s at a time; 1 s."""
    rng = np.random.default_rng(seed)
    held = np.repeat(rng.uniform(-10.0, 10.0, N // 50), 50)
    # Alternating signs keep the charge within bounds.
    current = held - np.repeat(np.add.reduceat(held, np.arange(0, N, 500)) / 500, 500)
    volt = 10.0 + np.concatenate([[0.0], np.cumsum(current)[:-1]]) / 70.0
    channels = {
        "i": current + input_sd * rng.standard_normal(N),
        "V": volt + output_sd * rng.standard_normal(N),
    }
    return casid.Record(channels, {"i": "A", "V": "V"}, Ts=1.0)


def capacitor() -> casid.Model:
    m = casid.Model("capacitor")
    v, i = m.state("v", "V", start=10.0), m.input("i", "A", hold="zoh")
    C = m.parameter("C", "farad", start=60.0, lower=1.0)
    m.balance(v, "charge", inertia=C, terms=[i])
    m.output("V", v, "V")
    return m


def test_the_noise_of_an_integrated_input_is_found_though_the_fit_takes_the_mean_away():
    """What white noise of 0.01 A adds up to in 70 F: a random walk of 0.14 mV a second.

    Its spectrum falls as 1/w^2, and most of it lies below the record's first line, at zero, where
    the initial state leaves nothing.
    """
    found = []
    for seed in range(8):
        fit = minimize_simulation_error(
            SimulationError(capacitor(), [casid.Experiment(cell(seed))])
        )
        noise = estimate_noise(fit.criterion, fit.x)
        found.append([noise.output_sd[0], noise.source_sd["i"]])
    mean = np.mean(found, axis=0)
    assert mean[0] == pytest.approx(0.004, rel=0.03)
    # The ends of a walk differ, which doubles its periodogram; the fit takes some of it away. It is
    # seen at some eight lines, so that each record's sd is uncertain by a third.
    assert 0.01 / np.sqrt(2.0) < mean[1] < 0.01 * 2.0
    assert min(f[1] for f in found) > 0.003


@pytest.mark.parametrize("size", [1.0, 1e-9])
def test_which_forces_act_alike_does_not_depend_on_the_size_of_an_output(size):
    """Alike to the first output, 1/(s + 1) each; to the second 1/(s + 1) and 3/(s + 1)(s + 5)."""
    m = casid.Model("two forces")
    a, b, z = m.state("a", "1"), m.state("b", "1"), m.state("z", "1")
    u, rate = m.input("u", "1/s", hold="zoh", known=True), m.constant("rate", 1.0, "1/s")
    c = m.parameter("c", "1/s", start=1.0, lower=0.1)
    m.balance(a, "first", inertia=1, terms=[u, -c * a], unit="1/s")
    m.balance(b, "second", inertia=1, terms=[u, -c * b], unit="1/s")
    m.derivative(z, rate * b - 5 * rate * z)
    m.output("sum", a + b, "1")
    m.output("other", m.constant("size", size, "1") * (a + 3 * z), "1")
    rng = np.random.default_rng(6)
    channels = {"u": np.repeat(rng.normal(size=30), 20)}
    channels |= {"sum": rng.normal(size=600), "other": size * rng.normal(size=600)}
    record = casid.Record(channels, {"u": "1/s", "sum": "1", "other": "1"}, Ts=0.1)
    weights = np.array([1.0, 1.0 / size])
    criterion = SimulationError(m, [casid.Experiment(record)], weights=weights)
    assert estimate_noise(criterion, criterion.start).alike == (("first",), ("second",))


@pytest.mark.parametrize("order", [("warm", "air"), ("air", "warm")])
def test_what_acts_on_one_output_is_not_like_what_acts_on_two(order):
    """On the temperature they are alike; a current is seen in the voltage as well."""
    m = casid.Model("cell")
    T = m.state("T", "K")
    drive = {name: m.input(name, "1") for name in order}
    lost, c = m.parameter("lost", "1/s", start=0.1, lower=0.01), m.constant("c", 0.1, "K/s")
    m.balance(T, "heat", inertia=1, terms=[c * drive["warm"], c * drive["air"], -lost * T])
    m.output("T", T, "K")
    m.output("U", m.constant("R", 0.01, "V") * drive["warm"], "V")
    rng = np.random.default_rng(3)
    channels = dict(zip(("warm", "air", "T", "U"), rng.normal(size=(4, 400)), strict=True))
    record = casid.Record(channels, {"warm": "1", "air": "1", "T": "K", "U": "V"}, Ts=1.0)
    criterion = SimulationError(m, [casid.Experiment(record)], weights=np.ones(2))
    groups = estimate_noise(criterion, criterion.start).alike
    assert not any({"warm", "air"} <= set(group) for group in groups)
    assert any({"air", "heat"} <= set(group) for group in groups)


def test_the_noise_of_an_input_counts_whichever_way_another_turns_its_gain():
    """dy/dt = u w - a y; u is 1 or -1 as often, so that w acts with a gain of zero on average."""
    rng = np.random.default_rng(5)
    N, Ts, a, noise = 3000, 0.1, 0.5, 0.1
    u = np.repeat(rng.choice([-1.0, 1.0], N // 20), 20)
    w = 2.0 + np.sin(0.03 * np.arange(N))
    y, level = np.empty(N), 0.0
    for k in range(N):
        y[k] = level
        level = np.exp(-a * Ts) * level + (1 - np.exp(-a * Ts)) / a * u[k] * w[k]
    y += 0.01 * rng.standard_normal(N)
    m = casid.Model("valve")
    x, command = m.state("x", "m"), m.input("u", "1", hold="zoh", known=True)
    supply = m.input("w", "m/s", hold="zoh")
    m.derivative(x, command * supply - m.parameter("a", "1/s", start=0.6, lower=0.1, upper=5) * x)
    m.output("y", x, "m")
    record = casid.Record(
        {"u": u, "w": w + noise * rng.standard_normal(N), "y": y},
        {"u": "1", "w": "m/s", "y": "m"},
        Ts=Ts,
    )
    fit = minimize_simulation_error(SimulationError(m, [casid.Experiment(record, {}, "r")]))
    found = estimate_noise(fit.criterion, fit.x)
    assert found.source_sd["w"] == pytest.approx(noise, rel=0.1)
    assert found.output_sd[0] == pytest.approx(0.01, rel=0.1)
