"""Prediction-error estimation as statements of theory: (2.36)-(2.38), (2.52)-(2.56), (3.55)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.stats import chi2

import casid
from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.likelihood import PredictionError
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.identification.grey_box import Prediction, minimize_prediction_error
from casid.linear.filtering.kalman import time_varying
from casid.linear.filtering.noisy_model import NoisyModel, White
from casid.model.effects.channels.channel_effects import hold
from problems.pendulum import direct_model
from tests.support.linear_pendulum import TRUTH, simulate

Array = np.ndarray[Any, Any]
A, B = 1.5, 2.0  # x' = -a x + b (u + w)


def lag_model() -> casid.Model:
    """A first-order lag with white process noise, the input held."""
    m = casid.Model("lag")
    x = m.state("x", "m")
    u = m.input("u", "N", hold="zoh")
    w = m.unknown_input("w", "N")
    a = m.parameter("a", "1/s", start=1.0, lower=1e-3)
    b = m.parameter("b", "m/(N s)", start=1.0)
    m.derivative(x, -a * x + b * u + w * m.constant("one", 1.0, "m/(N s)"))
    m.output("y", x, "m")
    return m


def lag_record(
    seed: int, N: int = 600, Ts: float = 0.2, q: float = 0.5, r: float = 0.2, input_sd: float = 0.0
) -> casid.Record:
    """The lag sampled exactly: process noise of spectral density q, noise of variance r on y.

    The input is white, and its channel has white noise of `input_sd`.
    """
    rng = np.random.default_rng(seed)
    F = np.exp(-A * Ts)
    step, spread = (1 - F) / A, np.sqrt(q * (1 - F**2) / (2 * A))
    u, w = rng.standard_normal(N), rng.standard_normal(N)
    x = np.zeros(N)
    for t in range(N - 1):
        x[t + 1] = F * x[t] + step * B * u[t] + spread * w[t]
    y = x + np.sqrt(r) * rng.standard_normal(N)
    measured = u + input_sd * rng.standard_normal(N)
    return casid.Record({"u": measured, "y": y}, {"u": "N", "y": "m"}, Ts=Ts, name=f"lag {seed}")


LAG_NOISE = (White("y", 0.3), White("w", 1.0))


def walk_model() -> casid.Model:
    """The pendulum with its cart's acceleration as a random walk."""
    m = direct_model()
    a = m.state("a", "m/s^2")
    m.derivative(a, m.unknown_input("rate of a", "m/s^3"))
    m.substitute_symbol("a_y", a)
    del m.inputs["a_y"]
    return m


WALK_NOISE = (
    White("gyro", 0.02),
    White("accel", 0.03),
    White("rate of a", 1.0),
    White("torque", 0.05, held=True),
)


def pendulum_experiments() -> list[casid.Experiment]:
    """Nominal at 100 Hz and loaded at 50 Hz, the load known."""
    return [
        casid.Experiment(simulate(duration=6.0, seed=1), {}, "nominal"),
        casid.Experiment(simulate(duration=6.0, seed=2, Ts=0.02, load=0.2), {"m": 0.2}, "loaded"),
    ]


# -- the criterion --------------------------------------------------------------------------------


@pytest.mark.parametrize("initial", [None, {"phi": 0.1, "p": 0.2, "a": 0.5}])
def test_gradient_is_that_of_the_criterion(initial: dict[str, float] | None) -> None:
    """Exact derivatives against central differences, in units in which the curvature is one.

    A step h of a scaled variable errs by O(h^2) and by rounding, 1e-16 V / h: below 1e-5 of the
    gradient's length at h = 1e-4.
    """
    model = walk_model().with_unknown("z_m").with_known(k=10.0)
    c = PredictionError(
        model, pendulum_experiments(), WALK_NOISE, initial=initial, own=["d"], start={"z_m": -0.3}
    )
    x = c.start
    at = c.evaluate(x)
    unit = 1 / np.sqrt(np.diag(at.hessian))
    numeric = np.empty(len(x))
    for i, size in enumerate(unit):
        step = 1e-4 * size * np.eye(len(x))[i]
        numeric[i] = (c.evaluate(x + step).value - c.evaluate(x - step).value) / 2e-4
    exact = at.gradient * unit
    assert np.linalg.norm(exact - numeric) < 1e-5 * np.linalg.norm(exact)
    assert c.value(x) == pytest.approx(at.value, rel=1e-12)
    np.testing.assert_allclose(c.scores(x).sum(axis=0), at.gradient, rtol=1e-8, atol=1e-6)
    lengths = [len(p.innovations) for p in c.predicted(x, 0)]
    if initial is None:
        assert lengths == [600]
    else:  # the gain has settled before the record ends
        assert lengths[0] < 600
        assert sum(lengths) == 600


def test_fisher_information_is_the_covariance_of_the_scores_at_the_truth() -> None:
    """E s s' = I where the model is the truth; the sum over N samples strays by sqrt(c / N).

    A score is quadratic in normals, so its fourth moment is at most 60 times its squared variance
    (x^4 against (x^2)^2 is 3, (x^2 - 1)^4 against (2)^2 is 15, doubled and squared for safety).
    """
    record = lag_record(3, N=20_000)
    start = {"a": A, "b": B, "psd(w)": 0.5, "var(y)": 0.2}
    c = PredictionError(lag_model(), [casid.Experiment(record)], LAG_NOISE, start=start)
    x = c.start
    s, h = c.scores(x)[:, :4], c.evaluate(x).hessian[:4, :4]
    lower = np.linalg.cholesky(h)
    whitened = np.linalg.solve(lower, np.linalg.solve(lower, s.T @ s).T)
    np.testing.assert_allclose(whitened, np.eye(4), atol=4 * np.sqrt(60 / record.N))
    # The score itself is a normal with this covariance.
    z = np.linalg.solve(lower, s.sum(axis=0))
    assert float(z @ z) < chi2.ppf(0.999, 4)


def test_likelihood_is_that_of_the_time_varying_predictor() -> None:
    model, sd = walk_model(), {"phi": 0.1, "p": 0.2, "a": 0.5}
    [nominal, _] = pendulum_experiments()
    c = PredictionError(model, [nominal], WALK_NOISE, initial=sd)
    at = c.sampled(c.start, 0)
    y = np.column_stack([nominal.record["gyro"], nominal.record["accel"]])
    run = time_varying(at.system, y, P0=np.diag([v**2 for v in sd.values()]))
    assert c.log_likelihood(c.start) == pytest.approx(run.log_likelihood, rel=1e-10)
    np.testing.assert_allclose(c.innovations(c.start, 0), run.innovations, atol=1e-9)


def test_steady_criterion_runs_the_steady_predictor() -> None:
    c = PredictionError(lag_model(), [casid.Experiment(lag_record(1))], LAG_NOISE)
    x = c.start
    x[c.names.index("x(0)")] = 0.7
    record = c.experiments[0].record
    run = c.predictor(x, 0).run(record["y"], record["u"], np.array([0.7]))
    np.testing.assert_allclose(c.innovations(x, 0), run.innovations, atol=1e-12)
    assert c.log_likelihood(x) == pytest.approx(run.log_likelihood, rel=1e-12)


# -- the estimate ---------------------------------------------------------------------------------


def fit_lag(record: casid.Record, noise: Sequence[White] = LAG_NOISE, **options: Any) -> Prediction:
    return minimize_prediction_error(lag_model(), record, noise, **options)


@pytest.mark.slow
def test_estimates_stray_as_their_covariance_says() -> None:
    """The errors of a, b, q, r over 20 records, each normalised by its own covariance."""
    total, truth = 0.0, {"a": A, "b": B, "psd(w)": 0.5, "var(y)": 0.2}
    for seed in range(20):
        found = fit_lag(lag_record(seed)).estimate
        index = [found.covariance_names.index(n) for n in truth]
        error = np.array([found[n] - v for n, v in truth.items()])
        total += float(error @ np.linalg.solve(found.covariance[np.ix_(index, index)], error))
    assert chi2.ppf(0.001, 80) < total < chi2.ppf(0.999, 80)


def test_prediction_error_of_a_noisy_lag_is_an_armax_model() -> None:
    """x in noise of both kinds is ARMAX(1, 1, 1): the same optimum, found by other code.

    The two treat the first sample differently, which moves an estimate by about one sample's part,
    far below a tenth of its standard error.
    """
    from casid.estimation.prediction_error.polynomial.estimation import armax

    record = lag_record(4, N=4000)
    grey = fit_lag(record)
    black = armax(record["y"], record["u"], na=1, nb=1, nc=1, nk=1)
    F = np.exp(-grey["a"] * record.Ts)
    gain = grey["b"] * (1 - F) / grey["a"]
    K = grey.predictor().K[0, 0]
    se = [grey.estimate.parameter(n).std_error or np.nan for n in ("a", "b")]
    assert black.A[1] == pytest.approx(-F, abs=0.1 * se[0] * record.Ts)
    assert black.B["u"][-1] == pytest.approx(gain, abs=0.1 * se[1] * record.Ts)
    assert black.C[1] == pytest.approx(K - F, abs=0.01)  # H = 1 + K / (q - F)


def test_without_process_noise_it_is_the_simulation_error() -> None:
    """One output, no process noise: the gain is zero and the variance only scales (1)."""
    m = lag_model()
    record = lag_record(5, q=0.0)
    known = [White("y", 0.3), White("w", 0.0, is_known=True)]
    found = minimize_prediction_error(m, record, known)
    assert np.all(found.predictor().K == 0.0)
    plain = casid.Model("plain")
    x, u = plain.state("x", "m"), plain.input("u", "N", hold="zoh")
    a, b = plain.parameter("a", "1/s", start=1.0), plain.parameter("b", "m/(N s)", start=1.0)
    plain.derivative(x, -a * x + b * u)
    plain.output("y", x, "m")
    criterion = SimulationError(plain, [casid.Experiment(record)], substeps=8)
    other = minimize_simulation_error(criterion)
    # Eight Runge-Kutta steps a sample of a Ts = 0.3 err by (0.3 / 8)^5 / 120 each: below 1e-8. Both
    # solvers stop at a scaled gradient below 1e-5: as many standard errors, times sqrt(N).
    for name in ("a", "b", "x(0)"):
        error = found.estimate.parameter(name).std_error
        assert error is not None
        assert abs(found[name] - other.values[name]) < 1e-5 * np.sqrt(record.N) * error
    residual = criterion.simulated(other.x, 0).residual
    assert found["var(y)"] == pytest.approx(float(np.mean(residual**2)), rel=1e-6)


def test_neglected_noise_of_the_input_draws_the_gain_to_zero_by_the_share_of_noise() -> None:
    """White u and white noise on it, output error: G* = lambda_u / (lambda_u + lambda_e) G (3.55).

    The pole stays where it is, and the estimate is a known number, not merely another one.
    """
    noise = [White("y", 0.3), White("w", 0.0, is_known=True)]
    input_sd, N = 0.7, 20_000
    found = fit_lag(lag_record(6, N=N, q=0.0, input_sd=input_sd), noise).estimate
    limit = B / (1 + input_sd**2)
    for name, value in (("a", A), ("b", limit)):
        error = found.parameter(name).std_error
        assert error is not None
        assert abs(found[name] - value) < 4 * error
    error = found.parameter("b").std_error or np.nan
    assert abs(found["b"] - B) > 20 * error


def test_experiments_share_parameters_with_their_own_sample_times_and_known_values() -> None:
    model = walk_model().with_unknown("z_m")
    experiments = [
        casid.Experiment(simulate(duration=40.0, seed=1, walk=1.5), {"z_m": -0.274}, "nominal"),
        casid.Experiment(
            simulate(duration=40.0, seed=2, Ts=0.02, load=0.2, walk=1.5), {"m": 0.2}, "loaded"
        ),
    ]
    found = minimize_prediction_error(model, experiments, WALK_NOISE[:3], start={"z_m": -0.2})
    for name, value in (TRUTH | {"z_m": -0.274}).items():
        error = found.estimate.parameter(name).std_error
        assert error is not None
        assert abs(found[name] - value) < 4 * error, name
    assert found.noise["gyro"][0] == pytest.approx(0.01, rel=0.1)
    assert found.noise["rate of a"][0] == pytest.approx(1.5, rel=0.1)
    assert "a(0)@loaded" in found.estimate.names
    assert set(found.estimate.rmse) == {"nominal", "loaded"}
    assert "one sample ahead" in str(found)
    assert found.innovations(1).shape == (2000, 2)


def test_estimated_and_uncertain_initial_states_agree() -> None:
    """They differ by the information in the first moments: a fraction of a standard error."""
    record = lag_record(7)
    steady, varying = fit_lag(record), fit_lag(record, initial={"x": 1.0})
    for name in ("a", "b"):
        error = steady.estimate.parameter(name).std_error
        assert error is not None
        assert abs(steady[name] - varying[name]) < 0.3 * error
    assert not varying.estimate.initial_states


def test_solvers_agree_on_the_optimum() -> None:
    record = lag_record(8)
    by = [fit_lag(record, solver=Solver(name)) for name in ("ipopt", "sqpmethod")]
    # Converged means a scaled gradient below 1e-5, so a value within 1e-10 and a step of 1e-5.
    assert by[0].log_likelihood == pytest.approx(by[1].log_likelihood, rel=1e-9)
    for name in ("a", "b", "psd(w)", "var(y)"):
        error = by[0].estimate.parameter(name).std_error
        assert error is not None
        assert abs(by[0][name] - by[1][name]) < 1e-3 * error


def test_right_noise_model_has_the_better_akaike_criterion() -> None:
    record = lag_record(9)
    right = fit_lag(record)
    wrong = fit_lag(record, [White("y", 0.3), White("w", 0.0, is_known=True)])
    assert right.aic < wrong.aic - 10
    assert "autocorrelated" in wrong.estimate.whiteness["y"]
    assert "autocorrelated" not in right.estimate.whiteness["y"]


def tank() -> casid.Model:
    """Outflow with the root of the level: nonlinear, at rest where the pump makes up for it."""
    m = casid.Model("tank")
    h = m.state("h", "m", start=1.0, lower=0.0)
    pump, w = m.input("pump", "m^3/s", hold="zoh"), m.unknown_input("w", "m^3/s")
    c = m.parameter("c", "m^2.5/s", start=0.04, lower=1e-3)
    area = m.parameter("area", "m^2", start=0.8, lower=1e-2)
    m.derivative(h, (pump + w - c * ca.sqrt(h)) / area)
    m.output("level", h, "m")
    return m


def tank_record(N: int = 3000, Ts: float = 1.0) -> casid.Record:
    """Small steps about the pump's 0.05 m^3/s, by Runge-Kutta; c = 0.05, area = 1.0."""
    rng = np.random.default_rng(11)
    pump = 0.05 + 0.0005 * (-1.0) ** np.cumsum(rng.random(N) < 0.03)
    h = np.ones(N)

    def rate(x: float, u: float) -> float:
        return u - 0.05 * float(np.sqrt(x))

    for t in range(N - 1):
        x, u = float(h[t]), float(pump[t]) + 0.0005 * rng.standard_normal()
        k1 = rate(x, u)
        k2 = rate(x + Ts / 2 * k1, u)
        k3 = rate(x + Ts / 2 * k2, u)
        h[t + 1] = x + Ts / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + Ts * k3, u))
    level = h + 0.001 * rng.standard_normal(N)
    return casid.Record({"pump": pump, "level": level}, {"pump": "m^3/s", "level": "m"}, Ts=Ts)


def test_nonlinear_model_is_fitted_near_its_rest() -> None:
    """At rest h = 1, so that pump = c: the rest moves with the parameter, derivatives included.

    The level strays by 2 % of 1 m, so the root's second-order term is 1e-4 of it: no bias to see.
    """
    model, record = tank(), tank_record()
    rest = {"h": 1.0, "pump": model.symbol("c")}
    noise = [White("level", 0.002), White("w", 0.001, held=True)]
    for initial in (None, {"h": 0.01}):
        c = PredictionError(model, [casid.Experiment(record)], noise, rest=rest, initial=initial)
        x, at = c.start, c.evaluate(c.start)
        assert c.value(x) == pytest.approx(at.value, rel=1e-12)
        unit = 1 / np.sqrt(np.diag(at.hessian))
        for i, size in enumerate(unit):
            step = 1e-4 * size * np.eye(len(x))[i]
            numeric = (c.evaluate(x + step).value - c.evaluate(x - step).value) / 2e-4
            length = np.linalg.norm(at.gradient * unit)
            assert abs(at.gradient[i] * size - numeric) < 1e-5 * length
    found = minimize_prediction_error(model, record, noise, rest=rest)
    for name, value in {"c": 0.05, "area": 1.0, "var(w)": 0.0005**2, "var(level)": 1e-6}.items():
        error = found.estimate.parameter(name).std_error
        assert error is not None
        assert abs(found[name] - value) < 4 * error, name
    assert "nonlinear: valid for small deviations" in str(found)


# -- refusals -------------------------------------------------------------------------------------


def test_noise_is_to_be_named_for_all_that_needs_it() -> None:
    record = lag_record(0)
    cases = {
        r"output y has no noise; give White\('y'": LAG_NOISE[1:],
        r"input w is unknown; give White\('w'.*eliminate it": LAG_NOISE[:1],
        r"noise of 'z' enters nowhere; name one of its outputs \(y\)": (*LAG_NOISE, White("z", 1)),
        "noise of y stated twice; give it once": (*LAG_NOISE, White("y", 1)),
    }
    for message, noise in cases.items():
        with pytest.raises(ModelError, match=message):
            fit_lag(record, noise)
    with pytest.raises(ModelError, match="give a positive start, or zero as known"):
        White("y", 0.0)
    for wrong in ("0.3", None, True):
        with pytest.raises(ModelError, match="noise of y: sd = .* is not a number; give the stand"):
            White("y", wrong)  # type: ignore[arg-type]


def test_names_that_the_model_does_not_have_are_refused() -> None:
    with pytest.raises(ModelError, match="no state 'q' to start in doubt; it has x"):
        fit_lag(lag_record(0), initial={"q": 1.0})
    with pytest.raises(ModelError, match="no parameter 'q'; known are: a, b"):
        fit_lag(lag_record(0), own=["q"])


def test_a_start_for_what_is_no_variable_is_refused() -> None:
    record = lag_record(0)
    with pytest.raises(ModelError, match=r"start names 'aa', .*there are a, b, .*mean 'a'\?"):
        fit_lag(record, start={"aa": 3.0})
    with pytest.raises(ModelError, match=r"start names 'y', .* did you mean 'var\(y\)'\?"):
        fit_lag(record, start={"y": 0.1})
    with pytest.raises(ModelError, match=r"'one', which is known: leave it out.*with_unknown"):
        fit_lag(record, start={"one": 1.0})
    # Its mends: a variable's own name, and the common name of what each experiment has its own.
    assert fit_lag(record, start={"a": 3.0}).estimate.parameter("a").start == 3.0
    both = [casid.Experiment(record, {}, "p"), casid.Experiment(lag_record(1), {}, "q")]
    c = PredictionError(lag_model(), both, LAG_NOISE, own=["a"], start={"a": 2.0, "x(0)@q": 0.3})
    single = PredictionError(lag_model(), both, LAG_NOISE, own="a")
    assert single.names == c.names
    starts = dict(zip(c.names, c.start, strict=True))
    assert (starts["a@p"], starts["a@q"], starts["x(0)@q"]) == (2.0, 2.0, 0.3)


def test_state_that_no_output_sees_is_named() -> None:
    """The cart's speed, unless it is measured: it never decays, and nothing depends on it."""
    model = walk_model()
    model.derivative(model.state("v", "m/s"), model.symbol("a"))
    with pytest.raises(ModelError, match=r"not detectable: the mode at z = 1 \(in v\).*leave the"):
        minimize_prediction_error(model, simulate(duration=5.0), WALK_NOISE[:3])


def test_continuous_noise_that_a_sensor_feels_at_once_is_refused() -> None:
    noise = [*WALK_NOISE[:3], White("torque", 0.05)]
    with pytest.raises(ModelError, match="accel responds to the noise of torque.*held=True"):
        minimize_prediction_error(walk_model(), simulate(duration=5.0), noise)


def test_what_cannot_be_told_apart_is_named_before_the_solver_starts() -> None:
    model = walk_model().with_unknown("I_xm")
    with pytest.raises(
        IdentifiabilityError, match="I_x and I_xm are not separately identifiable.*known"
    ):
        minimize_prediction_error(
            model, simulate(duration=10.0), WALK_NOISE[:3], start={"I_xm": 0.01}
        )


def test_records_that_cannot_be_used_are_refused() -> None:
    record = lag_record(0)
    gap = record.mark_missing("y", np.arange(record.N) == 17)
    with pytest.raises(DataError, match=r"misses samples, the first at t = 3.4 s.*interpolate"):
        fit_lag(gap)
    with pytest.raises(DataError, match="are too few for 5 unknowns.*widen the window"):
        fit_lag(record.between(0.0, 0.9))
    with pytest.raises(SolveError, match="outside its bounds.*move the start inside"):
        fit_lag(record, start={"a": -1.0})


def test_noise_that_is_no_list_is_refused_with_the_list() -> None:
    record = lag_record(0)
    sizes: Any = {"y": 0.3, "w": 1.0}
    with pytest.raises(
        ModelError, match=r"noise=\[White\('y', 0.3\), White\('w', 1.0\)\]"
    ) as error:
        fit_lag(record, sizes)
    mend = str(error.value).split("noise=")[1].split(", with the")[0]
    assert eval(mend, {"White": White}) == list(LAG_NOISE)
    for wrong in ("y", 0.3, [0.3, 1.0]):
        with pytest.raises(ModelError, match=r"give a list of White\(where, sd\)"):
            fit_lag(record, wrong)  # type: ignore[arg-type]


def test_problem_single_noise_and_named_solver_are_taken() -> None:
    """One output without process noise: the model, or its problem, and one White."""
    m = lag_model()
    m.substitute_symbol("w", ca.SX(0))
    del m.inputs["w"]
    record = lag_record(2, q=0.0)
    plain = minimize_prediction_error(m, record, [White("y", 0.3)])
    problem = casid.Problem(name="lag", model=m)
    found = minimize_prediction_error(problem, record, White("y", 0.3), solver="ipopt")
    np.testing.assert_array_equal(found.solution.x, plain.solution.x)
    with pytest.raises(SolveError, match=r"a float is no solver; give Solver\('ipopt'\)"):
        minimize_prediction_error(m, record, White("y", 0.3), solver=1.0)  # type: ignore[arg-type]


def test_an_experiment_that_is_not_there_is_refused_with_those_that_are() -> None:
    found = fit_lag(lag_record(0))
    for ask in (found.predictor, found.innovations):
        with pytest.raises(
            DataError, match=r"no experiment 3; give the number of one, 0 \(lag 0\)"
        ):
            ask(3)
    assert found.innovations(0).shape == (600, 1)
    assert found.predictor(0).K.shape == (1, 1)
    assert found.predictor().to_control().input_labels == ["u", "innovation y"]


def test_the_page_shows_the_starts_that_were_given() -> None:
    """The search begins at a common multiple of the variances, which is said beside them."""
    found = fit_lag(lag_record(0), [White("y", 3e-3), White("w", 1e-2)])
    for name, start in (("var(y)", 9e-6), ("psd(w)", 1e-4), ("a", 1.0)):
        row = found.parameter(name)
        assert row.start == pytest.approx(start)
        assert found[name] == row.value
        assert row.note.startswith("searched from") == ("(" in name)
    by = {v.name: v.start for v in found.criterion.variables}
    assert by["psd(w)"] / by["var(y)"] == pytest.approx(1e-4 / 9e-6)
    assert f"searched from {by['var(y)']:.2g}" in str(found)
    assert any("Ljung" in line for line in found.references())
    kept = fit_lag(lag_record(0), start={"var(y)": 0.2})
    assert not any(p.note for p in kept.estimate.parameters if not p.known)
    assert repr(found).startswith("<Prediction <Estimate lag: converged")
    assert "\n" not in repr(found)


def test_an_input_blended_of_both_holds_is_refused_by_name() -> None:
    model = lag_model()
    blended = hold(model, "u").extend(model)
    noise = [White("w", 0.5), White("y", 0.4)]
    with pytest.raises(
        ModelError, match=r"input u blends two holds .*declare the hold .*casid.identify"
    ):
        NoisyModel(blended, noise)
