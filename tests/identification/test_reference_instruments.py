"""Instruments of a declared reference where feedback biases least squares: a drive in a loop.

The truth is a difference equation of its own, with a load torque that nobody measures.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.errors import ModelError
from casid.estimation.errors_in_variables.removal import Corrected
from casid.identification.approach import approach

TRUTH = {"b": 0.03, "g": 1.0}


def model() -> casid.Model:
    m = casid.Model("drive")
    w = m.state("w", "rad/s")
    u = m.input("u", "N m", hold="zoh")
    J = m.constant("J", 0.02, "kg m^2")
    b = m.parameter("b", "N m s/rad", start=0.05, lower=0.0)
    g = m.parameter("g", "1", start=0.8, lower=0.1, upper=3.0)
    m.balance(w, "torque", inertia=J, terms=[g * u, -b * w])
    m.output("speed", w, "rad/s")
    return m


def record(seed: int, load_size: float = 0.06, N: int = 3000, Ts: float = 0.02) -> casid.Record:
    rng = np.random.default_rng(seed)
    ref = np.repeat(rng.choice([-10.0, 10.0], N // 50), 50)
    w = total = load = 0.0
    rows = []
    for r in ref:
        speed = w + 0.02 * rng.normal()
        total += Ts * (r - speed)
        u = 0.05 * (r - speed) + 0.2 * total
        rows.append((r, u, speed))
        load = 0.95 * load + load_size * rng.normal()
        grow = np.exp(-0.03 * Ts / 0.02)
        w = grow * w + (1 - grow) / 0.03 * (u + load)
    ref, u, speed = np.array(rows).T
    units = {"ref": "rad/s", "u": "N m", "speed": "rad/s"}
    return casid.Record({"ref": ref, "u": u, "speed": speed}, units, Ts)


def problem(**given) -> casid.Problem:
    return casid.Problem("drive", model(), recorded={"ref": "rad/s"}, starts=1, **given)


@pytest.mark.slow
def test_a_declared_reference_takes_the_place_of_least_squares_that_feedback_biases():
    z, plain = [], []
    for seed in range(8):
        estimate = casid.identify(problem(external="ref"), record(seed), hold_out=0.2)
        assert estimate.method == "instrumental variables from ref"
        assert estimate.evidence["instruments"].startswith("chosen")
        assert not any("follows the residual" in w for w in estimate.warnings)
        assert estimate.held_out.rmse
        rows = [estimate.parameter(name) for name in TRUTH]
        z.append([(p.value - t) / p.std_error for p, t in zip(rows, TRUTH.values(), strict=True)])
        if seed < 4:
            least = casid.identify(problem(), record(seed), intervals="quick")
            assert "not chosen" in least.evidence["instruments"]
            plain.append(least["g"] - TRUTH["g"])
    # The mean of 8 has an sd of 0.35, the mean square of 8 one of 0.5.
    assert np.all(np.abs(np.mean(z, axis=0)) < 3 * 0.35)
    assert np.all(np.mean(np.square(z), axis=0) < 1 + 3 * 0.5)
    assert np.mean(plain) < -0.1


def test_least_squares_stay_where_nothing_biases_them():
    estimate = casid.identify(problem(external="ref"), record(1, load_size=0.0))
    assert estimate.method.startswith("simulation error")
    assert estimate.evidence["instruments"].startswith("not needed")


def test_an_external_signal_is_one_that_is_recorded():
    with pytest.raises(ModelError, match="external signal 'reff' is neither recorded"):
        problem(external="reff")


def test_the_option_for_a_reference_is_quoted_as_a_shell_takes_it():
    run = record(1).rename({"ref": "set point [rad/s]"})
    beside = {"set point [rad/s]": "rad/s"}
    criterion = SimpleNamespace(experiments=[casid.Experiment(run)], segments=1)
    biased = Corrected(SimpleNamespace(criterion=criterion), why_not="it cannot be")
    stated = casid.Problem("drive", model(), recorded=beside)
    said = approach(stated, biased, 1, ())["instruments"]
    assert "--reference 'set point [rad/s]', or external='set point [rad/s]'" in said
