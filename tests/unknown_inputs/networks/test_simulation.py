"""A network simulated with signals of one's own."""

from __future__ import annotations

import numpy as np
import pytest

from casid.algebra.rational import Rational
from casid.errors import DataError
from casid.unknown_inputs.networks.network import dynamic_network
from casid.unknown_inputs.networks.simulation import simulate_network

Q = Rational.shift(Ts=0.5)
NETWORK = dynamic_network(
    {("y", "r"): 0.4 / (Q - 0.6), ("r", "y"): -0.3 / Q}, excitations=("r",), name="loop"
)
QUIET = dynamic_network(NETWORK.modules, excitations=("r",), disturbances=())


def test_a_reference_of_ones_own_drives_the_network_from_rest_by_its_difference_equations():
    """y+ = 0.6 y + 0.4 r, r = delta - 0.3 y-, settle = 0."""
    rng = np.random.default_rng(4)
    delta = rng.choice([-1.0, 1.0], 50)
    record = simulate_network(QUIET, 50, settle=0, excitations={"r": delta})
    y, r = np.zeros(50), np.zeros(50)
    for t in range(50):
        y[t] = 0.6 * y[t - 1] + 0.4 * r[t - 1] if t else 0.0
        r[t] = delta[t] - (0.3 * y[t - 1] if t else 0.0)
    np.testing.assert_allclose(record["y"], y, atol=1e-13)
    np.testing.assert_allclose(record["r"], r, atol=1e-13)
    np.testing.assert_array_equal(record["delta_r"], delta)


def test_a_network_settles_on_the_periodic_continuation_of_the_reference():
    """So that the response is periodic: at every frequency of the record Y = G_closed Delta."""
    delta = np.sign(np.sin(np.arange(64.0) ** 2))
    record = simulate_network(QUIET, 64, excitations={"r": delta})
    z = np.exp(2j * np.pi * np.arange(64) / 64)
    g = 0.4 / (z - 0.6)
    closed = g / (1 + 0.3 * g / z)
    got = np.fft.fft(record["y"])
    np.testing.assert_allclose(got, closed * np.fft.fft(delta), atol=1e-6 * np.abs(got).max())


def test_other_signals_are_drawn_as_without_it_and_add_up():
    """Linear: what the given reference adds to the drawn rest is its own response."""
    rest = dynamic_network(NETWORK.modules, excitations=(), name="loop")
    delta = np.sin(np.arange(40.0))
    with_it = simulate_network(rest, 40, seed=3, excitations={"r": delta})
    without = simulate_network(rest, 40, seed=3)
    alone = simulate_network(QUIET, 40, excitations={"r": delta})
    np.testing.assert_array_equal(with_it["tau_y"], without["tau_y"])
    np.testing.assert_allclose(with_it["y"] - without["y"], alone["y"], atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (({"r": np.ones(9)},), "N is a dict; .* as excitations={node: .N,. array}"),
        ((0,), "N is 0; give a number of samples >= 1"),
        ((9, {"r": np.ones(8)}), r"of r has the shape \(8,\), N = 9; give \(9,\) .* or N = 8"),
        ((9, {"x": np.ones(9)}), "names 'x', which is no node of loop; choose among 'r', 'y'"),
        ((9, {"r": np.full(9, np.nan)}), "of r is not finite at k = 0; cut or fill it there"),
        ((9, np.ones(9)), "excitations is a ndarray; give a mapping {node: .N,. array}"),
    ],
)
def test_signals_that_do_not_fit_are_refused_with_the_mend(arguments, match):
    N, *given = arguments
    with pytest.raises(DataError, match=match):
        simulate_network(NETWORK, N, excitations=given[0] if given else None)


def test_settling_is_a_number_of_samples():
    with pytest.raises(DataError, match="settle is -1; give a number of samples >= 0"):
        simulate_network(NETWORK, 9, settle=-1)
