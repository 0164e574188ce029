"""Unstable plants in a closed loop: their records are diagnosed window by window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.records import unstable_records
from casid.diagnosis.evidence.records.unstable_records import records_in_windows
from casid.diagnosis.evidence.residual.linearised_path import Linearised
from casid.diagnosis.evidence.scores.score_tests import score_test
from casid.diagnosis.evidence.scores.window_states import left_by_states, states_of_windows
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.refits.joint_refit import Refitting
from casid.estimation.feedback import slope
from casid.estimation.holdout import error_per_window, restarts, split_records
from casid.estimation.local_rank import rank_of
from casid.estimation.noise.noise_response import noise_response
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.instability import growth_rate, window_for
from casid.estimation.simulation.simulation_error import SimulationError
from casid.estimation.simulation.thresholds import INSTABILITY
from casid.model.effects.balances.missing_parts import missing_mode

TS = 0.01
J, MGL, D = 0.05, 2.0, 0.02  # kg m^2, N m, N m s/rad
NOISE = np.array([1e-3, 5e-3])  # rad, rad/s

Slope = Callable[[np.ndarray, float], np.ndarray]


def upright(
    drag: float = 0.0,
    offset: float = 0.0,
    late: int = 0,
    *,
    seed: int = 0,
    N: int = 2000,
    hangs: bool = False,
) -> casid.Record:
    """A pendulum held upright by its sensors' angle and rate, which may be `late` by samples.

    One that `hangs` as the record begins is raised within a twentieth of it.

    J w' = m g l sin(th) - d w - drag |w| w + offset + u, by Runge-Kutta in steps of 1.25 ms.
    """
    rng = np.random.default_rng((seed, 17))
    wanted = np.repeat(0.15 * rng.uniform(-1, 1, N // 100), 100)
    if hangs:
        wanted += np.interp(np.arange(N), [0, N // 20], [np.pi, 0.0])

    def slope(x: np.ndarray, u: float) -> np.ndarray:
        th, w = x
        torque = MGL * np.sin(th) - D * w - drag * abs(w) * w + offset + u
        return np.array([w, torque / J])

    x = np.array([np.pi if hangs else 0.0, 0.0])
    before, rows, h = [x] * (late + 1), [], TS / 8
    for goal in wanted:
        before = [*before[1:], x]
        th, w = before[0] + NOISE * rng.standard_normal(2)
        u = -5.0 * (th - goal) - 0.5 * w - MGL * np.sin(goal)
        rows.append((u, th, w))
        for _ in range(8):
            one = slope(x, u)
            two = slope(x + h / 2 * one, u)
            three = slope(x + h / 2 * two, u)
            x = x + h / 6 * (one + 2 * two + 2 * three + slope(x + h * three, u))
    columns = dict(zip(("u", "phi", "gyro"), np.array(rows).T, strict=True))
    return casid.Record(columns, {"u": "N m", "phi": "rad", "gyro": "rad/s"}, Ts=TS, name="upright")


def problem() -> casid.Problem:
    m = casid.Model("upright pendulum")
    th, w = m.state("th", "rad"), m.state("w", "rad/s")
    u = m.input("u", "N m", hold="zoh", known=True)
    inertia = m.parameter("J", "kg m^2", start=0.04, lower=1e-3, upper=1.0)
    weight = m.parameter("mgl", "N m", start=1.5, lower=0.0, upper=20.0)
    d = m.parameter("d", "N m s/rad", start=0.01, lower=0.0)
    m.derivative(th, w)
    m.balance(w, "torque", inertia=inertia, terms=[weight * ca.sin(th), -d * w, u])
    m.output("phi", th, "rad")
    m.output("gyro", w, "rad/s")
    return casid.Problem("upright pendulum", m, starts=1)


def diagnosed(record: casid.Record, *without: str) -> casid.Diagnosis:
    stated = problem()
    for name in without:
        del stated.model.outputs[name]
    return casid.diagnose(stated, record, advise=False)


def test_an_error_grows_by_e_to_the_fifth_over_a_window():
    """J s^2 + d s - m g l at the start values; N / window windows, each with states of its own."""
    record = upright(N=1000)
    whole = SimulationError(problem().model, [casid.Experiment(record)])
    rate = (-0.01 + np.sqrt(0.01**2 + 4 * 0.04 * 1.5)) / (2 * 0.04)
    assert growth_rate(whole) == pytest.approx(rate, rel=0.02)  # of the angle it begins at
    window = window_for(whole)
    assert window == int(INSTABILITY.per_window / (growth_rate(whole) * TS))
    cut = SimulationError(problem().model, [casid.Experiment(record, window=window)])
    windows = record.N // window
    assert cut.parts(0) == windows
    assert len(cut.variables) == 3 + 2 * windows
    assert cut.n_constraints == 0


def test_what_hangs_as_its_record_begins_and_stands_later_is_unstable():
    """The mean of max(0, Re s), J s^2 + d s - m g l cos(th) = 0, along the measured angle."""
    record = upright(N=2000, hangs=True)
    c = SimulationError(problem().model, [casid.Experiment(record)])
    poles = [np.roots([0.04, 0.01, -1.5 * np.cos(th)]).real.max() for th in record["phi"]]
    assert poles[0] < 0.0
    assert growth_rate(c) == pytest.approx(np.mean(np.maximum(poles, 0.0)), rel=0.05)
    assert window_for(c) > 0


@pytest.mark.parametrize(
    ("drag", "N"), [(0.0, 200), pytest.param(0.02, 300, marks=pytest.mark.slow)]
)
def test_an_unstable_model_that_bends_to_the_fitted_part_is_simulated_in_windows(drag, N):
    """A drag of 0.02 |w| w is bent to within a fifth of the motion, and departs by tens behind it.

    Where nothing is missing the simulation that fits goes on as the record does.
    """
    split = split_records([casid.Experiment(upright(drag, hangs=True, N=N))], 0.3)
    cut = records_in_windows(problem().model, split, FitSettings(starts=1), lambda _: None)
    assert bool(cut.note) == (drag > 0.0)
    assert (cut.split.fitted[0].window > 0) == (drag > 0.0)


def test_the_tangent_of_windows_is_that_of_their_simulations():
    """Central differences of every variable, which errs by their square."""
    record = upright(N=400)
    c = SimulationError(problem().model, [casid.Experiment(record, window=100)])
    x = c.start
    jacobian = c.simulated(x, 0).jacobian
    for i, v in enumerate(c.variables):
        h = np.zeros(len(x))
        h[i] = 1e-5 * v.scale
        slope = (c.simulate(x + h, 0)[0] - c.simulate(x - h, 0)[0]) / (2e-5 * v.scale)
        assert jacobian[:, :, i] == pytest.approx(slope, rel=1e-5, abs=1e-6 * abs(slope).max())


def test_a_force_acts_no_further_than_the_window_it_begins_in():
    """Windows start in states of their own: the response to a force is zero behind its window."""
    record = upright(N=400)
    e = casid.Experiment(record, window=100)
    fit = fit_model(problem().model, [e], FitSettings(starts=1))
    at = fit.criterion.simulated(fit.x, 0)
    path = Linearised(fit.criterion, fit.x).path(0, at.x[:400], fit.criterion.data[0])
    assert path.anew.tolist() == [100, 200, 300]
    force = np.zeros((400, 1))
    force[150] = 1.0
    response = path.respond(0, force)[:, :, 0]
    assert np.all(response[:150] == 0.0)  # joined by straight lines, the force sets in before 150
    assert np.all(response[150:200] != 0.0)
    assert np.all(response[200:] == 0.0)


def test_what_is_held_out_starts_anew_as_often_as_what_is_fitted():
    """A tail of 300 samples in windows of 100, behind 700 in seven."""
    record = upright(N=1000)
    split = split_records([casid.Experiment(record, window=100)], 0.3)
    fit = fit_model(problem().model, split.fitted, FitSettings(starts=1))
    (starts,) = restarts(fit, split)
    assert starts.tolist() == [100, 200, 300, 400, 500, 600, 700, 800, 900]


def test_a_stable_model_has_no_windows():
    """Hanging, the same pendulum has its poles in the left half plane."""
    m = problem().model.copy()
    m.parameters["mgl"] = casid.Parameter("mgl", "N m", -1.5)
    record = upright(N=1000)
    split = split_records([casid.Experiment(record)], 0.3)
    found = records_in_windows(m, split, FitSettings(starts=1), lambda _: None)
    assert found.split is split
    assert not found.note
    assert not found.start


def levitated(lag: float, N: int = 1500) -> tuple[casid.Model, casid.Record]:
    """A ball below a magnet, m x'' = m g - C i^2 / x^2, its current behind the command by `lag`."""
    m = casid.Model("levitated ball")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    i = m.input("i", "A", hold="zoh", known=True)
    C = m.parameter("C", "N m^2/A^2", start=6e-5, lower=1e-6, upper=1e-2)
    mass, g = m.constant("m", 0.12, "kg"), m.constant("g", 9.81, "m/s^2")
    m.derivative(x, v)
    m.balance(v, "force", inertia=mass, terms=[mass * g, -C * i**2 / x**2])
    m.output("gap", x, "m")
    rng, h = np.random.default_rng(1), 1e-4
    rest = np.sqrt(0.12 * 9.81 * 0.01**2 / 8e-5)
    x, v, now, before, rows = 0.01, 0.0, rest, 0.01, []
    for goal in np.repeat(0.01 + rng.uniform(-1.5e-3, 1.5e-3, N // 150), 150):
        y = x + 4e-6 * rng.standard_normal()
        command = rest + 700 * (y - goal) + 12 * (y - before) / 1e-3
        before = y
        rows.append((command, y))
        for _ in range(10):
            now += h / lag * (command - now)
            v += h * (9.81 - 8e-5 / 0.12 * (now / x) ** 2)
            x += h * v
    columns = dict(zip(("i", "gap"), np.array(rows).T, strict=True))
    return m, casid.Record(columns, {"i": "A", "gap": "m"}, Ts=1e-3, name="ball")


@pytest.mark.slow
def test_windows_begin_at_values_of_shorter_ones_and_are_as_long_as_the_model_has_it_there():
    """Ten times too weak a magnet grows sqrt(10) times too slowly: windows it leaves at once.

    At rest the gap grows at sqrt(2 g / x) for any C (weight and magnet balance), so that a window
    is 5 / rate; the current follows the command after a tenth of a sample, 0.1 ms of the 23 ms in
    which errors grow e-fold, which C may make up for by some of that share.
    """
    m, record = levitated(lag=1e-4, N=1000)
    m.parameters["C"] = casid.Parameter("C", "N m^2/A^2", 8e-6, lower=1e-6, upper=1e-2)
    split = split_records([casid.Experiment(record)], 0.3)
    cut = records_in_windows(m, split, FitSettings(starts=1), lambda _: None)
    assert cut.start["C"] == pytest.approx(8e-5, rel=0.01)
    rate = np.sqrt(2 * 9.81 / 0.01)
    assert cut.split.fitted[0].window * record.Ts == pytest.approx(
        INSTABILITY.per_window / rate, rel=0.1
    )
    assert "at the values of a fit in short windows" in cut.note


@pytest.mark.parametrize("window", [pytest.param(100, marks=pytest.mark.slow), 700])
def test_windows_are_halved_only_while_the_record_holds_no_simulation_over_them(
    window, monkeypatch
):
    """Errors grow e-fold in 23 ms: over 0.7 s by e to the 31st, and the ball is at the magnet.

    So long windows a model has that lacks something and seems to grow more slowly.
    """
    m, record = levitated(lag=1e-4, N=1000)
    monkeypatch.setattr(unstable_records, "window_for", lambda _: window)
    split = split_records([casid.Experiment(record)], 0.3)
    cut = records_in_windows(m, split, FitSettings(starts=1), lambda _: None)
    found = SimulationError(m, cut.split.fitted, start=cut.start)
    hessian = found.evaluate(found.start).hessian
    assert rank_of(found.variables, hessian, found.start).is_full
    assert (cut.split.fitted[0].window < window) == (window > 113)


def test_what_a_command_does_is_seen_although_windows_begin_in_states_of_their_own():
    """The growth over a window, which its initial state takes away, is nearly all that a lag does.

    Of what is left the parameters absorb little. A lag of the sensor resembles it and fits worse.
    """
    model, record = levitated(lag=1.5e-3)
    fit = fit_model(model, [casid.Experiment(record, window=120)], FitSettings(starts=1))
    lags = [casid.actuator_lag(model, "i", 0.015), casid.sensor_lag(model, "gap", 0.015)]
    command, sensor = score_test(fit, lags, input_sd={}).scores
    assert command.is_visible
    assert command.visible > 0.1
    assert command.unrobust > sensor.unrobust
    assert 0.5 < command.step / 1.5e-3 < 2.0  # a first step, linear over windows that are not


@pytest.mark.slow
def test_an_adequate_model_of_an_unstable_plant_is_called_adequate():
    """The errors of simulations over windows are those of the sensors.

    Two of about 80 samples of a window go into its initial state: 1.3 % of an error.
    """
    found = diagnosed(upright(seed=3))
    assert found.verdict == "adequate"
    assert any("the model is unstable" in note for note in found.limits.notes)
    for name, sd in zip(("phi", "gyro"), NOISE, strict=True):
        # The RMS of 1400 samples has a standard deviation of 1.9 %, of 600 one of 2.9 %.
        fitted, held_out = (
            errors["baseline_rmse"][name] for errors in (found.gain.fitted, found.gain.held_out)
        )
        assert fitted == pytest.approx(sd, rel=0.013 + 3.5 * 0.019)
        assert held_out == pytest.approx(sd, rel=0.013 + 3.5 * 0.029)


@pytest.mark.slow
def test_what_an_unstable_plant_lacks_is_named_with_its_size():
    """Drag that grows with the rate squared, within 3.5 standard errors of what it is."""
    found = diagnosed(upright(drag=0.05, seed=1, N=3000))
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("quadratic_damping", "torque")
    (d_2,) = cause.parameters
    assert abs(d_2.value - 0.05) < 3.5 * d_2.std_error


@pytest.mark.slow
def test_a_constant_torque_on_an_unstable_plant_is_named_with_its_size():
    """It shifts the angle at which the controller rests, at whatever angle is wanted."""
    found = diagnosed(upright(offset=0.05, seed=1, N=1000))
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("offset", "torque")
    (torque,) = cause.parameters
    assert abs(torque.value - 0.05) < 3.5 * torque.std_error


@pytest.mark.slow
def test_a_late_sensor_of_an_unstable_plant_is_named_with_its_delay():
    """One sample of the only sensor that is recorded."""
    found = diagnosed(upright(late=1, seed=1, N=1000).without("gyro"), "gyro")
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("time_delay", "phi")
    (delay,) = cause.parameters
    assert abs(delay.value - TS) < 3.5 * delay.std_error


def test_a_late_sensor_shows_nothing_of_the_window_before():
    """That ends in another state than the next one begins in, which its own states predict."""
    record, late = upright(N=400), problem().model
    late = late.extend(casid.time_delay(late, "phi", longest=5 * TS))
    late = late.extend(casid.sensor_lag(late, "gyro", longest=5 * TS))
    values = {"delay_phi": 1.3 * TS, "lag_gyro": 2.0 * TS}
    c = SimulationError(late, [casid.Experiment(record, window=100)], start=values)
    jacobian = c.simulated(c.start, 0).jacobian
    states = [i for i, v in enumerate(c.variables) if v.source in late.states]
    for window in range(4):
        own = states[2 * window : 2 * window + 2]
        rows = np.zeros(record.N, dtype=bool)
        rows[100 * window : 100 * window + 100] = True
        assert not jacobian[~rows][:, :, own].any()
        assert np.all(np.abs(jacobian[rows][60:, :, own]).max(axis=(0, 1)) > 0)


def test_the_slope_of_a_simulation_has_no_jump_where_it_starts_anew():
    t = np.arange(30.0)
    jumps = 2.0 * t + 50.0 * (t >= 10) - 80.0 * (t >= 20)
    for backward in (False, True):
        parts = slope(jumps, 0.5, backward=backward, anew=[10, 20])
        assert parts == pytest.approx(np.full(30, 4.0))


def test_the_spectrum_of_noise_in_windows_is_that_of_what_their_states_leave():
    """Of 20 draws of 10 windows, in each of which some ten numbers are independent.

    Their mean square scatters by sqrt(2 / 2000) = 3 %, and its root by half of that: 3.5 times as
    much is allowed. The noise is so small that what it adds in a window stays linear.
    """
    sd, record, model = 0.002, upright(N=800), problem().model.copy()
    model.inputs["u"] = replace(model.inputs["u"], kind="measured")
    c = SimulationError(model, [casid.Experiment(record, window=80)])
    x, d, rng = c.start, c.data[0], np.random.default_rng(4)
    response = noise_response(c, x, 0)
    spectrum = sd**2 * response.gain2[:, :, response.sources.index("u")]
    found = np.sqrt(np.trapezoid(spectrum, response.omega, axis=0) / np.pi)
    states = states_of_windows(c, range(len(x)))
    begun = (c.simulated(x, 0).jacobian * c.weights[None, :, None]).reshape(-1, len(x))[:, states]
    squares = []
    for _ in range(20):
        u = d.u + sd * rng.standard_normal(d.u.shape)
        moved = c.simulate(x, 0, signals=replace(d, u=u))[0] - c.simulate(x, 0)[0]
        left = left_by_states(begun, (moved * c.weights).ravel()).reshape(moved.shape) / c.weights
        squares.append(np.mean(left**2, axis=0))
    assert found == pytest.approx(np.sqrt(np.mean(squares, axis=0)), rel=0.055)


def test_what_noise_of_an_input_leaves_is_what_initial_states_of_windows_do_not_make_up_for():
    """Less that, the criterion is what the sensors leave, chi^2 less a degree for each unknown."""
    sd, record = 0.02, upright(N=1000)
    noisy = record["u"] + sd * np.random.default_rng(8).standard_normal(record.N)
    experiments = [casid.Experiment(record.with_channel("u", noisy, "N m"), window=80)]
    model = problem().model
    fit = fit_model(model, experiments, FitSettings(starts=1))
    weighing = Weighing(experiments, known_noise=dict(zip(("phi", "gyro"), NOISE, strict=True)))
    at = weighing.estimated(fit)
    sensors = replace(at.full.quiet({}), output_sd=NOISE)
    criterion = weighing.criterion(model, sensors, fit.values, fit.criterion)
    left = weighing.minimum(criterion)
    at = replace(at, input_sd={"u": sd})
    expected = 0.5 * (2 * record.N - len(left.x))
    by_noise = left.solution.value - expected
    assert by_noise > expected
    # Both that and its draw scatter as squares do of which each of 13 windows has two or three.
    assert abs(weighing.compensated_criterion(at, criterion, left.x) - expected) < 0.8 * by_noise


@pytest.mark.slow
def test_a_part_pays_for_the_states_in_which_it_begins_in_every_window():
    """Nothing is missing. Two states a window follow noise, chi^2 of two for each but the first."""
    record, window = upright(N=1000), 50
    experiments = [casid.Experiment(record, window=window)]
    fit = fit_model(problem().model, experiments, FitSettings(starts=1))
    weighing = Weighing(experiments, known_noise=dict(zip(("phi", "gyro"), NOISE, strict=True)))
    at = weighing.weigh(problem().model, fit, rounds=1)
    part = missing_mode(problem().model, "torque", 25.0)
    found = Refitting(weighing).refit(at, part, 0.02, near=True)
    assert found is not None
    windows = record.N // window
    assert found.of_windows == 2 * (windows - 1)
    assert found.unknowns == part.cost + found.of_windows
    assert found.gain > part.cost * np.log(2 * record.N)  # which is what it paid
    assert found.merit < 0


def test_errors_in_windows_are_as_large_as_the_noise_whatever_the_number_of_states():
    """Noise less a line, or a cubic, through each of 500 windows of 20 samples."""
    N, window = 10_000, 20
    error = np.random.default_rng(5).standard_normal((N, 1))
    for states in (2, 4):
        basis = np.linalg.qr(np.vander(np.arange(window), states))[0]
        parts = error.reshape(-1, window)
        left = (parts - parts @ basis @ basis.T).reshape(N, 1)
        fit = SimpleNamespace(
            criterion=SimpleNamespace(
                data=[SimpleNamespace(N=N)],
                parts=lambda e: N // window,
                model=SimpleNamespace(states=range(states)),
            )
        )
        rms = float(np.sqrt(np.mean(error_per_window(fit, left) ** 2)))
        assert rms == pytest.approx(1.0, abs=4 / np.sqrt(2 * N))
        assert np.sqrt(np.mean(left**2)) < 1 - 0.7 * states / (2 * window)
