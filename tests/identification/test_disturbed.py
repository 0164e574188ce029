"""Disturbances with a place and a spectrum, estimated with the parameters: an own simulator."""

from __future__ import annotations

import json
import time
from functools import cache

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.linalg import expm, solve_discrete_are
from scipy.stats import chi2

import casid
from casid import time_limit
from casid.cli.main import main
from casid.estimation.prediction_error.disturbances import Disturbance, with_disturbances
from casid.estimation.prediction_error.likelihood import PredictionError
from casid.identification.identify import identify
from casid.linear.noisy_model import White

K, D, SIZE, PEAK, WIDTH, SENSOR = 4.0, 0.4, 0.5, 1.2, 0.1, 0.01
TRUTH = {
    "k": K,
    "d": D,
    "size of disturbance in force": SIZE,
    "peak of disturbance in force": PEAK,
    "width of disturbance in force": WIDTH,
}
TS = 0.1


def mass(offset=0.0):
    """A mass on a spring under a recorded force; its sensor may have an offset that is known."""
    m = casid.Model("mass")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh")
    k = m.parameter("k", "N/m", start=3.0, lower=0.1, upper=100)
    d = m.parameter("d", "N s/m", start=0.5, lower=0, upper=20)
    m.derivative(x, v)
    mass = m.parameter("m", "kg", value=1.0)
    m.balance(v, "force", inertia=mass, terms=[F, -k * (x - offset), -d * v], unit="N")
    m.output("x", x, "m")
    return casid.Problem("mass", m, noise={"F": 0.0}, starts=1)


def sampled():
    """x, v, force, its integral: transition, gain of a held force, covariance of a step.

    The covariance by van Loan's exponential.
    """
    A = np.zeros((4, 4))
    A[0, 1] = 1.0
    A[1] = [-K, -D, 1.0, 0.0]
    A[2] = [0.0, 0.0, -2 * WIDTH * PEAK, -(PEAK**2)]
    A[3, 2] = 1.0
    G = np.array([0.0, 0.0, np.sqrt(4 * WIDTH * PEAK) * SIZE, 0.0])
    both = expm(np.block([[-A, np.outer(G, G)], [np.zeros((4, 4)), A.T]]) * TS)
    transition = both[4:, 4:].T
    step = transition @ both[:4, 4:]
    B = np.array([[0.0], [1.0], [0.0], [0.0]])
    held = expm(np.block([[A, B], [np.zeros((1, 5))]]) * TS)[:4, 4]
    return transition, held, 0.5 * (step + step.T)


def record(seed, samples=1500, offset=0.0):
    """A sea on a mass that rests, in the stationary distribution of the force."""
    rng = np.random.default_rng(seed)
    transition, held, step = sampled()
    values, vectors = np.linalg.eigh(step)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    F = np.repeat(rng.standard_normal(samples // 20), 20)
    X = np.array([0.0, 0.0, SIZE * rng.standard_normal(), SIZE / PEAK * rng.standard_normal()])
    y = np.empty(samples)
    for t in range(samples):
        y[t] = X[0] + offset + SENSOR * rng.standard_normal()
        X = transition @ X + held * F[t] + root @ rng.standard_normal(4)
    return casid.Record({"F": F, "x": y}, {"F": "N", "x": "m"}, TS)


@cache
def estimate(seed):
    return identify(mass(), record(seed), disturbances="force:peak")


def test_parameters_size_and_peak_are_found_within_their_errors_over_seeds():
    """Normalised errors: their squares add to chi squared, here of 12 seeds for each parameter."""
    seeds = range(12)
    for name, truth in TRUTH.items():
        found = [estimate(s).parameter(name) for s in seeds]
        z = np.array([(p.value - truth) / p.std_error for p in found])
        low, high = chi2.ppf([0.001, 0.999], len(z))
        assert low < np.sum(z**2) < 1.3 * high, name  # of errors that are estimates themselves
        assert abs(np.mean(z)) < 3.3 / np.sqrt(len(z)), name


def test_the_estimate_says_what_it_rests_on():
    found = estimate(0)
    assert "disturbances in force (peak)" in found.method
    assert "innovations" in found.assumes
    assert found.parameter("peak of disturbance in force").unit == "rad/s"
    assert found.parameter("size of disturbance in force").unit == "N"
    assert np.sqrt(found["var(x)"]) == pytest.approx(SENSOR, rel=0.1)
    written = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert written["parameters"]["peak of disturbance in force"]["std_error"] > 0


def test_least_squares_is_less_certain_of_the_stiffness_in_a_sea():
    """The sea is what it cannot predict: its error of the stiffness is more than twice as large."""
    plain = identify(mass(), record(0))
    assert plain.parameter("k").std_error > 2 * estimate(0).parameter("k").std_error


@pytest.mark.parametrize(("place", "spectrum"), [("v", "peak"), ("force", "peak")])
def test_a_state_names_its_balance(place, spectrum):
    found = identify(mass(), record(0), disturbances=[Disturbance(place, spectrum)])
    assert found[f"peak of disturbance in {place}"] == pytest.approx(
        estimate(0)["peak of disturbance in force"], rel=1e-4
    )


def test_a_linear_model_that_rests_elsewhere_gives_the_same():
    found = identify(mass(offset=0.7), record(0, offset=0.7), disturbances="force:peak")
    for name in TRUTH:
        assert found[name] == pytest.approx(estimate(0)[name], rel=1e-3)


def test_the_likelihood_is_that_of_statsmodels_state_space():
    pytest.importorskip("statsmodels")
    from statsmodels.tsa.statespace.mlemodel import MLEModel

    data = record(0)
    model, sources = with_disturbances(mass().model, [Disturbance("force", "peak")])
    noise = [White("x", SENSOR), *sources]
    begin = dict(zip(model.states, (0.1, 0.0, 0.2, 0.3), strict=True))
    initial = {f"{name}(0)": value for name, value in begin.items()}
    criterion = PredictionError(
        model, [casid.Experiment(data, {}, "a")], noise, start={**TRUTH, **initial}
    )
    transition, held, step = sampled()
    C = np.array([[1.0, 0.0, 0.0, 0.0]])
    limit = solve_discrete_are(transition.T, C.T, step, [[SENSOR**2]])
    kalman = MLEModel(data["x"], k_states=4, k_posdef=4)
    kalman["transition"], kalman["design"], kalman["selection"] = transition, C, np.eye(4)
    kalman["state_cov"], kalman["obs_cov"] = step, np.array([[SENSOR**2]])
    kalman["state_intercept"] = held[:, None] * data["F"][None]
    order = ("x", "v", "disturbance in force", "integral of disturbance in force")
    start = np.array([begin[name] for name in order])
    kalman.ssm.initialize_known(start, limit)
    own = criterion.log_likelihood(criterion.start)
    assert own == pytest.approx(kalman.ssm.loglike(), abs=1e-5)


def test_a_model_that_is_not_linear_is_refused():
    m = casid.Model("pendulum")
    a, w = m.state("a", "rad"), m.state("w", "rad/s")
    k = m.parameter("k", "1/s^2", start=1.0)
    m.derivative(a, w)
    m.balance(w, "torque", inertia=1.0, terms=[-k * ca.sin(a)], unit="rad/s^2")
    m.output("a", a, "rad")
    free = casid.Record({"a": 0.1 * np.cos(0.1 * np.arange(200))}, {"a": "rad"}, 0.1)
    with pytest.raises(casid.ModelError, match="not linear in its states"):
        identify(casid.Problem("pendulum", m), free, disturbances="torque")


@pytest.mark.parametrize(
    ("given", "more", "what"),
    [
        ("forces:peak", {}, r"acts on nothing; did you mean 'force'"),
        ("force:peaks", {}, r"the spectrum is one of white, first, peak; did you mean 'peak'"),
        (["force", "v"], {}, "stated twice"),
        ("force", {"hold_out": 0.3}, r"hold_out \(--hold-out\) is not done with disturbances"),
        ("force", {"intervals": "profile"}, "is not done with disturbances"),
    ],
)
def test_what_means_nothing_is_refused(given, more, what):
    with pytest.raises(casid.CasidError, match=what):
        identify(mass(), record(0), disturbances=given, **more)


def test_a_search_that_the_budget_cuts_off_claims_nothing(monkeypatch):
    class Clock:
        ahead = 0.0

        def monotonic(self) -> float:
            return time.monotonic() + self.ahead

        def process_time(self) -> float:
            return time.process_time()

    clock = Clock()
    monkeypatch.setattr(time_limit, "time", clock)

    def progress(line: str) -> None:
        if line.startswith("minimise"):
            clock.ahead = 1e6

    data = record(0)
    found = identify(mass(), data, disturbances="force:peak", progress=progress)
    assert not found.is_converged
    assert found.not_done
    assert all(p.std_error is None for p in found.parameters)


def test_the_command_takes_a_disturbance(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mass.py").write_text(
        "from tests.identification.test_disturbed import mass\n\nproblem = mass()\n"
    )
    data = record(0)
    columns = np.column_stack([data.t, data["F"], data["x"]])
    np.savetxt("run.csv", columns, delimiter=",", header="t,F,x", comments="")
    arguments = ["identify", "mass.py", "run.csv", "--disturbance", "force:peak", "--out", "o"]
    run = CliRunner().invoke(main, arguments)
    assert run.exit_code == 0, run.output
    written = json.loads((tmp_path / "o" / "estimate.json").read_text())
    assert written["parameters"]["peak of disturbance in force"]["value"] == pytest.approx(
        estimate(0)["peak of disturbance in force"], rel=1e-3
    )
