"""Several outputs of one record, outliers, and constraints that nothing satisfies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import casid
from casid.estimation.moments.equations.robust_weights import huber
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.identification.moment_estimators import instrumental_variables

TS = 0.05
TRUTH = {"k1": 40.0, "k2": 25.0, "d": 1.5}


def chain() -> casid.Model:
    """Two masses of 1 kg and 2 kg on springs; the force on the first is the reference."""
    m = casid.Model("two masses")
    x1, v1 = m.state("x1", "m"), m.state("v1", "m/s")
    x2, v2 = m.state("x2", "m"), m.state("v2", "m/s")
    F = m.input("F", "N")
    k1 = m.parameter("k1", "N/m", start=30.0, lower=1.0, upper=200.0)
    k2 = m.parameter("k2", "N/m", start=30.0, lower=1.0, upper=200.0)
    d = m.parameter("d", "N s/m", start=1.0, lower=0.0, upper=20.0)
    m.derivative(x1, v1)
    m.derivative(x2, v2)
    m.balance(v1, "first", inertia=1.0, terms=[-k1 * x1, -d * v1, k2 * (x2 - x1), F])
    m.balance(v2, "second", inertia=2.0, terms=[-d * v2, k2 * (x1 - x2)])
    m.output("p1", x1, "m")
    m.output("p2", x2, "m")
    return m


def record(seed: int, N: int = 8000, noise: tuple[float, float] = (1e-3, 4e-3)) -> casid.Record:
    """The bilinear image of the chain by its own state space: nothing but noise is wrong."""
    k1, k2, d = TRUTH["k1"], TRUTH["k2"], TRUTH["d"]
    A = np.array(
        [
            [0, 1, 0, 0],
            [-(k1 + k2), -d, k2, 0],
            [0, 0, 0, 1],
            [k2 / 2, 0, -k2 / 2, -d / 2],
        ]
    )
    left = np.eye(4) - TS / 2 * A
    Ad = np.linalg.solve(left, np.eye(4) + TS / 2 * A)
    Bd = np.linalg.solve(left, TS / 2 * np.array([0.0, 1.0, 0.0, 0.0]))
    rng = np.random.default_rng(seed)
    F = lfilter([1.0], [1.0, -0.6], rng.standard_normal(N))
    x, out = np.zeros(4), np.zeros((N, 2))
    before = 0.0
    for t in range(N):
        x = Ad @ x + Bd * (F[t] + before)
        before = F[t]
        out[t] = x[0], x[2]
    sensed = out + np.array(noise) * rng.standard_normal((N, 2))
    return casid.Record(
        {"p1": sensed[:, 0], "p2": sensed[:, 1], "F": F},
        {"p1": "m", "p2": "m", "F": "N"},
        Ts=TS,
    )


INSTRUMENTS = Instruments({"F": "F"}, n_delta=0, n_y=5, n_u=0)


@pytest.mark.slow
def test_two_outputs_tell_more_than_either_and_their_errors_cover() -> None:
    """Each output its own equation and noise level. 40 runs: 38 inside on average, sd 1.4; four
    of them allowed."""
    model = chain()
    inside = dict.fromkeys(TRUTH, 0)
    errors = {"both": [], "first": [], "second": []}
    for seed in range(40):
        e = casid.Experiment(record(seed), {}, "run")
        both = instrumental_variables(model, e, INSTRUMENTS, settings=MomentSettings(iterations=2))
        for name, value in TRUTH.items():
            inside[name] += abs(both[name] - value) < 1.96 * both.std_error(name)
        if seed < 4:
            for key, outputs in (("both", None), ("first", ["p1"]), ("second", ["p2"])):
                settings = MomentSettings(iterations=2, outputs=outputs, weighting="optimal")
                found = instrumental_variables(model, e, INSTRUMENTS, settings=settings)
                errors[key].append(found.std_error("k2"))
    assert all(count >= 32 for count in inside.values()), inside
    assert np.mean(errors["both"]) < min(np.mean(errors["first"]), np.mean(errors["second"]))


def test_outliers_are_clipped_by_alpha() -> None:
    """(2.41) with Huber's alpha: one sample in two hundred is off by 0.1 m."""
    r = record(3)
    rng = np.random.default_rng(1)
    p1 = np.array(r["p1"])
    p1[rng.integers(0, r.N, r.N // 200)] += 0.1
    hurt = casid.Experiment(r.with_channel("p1", p1, "m"), {}, "hurt")
    found = {}
    for name, alpha in (("plain", None), ("robust", huber())):
        settings = MomentSettings(alpha=alpha, iterations=2, outputs=["p1"])
        e = instrumental_variables(chain(), hurt, INSTRUMENTS, settings=settings)
        found[name] = sum(abs(e[n] / value - 1) for n, value in TRUTH.items())
    assert found["robust"] < found["plain"]


@pytest.mark.parametrize("form", ["eliminated", "lifted"])
def test_a_constraint_that_no_parameter_satisfies_is_named(form: str) -> None:
    e = casid.Experiment(record(4), {}, "run")
    settings = MomentSettings(form=form, constraints=[lambda p: p["k1"] + p["k2"] + 5.0])
    with pytest.raises(casid.SolveError, match="constraint"):
        instrumental_variables(chain(), e, INSTRUMENTS, settings=settings)


def test_an_input_that_nothing_external_drives_is_refused() -> None:
    e = casid.Experiment(record(5), {}, "run")
    with pytest.raises(casid.ModelError, match="known=True"):
        instrumental_variables(chain(), e, Instruments({}))


def test_the_lag_settings_stay_what_they_are() -> None:
    assert replace(INSTRUMENTS, n_y=3).n_y == 3
    with pytest.raises(casid.ModelError, match="all 0"):
        replace(INSTRUMENTS, n_y=0)


def test_instruments_that_the_system_does_not_follow_are_refused_by_parameter() -> None:
    """A reference drawn apart from the record: correlated with nothing in it."""
    r = record(6)
    apart = r.with_channel("other", np.random.default_rng(9).standard_normal(r.N), "N")
    e = casid.Experiment(apart, {}, "run")
    with pytest.raises(casid.IdentifiabilityError) as refusal:
        instrumental_variables(chain(), e, Instruments({"F": "other"}))
    text = str(refusal.value)
    assert "rank" in text
    assert any(name in text for name in TRUTH)
    assert "reference that drives the system" in text


def test_too_few_lags_are_refused_by_parameter() -> None:
    e = casid.Experiment(record(7), {}, "run")
    few = Instruments({"F": "F"}, initial="reference", n_delta0=2, n_y=1, n_delta=0, n_u=0)
    with pytest.raises(casid.IdentifiabilityError, match="more lags"):
        instrumental_variables(chain(), e, few, settings=MomentSettings(outputs=["p2"]))
