"""The signals of a dynamic network: exact error variances, and what its modules' estimates do."""

from __future__ import annotations

import numpy as np
import pytest

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.estimation.prediction_error.polynomial.orders import Orders
from casid.unknown_inputs.limits.module_remedies import compare_module_remedies
from casid.unknown_inputs.limits.network_signals import network_signals
from casid.unknown_inputs.limits.prediction_limit import prediction_error_limit
from casid.unknown_inputs.limits.regression import Regression, arx, lags
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.limits.second_moments import second_moments
from casid.unknown_inputs.networks.network import dynamic_network
from problems.network8 import TABLE_6_1, network

SIGNALS = network_signals(network)
G = network.module


def variance_of(terms: dict[str, object]) -> float:
    """Of a sum of filtered nodes."""
    system = SIGNALS.with_signals({"error": terms})
    return float(second_moments(system, [("error", 0, False)]).second[0, 0])


def test_the_error_variances_of_example_6_1_are_moments_of_the_network() -> None:
    """(3.24) 27.597 and the indirect row (4.31) 2.515, from the published modules."""
    D = 1 - G(2, 5) * G(5, 2)
    immersed = {"w2": 1.0, "w1": -G(2, 1) / D, "w3": -G(2, 3) / D}
    assert variance_of(immersed) == pytest.approx(27.597, abs=5e-4)
    ratio = G(2, 5) / G(4, 5)
    indirect = {"w2": 1.0, "w1": -(G(2, 1) - ratio * G(4, 1)), "w3": -G(2, 3), "w4": -ratio}
    assert variance_of(indirect) == pytest.approx(2.515, abs=5e-4)


def test_a_module_without_confounder_is_found_by_prediction_error() -> None:
    """w3 = G36 w6 + tau3: open loop, white noise."""
    b, a = TABLE_6_1[3, 6]
    truth = {"b1[w6]": b, "f1[w6]": -a}
    found = prediction_error_limit(SIGNALS, "w3", ["w6"], Orders(nb=1, nf=1), truth)
    for name in truth:
        assert found.bias(name) == pytest.approx(0, abs=1e-9)
    assert found.residual_variance == pytest.approx(1.0)


def test_an_external_reference_is_an_instrument_and_costs_variance() -> None:
    """delta6 reaches w6, and tau3 does not: consistent, but tau6's excitation is wasted."""
    b, a = TABLE_6_1[3, 6]
    regression = Regression("w3", arx("w3", ["w6"], 1, 1), lags("delta w6", 1, 6))
    found = regression_limit(SIGNALS, regression, {"a1": -a, "b1[w6]": b})
    assert found.bias("b1[w6]") == pytest.approx(0, abs=1e-12)
    assert found.bias("a1") == pytest.approx(0, abs=1e-12)
    direct = prediction_error_limit(SIGNALS, "w3", ["w6"], Orders(nb=1, nf=1))
    assert found.variance("b1[w6]") > 2 * direct.variance("b1[w6]")


@pytest.mark.slow
def test_neglecting_a_node_of_the_network_biases_the_modules_beside_it() -> None:
    """w5 feeds w2 and has its part in what drives w1: the direct estimate of G21 is biased."""
    inputs = ["w1", "w3", "w5"]
    truth = {}
    for k in (1, 3, 5):
        b, a = TABLE_6_1[2, k]
        truth |= {f"b1[w{k}]": b, f"f1[w{k}]": -a}
    compared = compare_module_remedies(
        SIGNALS, "w2", inputs, "w5", Orders(nb=1, nf=1), truth, N=10_000
    )
    for name in truth:
        assert compared["all inputs known, PEM"].bias(name) == pytest.approx(0, abs=1e-7)
    neglected = compared["neglect, PEM"]
    assert abs(neglected.bias("b1[w1]")) > 5 * neglected.std_error("b1[w1]", 10_000)
    assert "cannot be had while w5 is neglected" in compared.cost_of_neglecting("b1[w5]")


def test_sensor_noise_is_a_signal_of_its_own() -> None:
    q = Rational.shift(0.5)
    small = dynamic_network({(2, 1): 0.5 / (q - 0.2)}, sensor_noise={1: 0.3})
    system = network_signals(small)
    assert system.Ts == 0.5
    assert system.externals == ("tau w1", "tau w2", "noise w1")
    known = regression_limit(system, Regression("w2", {"b": ("w1", 1)}))
    noisy = regression_limit(system, Regression("w2", {"b": ("measured w1", 1)}))
    assert noisy["b"] == pytest.approx(known["b"] / 1.3)  # attenuation 1/(1 + 0.3)


def test_a_network_that_has_no_stationary_signals_is_refused() -> None:
    q = Rational.shift(1.0)
    loop = dynamic_network({(1, 2): 1.5 / q, (2, 1): 1 / q})
    with pytest.raises(ModelError, match="not stable.*lower a loop gain"):
        network_signals(loop)
    s = Rational.derivative()
    with pytest.raises(ModelError, match="of continuous time.*give its modules in q"):
        network_signals(dynamic_network({(2, 1): 1 / (s + 1)}))
    np.testing.assert_equal(len(SIGNALS.externals), 9)


def test_a_noise_model_that_the_known_inputs_do_not_need_is_made_smaller() -> None:
    """With every input known the noise is white: C and D would cancel, and a note says so."""
    q = Rational.shift(1.0)
    small = dynamic_network({(3, 1): 0.5 / q, (3, 2): 0.4 / (q - 0.6)}, disturbances=[1, 2, 3])
    truth = {"b1[w1]": 0.5}
    compared = compare_module_remedies(
        network_signals(small), "w3", ["w1", "w2"], "w2",
        Orders(nb=1, nf={"w1": 0, "w2": 1}, nc=1, nd=1), truth,
    )  # fmt: skip
    known, neglected = (compared[n] for n in ("all inputs known, PEM", "neglect, PEM"))
    assert known.notes == ("the noise is simpler than specified: nc = 0, nd = 0",)
    assert not any("simpler" in note for note in neglected.notes)
    assert neglected["d1"] == pytest.approx(-0.6, abs=1e-6)  # w2's memory is the noise model's now
    assert neglected.bias("b1[w1]") == pytest.approx(0, abs=1e-7)
    assert neglected.variance("b1[w1]") > known.variance("b1[w1]")
