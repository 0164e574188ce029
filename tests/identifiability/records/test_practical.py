"""Expected errors are those of theory, for the user's excitation and before any fit."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import casid
from casid.errors import DataError, IdentifiabilityError, ModelError
from casid.identifiability.records.planned_experiment import plan
from casid.identifiability.records.practical import practical_identifiability
from tests.support.excited_models import TS, decay, inputs, integrator, regressor


def test_the_information_of_a_model_linear_in_its_parameters_is_phi_transposed_phi():
    """F = Phi'Phi / sigma^2, at any value of the parameters (Ljung 1999, section 9.4)."""
    record, sigma = inputs(), 0.3
    r = practical_identifiability(integrator(), record, noise={"y": sigma})
    Phi = regressor(record)
    F = Phi.T @ Phi / sigma**2
    np.testing.assert_allclose(r.fisher_information, F, rtol=1e-10)
    np.testing.assert_allclose(r.covariance, np.linalg.inv(F), rtol=1e-9)
    assert r.names == ("a", "b")
    assert r["a"].std_error == pytest.approx(np.sqrt(np.linalg.inv(F)[0, 0]), rel=1e-9)
    assert r["b"].relative == pytest.approx(r["b"].std_error / 3.0)
    other = practical_identifiability(
        integrator(), record, noise={"y": sigma}, at={"a": 70.0, "b": 0.1}
    )
    np.testing.assert_allclose(other.fisher_information, F, rtol=1e-10)


def test_information_of_records_adds_up():
    both = [inputs(seed=1, name="one"), inputs(seed=2, name="two")]
    r = practical_identifiability(integrator(), both, noise={"y": 1.0})
    parts = [
        practical_identifiability(integrator(), e, noise={"y": 1.0}).fisher_information
        for e in both
    ]
    np.testing.assert_allclose(r.fisher_information, sum(parts), rtol=1e-10)


def test_an_exponential_has_the_standard_errors_of_its_closed_form():
    """y = g exp(-p t): sensitivities exp(-p t) and -g t exp(-p t)."""
    model, record = decay(T=6.0)
    r = practical_identifiability(model, record, noise={"y": 0.05})
    t = record.t
    S = np.column_stack([-2.0 * t * np.exp(-0.5 * t), np.exp(-0.5 * t)])
    P = 0.05**2 * np.linalg.inv(S.T @ S)
    # RK4 with step Ts: (p Ts)^4 / 120 = 5e-8 a step
    np.testing.assert_allclose(r.covariance, P, rtol=1e-5)
    corr = P[0, 1] / np.sqrt(P[0, 0] * P[1, 1])
    assert r["p"].correlation == pytest.approx(corr, rel=1e-5)
    assert r["p"].partner == "g1"


@pytest.mark.slow
def test_expected_errors_are_the_spread_of_repeated_estimates():
    """Cramer-Rao is reached in the limit; p and g are nearly linear at 2 % noise."""
    model, record = decay(T=6.0)
    r = practical_identifiability(model, record, noise={"y": 0.02})
    rng, runs, found = np.random.default_rng(5), 80, []
    clean = 2.0 * np.exp(-0.5 * record.t)
    for _ in range(runs):
        noisy = record.with_channel("y", clean + 0.02 * rng.standard_normal(record.N), "m")
        e = casid.identify(model, noisy, settings=casid.FitSettings(starts=1, substeps=1))
        found.append([e["p"], e["g1"]])
    spread = np.std(found, axis=0, ddof=1)
    # a sample standard deviation has relative error 1 / sqrt(2 (runs - 1)) = 0.08: four of them
    for name, s in zip(("p", "g1"), spread, strict=True):
        assert s == pytest.approx(r[name].std_error, rel=4 / np.sqrt(2 * (runs - 1)))


@settings(max_examples=15)
@given(st.floats(-6, 6), st.floats(-6, 6), st.floats(-6, 6))
def test_verdicts_do_not_hang_on_units(a, b, u):
    """Other units of a, b and the inputs change values and errors, and no verdict."""
    record = inputs(N=60, w=0.01)
    base = practical_identifiability(integrator(), record, noise={"y": 1.0})
    sa, sb, su = 10.0**a, 10.0**b, 10.0**u
    m = casid.Model("scaled")
    x = m.state("x", "m", initial=0.0)
    m.input("u", "m/s", hold="zoh", known=True)
    m.input("w", "m/s", hold="zoh", known=True)
    pa, pb = m.parameter("a", "1", start=2.0 * sa), m.parameter("b", "1", start=-3.0 * sb)
    m.derivative(x, (pa / sa * m.symbol("u") + pb / sb * m.symbol("w")) / su)
    m.output("y", x, "m")
    scaled = casid.Record(
        {"u": su * record["u"], "w": su * record["w"]}, record.units, Ts=TS, name="r"
    )
    r = practical_identifiability(m, scaled, noise={"y": 1.0})
    assert base["a"].verdict == "well determined"
    assert base["b"].verdict == "poorly determined"
    for name in ("a", "b"):
        assert r[name].verdict == base[name].verdict
        assert r[name].relative == pytest.approx(base[name].relative, rel=1e-6)
    assert r.condition == pytest.approx(base.condition, rel=1e-6)
    np.testing.assert_allclose(r.singular_values, base.singular_values, rtol=1e-6)


def test_what_no_data_will_tell_is_not_seen_and_the_combination_is_named():
    """y = g1 g2 x: only the product is there (the force-mass ambiguity of Linder 2017, 7.1)."""
    model, record = decay(gains=2)
    r = practical_identifiability(model, record, noise={"y": 1e-6})
    for name in ("g1", "g2"):
        assert r[name].verdict == "not seen by this record"
        assert r[name].std_error == np.inf
    assert r["g1"].note == "only in combination with g2"
    assert r["p"].verdict == "well determined"
    assert (r.rank, r.unknowns) == (2, 3)
    assert r.condition == np.inf
    assert r.weakest[0].error == np.inf
    assert r.weakest[0].moves["g1"] == pytest.approx(-r.weakest[0].moves["g2"], rel=1e-6)
    assert "g1 g2" in r.undetermined
    # the rest is as if one of the two were known
    known = practical_identifiability(model.with_known(g2=2.0), record, noise={"y": 1e-6})
    assert r["p"].std_error == pytest.approx(known["p"].std_error, rel=1e-6)


def test_what_structure_allows_and_a_short_record_does_not_is_poorly_determined():
    """Over 0.4 s an exponential of 2 s has hardly bent: its two parameters are told badly."""
    noise = {"y": 0.2}
    long = practical_identifiability(*decay(T=20.0), noise=noise)
    short = practical_identifiability(*decay(T=0.4), noise=noise)
    assert long["p"].verdict == "well determined"
    assert short["p"].verdict == "poorly determined"
    assert short.rank == short.unknowns == 2
    assert "% of its size" in short["p"].note
    # and it is the noise that decides
    quiet = practical_identifiability(*decay(T=0.4), noise={"y": 1e-4})
    assert quiet["p"].verdict == "well determined"


def test_a_parameter_of_an_input_at_rest_moves_no_output():
    r = practical_identifiability(integrator(), inputs(w=0.0), noise={"y": 0.1})
    assert r["b"].verdict == "not seen by this record"
    assert r["b"].note == "moves no output"
    assert r["a"].verdict == "well determined"
    assert "record an experiment that excites it" in r.undetermined


def test_singular_values_are_one_over_relative_errors_with_initial_states_eliminated():
    """The weakest direction has the largest error, and the others follow in order."""
    m = integrator()
    m.states["x"] = casid.model.declarations.State("x", "m")  # its start is unknown now
    record = inputs()
    r = practical_identifiability(m, record, noise={"y": 0.2})
    Phi, one = regressor(record) * [2.0, 3.0] / 0.2, np.ones((record.N, 1))
    free = Phi - one @ (one.T @ Phi) / record.N  # the initial state is an offset
    s = np.linalg.svd(free, compute_uv=False)
    np.testing.assert_allclose(r.singular_values, s, rtol=1e-9)
    assert [d.error for d in r.weakest] == pytest.approx((1 / s[::-1]).tolist())
    assert r.condition == pytest.approx(s[0] / s[-1])
    assert r["x(0)"].is_state
    assert r.rows[-1].name == "x(0)"


def test_an_initial_state_is_judged_against_the_motion_and_not_against_its_own_zero():
    """A start at rest is no small number: what counts is how far the state moves later."""
    m = integrator()
    m.states["x"] = casid.model.declarations.State("x", "m")
    r = practical_identifiability(m, inputs(), noise={"y": 0.2})["x(0)"]
    motion = np.sqrt(np.mean((regressor(inputs()) @ [2.0, -3.0]) ** 2))
    assert (r.value, r.verdict) == (0.0, "well determined")
    assert r.relative == pytest.approx(r.std_error / motion, rel=1e-9)


def test_without_a_noise_level_errors_are_relative_to_each_other():
    r = practical_identifiability(integrator(), inputs())
    absolute = practical_identifiability(integrator(), inputs(), noise={"y": 0.1})
    assert not r.noise.is_absolute
    assert r["a"].verdict == "seen, not judged"
    assert "noise={output: standard deviation}" in str(r)
    ratio = r["a"].std_error / r["b"].std_error
    assert ratio == pytest.approx(absolute["a"].std_error / absolute["b"].std_error)
    assert absolute["a"].std_error == pytest.approx(0.1 * r["a"].std_error)


def test_the_noise_is_taken_from_the_caller_then_the_problem_then_the_record():
    record = inputs(N=4000)
    model = integrator()
    y = regressor(record) @ [2.0, -3.0]
    rng = np.random.default_rng(8)
    measured = record.with_channel("y", y + 0.5 * rng.standard_normal(record.N), "m")
    problem = casid.Problem("integrator", model, noise={"y": 0.4})
    assert plan(problem, measured, noise={"y": 0.3}).noise.sd["y"] == 0.3
    assert plan(problem, measured).noise.sd["y"] == 0.4
    at_truth = plan(model, measured, at={"a": 2.0, "b": -3.0}).noise
    # a sample standard deviation of 4000: relative error 1.1 %
    assert at_truth.sd["y"] == pytest.approx(0.5, rel=0.045)
    assert "residual" in at_truth.source["y"]
    # the quietest fifth of a spectrum, under what the signal leaves there: a rough figure
    assert plan(model, measured).noise.sd["y"] == pytest.approx(0.5, rel=0.2)


def test_the_noise_stands_in_the_unit_of_its_output():
    """Given and shown in the output's declared unit, whatever the unit of the computation."""
    m = casid.Model("turn")
    phi = m.state("phi", "deg", initial=0.0)
    u = m.input("u", "deg/s", hold="zoh", known=True)
    m.derivative(phi, m.parameter("a", "1", start=1.0) * u)
    m.output("y", phi, "deg")
    u = np.random.default_rng(3).standard_normal(100)
    record = casid.Record({"u": u}, {"u": "rad/s"}, Ts=TS)
    found = practical_identifiability(m, record, noise={"y": 0.5})
    assert found.noise.sd["y"] == pytest.approx(np.deg2rad(0.5))
    assert "y 0.5 deg (as given)" in str(found)


def test_an_estimate_may_be_looked_at():
    record, model = inputs(N=4000), integrator()
    rng = np.random.default_rng(2)
    y = regressor(record) @ [2.5, -1.0] + 0.5 * rng.standard_normal(record.N)
    record = record.with_channel("y", y, "m")
    e = casid.identify(model, record)
    r = practical_identifiability(model, record, at=e)
    assert r["a"].value == e["a"]
    # white residuals: the sandwich and the information agree but for what its lags let in, a
    # share of sqrt(lags / N) of a variance, and random-walk regressors weigh few samples most
    assert r["a"].std_error == pytest.approx(e.parameter("a").std_error, rel=0.25)


def test_the_result_is_plain_json_and_says_what_its_errors_assume():
    r = practical_identifiability(*decay(gains=2), noise={"y": 0.1})
    content = json.loads(json.dumps(r.to_json(), allow_nan=False))
    assert content["schema"] == "casid.practical/1"
    assert content["rows"][1]["verdict"] == "not seen by this record"
    assert content["rows"][1]["std_error"] is None
    assert "The error bars assume white Gaussian noise" in str(r)
    assert repr(r) == "<Practical decay: rank 2 of 3; not seen: g1, g2>"


def test_refusals_say_what_to_do():
    model, record = decay()
    with pytest.raises(ModelError, match="has no 'q' to give a value; it has p"):
        practical_identifiability(model, record, at={"q": 1.0})
    with pytest.raises(DataError, match="no such output; it has y"):
        practical_identifiability(model, record, noise={"z": 1.0})
    with pytest.raises(DataError, match="give a positive standard deviation in m"):
        practical_identifiability(model, record, noise={"y": 0.0})
    with pytest.raises(IdentifiabilityError, match=r"free one with model\.with_unknown"):
        practical_identifiability(model.with_known(p=1.0, g1=1.0), record)
    with pytest.raises(DataError, match="no channel 'u'"):
        practical_identifiability(integrator(), record)
