"""Predictors of a network node: exact errors, noise models, and the errors-in-variables filter."""

from __future__ import annotations

import numpy as np
import pytest

from casid.algebra.rational import Rational
from casid.errors import DataError, ModelError
from casid.unknown_inputs.networks.dynamics import network_states
from casid.unknown_inputs.networks.network import Signal, dynamic_network
from casid.unknown_inputs.networks.node_sets import node_sets
from casid.unknown_inputs.networks.prediction.eiv_filter import eiv_filter
from casid.unknown_inputs.networks.prediction.error_variance import spectrum, variance
from casid.unknown_inputs.networks.prediction.predictors import (
    ALL_INPUTS,
    IMMERSED,
    IMMERSED_ALL,
    INDIRECT,
    NEGLECT,
    compare_predictors,
)
from casid.unknown_inputs.networks.prediction.row_predictor import row_predictor
from casid.unknown_inputs.networks.simulation import filtered, simulate_network
from problems.network8 import TABLE_6_1, network, simulate

Q = Rational.shift(Ts=1.0)


@pytest.fixture(scope="module")
def table():
    return compare_predictors(network, 2)


@pytest.fixture(scope="module")
def without():
    return compare_predictors(network, 2, use_excitations=False)


# -- Example 6.1 -----------------------------------------------------------------------------------


def test_example_6_1_spectral_radius():
    radius = np.max(np.abs(np.linalg.eigvals(network_states(network).A)))
    assert radius == pytest.approx(0.9535, abs=5e-5)


def test_example_6_1_error_variances(table, without):
    """(3.24) 27.597, (3.41) 2.304 with delta_6 and 2.532 without, (4.31) 2.515."""
    assert without[IMMERSED].variance == pytest.approx(27.597, abs=5e-4)
    assert table[IMMERSED_ALL].variance == pytest.approx(2.304, abs=5e-4)
    assert without[IMMERSED_ALL].variance == pytest.approx(2.532, abs=5e-4)
    assert table[INDIRECT].variance == pytest.approx(2.515, abs=5e-4)
    assert table[ALL_INPUTS].variance == pytest.approx(1.0, rel=1e-12)


def test_example_6_1_the_indirect_error_is_tau_2_and_filtered_tau_4(table):
    """1 + ||G25/G45||^2 var(tau_4), the norm of a first-order ratio in closed form."""
    (b25, a25), (b45, a45) = TABLE_6_1[2, 5], TABLE_6_1[4, 5]
    norm = (b25 / b45) ** 2 * (1 + (a25 - a45) ** 2 / (1 - a25**2))
    assert table[INDIRECT].variance == pytest.approx(1 + norm, rel=1e-10)
    assert set(table[INDIRECT].error) == {"tau_2", "tau_4"}


def test_example_6_1_fits_of_realisations(table, without):
    """27, 42, 82 and 81 %, all within three standard errors of their means over 40 realisations."""
    wanted = {
        (NEGLECT, False): (27.2, 4.3),
        (IMMERSED, False): (41.6, 3.4),
        (IMMERSED_ALL, False): (81.5, 3.2),
        (IMMERSED_ALL, True): (82.2, 3.5),
        (INDIRECT, True): (81.3, 3.5),
    }
    runs = [simulate(seed, 1300) for seed in range(40)]
    for (kind, uses), (mean, spread) in wanted.items():
        fits = [(table if uses else without)[kind].fit(r, skip=300) for r in runs]
        # Mean and spread are themselves of 200 realisations.
        assert abs(np.mean(fits) - mean) < 3 * spread * np.sqrt(1 / 40 + 1 / 200) + 0.05, kind


# -- errors of predictors --------------------------------------------------------------------------


def _first_order(a: float, b: float = 1.0) -> Rational:
    return b / (Q - a)


def test_the_variance_of_filtered_noise_is_its_closed_form():
    """E v^2 = sum_n lambda_n b_n^2 / (1 - a_n^2) of first-order filters."""
    filters = {"x": _first_order(0.5, 2.0), "y": _first_order(-0.9)}
    sources = {"x": Signal(3.0), "y": Signal(0.5)}
    wanted = 3 * 4 / (1 - 0.25) + 0.5 / (1 - 0.81)
    assert variance(filters, sources) == pytest.approx(wanted, rel=1e-12)


def test_an_unstable_filter_has_no_variance():
    assert variance({"x": _first_order(1.5)}, {"x": Signal()}) == np.inf
    assert variance({"x": _first_order(1.5)}, {"x": Signal(0.0)}) == 0.0


@pytest.mark.parametrize("kind", [NEGLECT, IMMERSED, IMMERSED_ALL, INDIRECT])
def test_the_predicted_variance_is_that_of_simulated_errors(table, kind):
    """Of a long record; its standard error from the autocovariance of the squared error."""
    record = simulate(5, 60_000)
    error = (record["w2"] - table[kind].predict(record))[1000:]
    r = np.array([np.mean(error[k:] * error[: len(error) - k]) for k in range(400)])
    spread = np.sqrt(2 * (r[0] ** 2 + 2 * np.sum(r[1:] ** 2)) / len(error))
    assert abs(np.mean(error**2) - table[kind].variance) < 3.5 * spread


@pytest.mark.parametrize("kind", [NEGLECT, IMMERSED, IMMERSED_ALL, INDIRECT])
def test_with_its_own_past_the_error_is_white_and_least(table, kind):
    """(6.5)-(6.6): the innovation is white, and no predictor beats knowing all inputs."""
    record = simulate(6, 20_000)
    p = table[kind]
    error = (record["w2"] - p.predict(record, whiten=True))[1000:]
    lagged = [np.mean(error[k:] * error[: len(error) - k]) / np.mean(error**2) for k in (1, 2, 5)]
    assert np.max(np.abs(lagged)) < 4 / np.sqrt(len(error))
    assert np.mean(error**2) == pytest.approx(p.whitened_variance, rel=5 / np.sqrt(len(error)))
    assert table[ALL_INPUTS].variance <= p.whitened_variance <= p.variance * (1 + 1e-12)


def test_the_spectral_factor_has_the_spectrum_of_the_error(table):
    """|H|^2 F = S at every frequency, and log F is the mean of log S (Kolmogorov-Szego)."""
    p = table[INDIRECT]
    omega = np.linspace(-np.pi, np.pi, 4001)[:-1]
    s = p.whitening.system
    z = np.exp(1j * omega)
    H = 1 + np.array(
        [(s.C @ np.linalg.solve(x * np.eye(s.nx) - s.A, p.whitening.K))[0, 0] for x in z]
    )
    S = spectrum(p.error, p.sources, omega)
    assert np.allclose(np.abs(H) ** 2 * p.whitening.F[0, 0], S, rtol=1e-9)
    assert np.mean(np.log(S)) == pytest.approx(np.log(p.whitened_variance), abs=1e-9)


def test_coloured_disturbances_and_noisy_sensors_are_counted():
    """w2 = g w1 + tau_2 read with a noisy w1: the error is tau_2 - g s_1, in closed form."""
    g = _first_order(0.6)
    net = dynamic_network(
        {(2, 1): g},
        disturbances={1: 1.0, 2: Signal(2.0, Q / (Q - 0.8))},
        sensor_noise={1: 0.3},
    )
    found = compare_predictors(net, 2)
    wanted = 2 / (1 - 0.64) + 0.3 / (1 - 0.36)
    assert found[IMMERSED].variance == pytest.approx(wanted, rel=1e-12)
    record = simulate_network(net, 40_000, seed=2)
    error = (record["w2"] - found[IMMERSED].predict(record))[200:]
    assert np.mean(error**2) == pytest.approx(wanted, rel=0.06)


def test_a_simulated_network_has_the_moments_of_its_equations():
    """The library's own simulation against the network's Lyapunov equation and the problem's."""
    states = network_states(network)
    from scipy.linalg import solve_discrete_lyapunov

    L = np.eye(8)
    L[5, 5] = 2.0  # delta_6 and tau_6
    P = solve_discrete_lyapunov(states.A, states.B @ L @ states.B.T)
    wanted = np.diag(states.C @ P @ states.C.T + states.D @ L @ states.D.T)
    for record in (simulate_network(network, 60_000, seed=3), simulate(3, 60_000)):
        got = np.array([np.var(record[f"w{i}"]) for i in range(1, 9)])
        # Correlation times of a mode of 0.954 leave some 60 000 / 40 independent samples.
        assert np.allclose(got, wanted, rtol=4 * np.sqrt(2 * 40 / 60_000))


# -- the errors-in-variables filter ----------------------------------------------------------------


@pytest.mark.slow
def test_eiv_filter_has_white_innovations_and_the_stated_error_variances():
    """(6.21): L_j - L_j^2/Le for w_j, L_I - (L_I D_I)^2/Le for w_I, unit variances."""
    f = eiv_filter(network, 2)
    Le = f.variance
    D_I = -float(np.asarray(f.direct)[0, 1])
    settled = f.noise_free_variances()
    assert settled[2] == pytest.approx(1 - 1 / Le, rel=1e-9)
    assert settled[4] == pytest.approx(1 - D_I**2 / Le, rel=1e-9)
    record = simulate(7, 30_000)
    out = f.run(record)
    eps = out.innovations[500:]
    assert np.mean(eps**2) == pytest.approx(Le, rel=5 * np.sqrt(2 / len(eps)))
    correlations = [np.mean(eps[k:] * eps[: len(eps) - k]) / Le for k in (1, 2, 3)]
    assert np.max(np.abs(correlations)) < 4 / np.sqrt(len(eps))
    for n in f.noisy:
        error = (out.noise_free[n] - (record[f"w{n}"] - record[f"tau_{n}"]))[500:]
        assert np.mean(error**2) == pytest.approx(settled[n], rel=5 * np.sqrt(2 / len(error)))
        assert out.std_errors[n][-1] ** 2 == pytest.approx(settled[n], rel=1e-9)


def test_eiv_filter_predicts_as_the_whitened_indirect_predictor(table):
    f = eiv_filter(network, 2)
    assert f.variance == pytest.approx(table[INDIRECT].whitened_variance, rel=1e-9)
    record = simulate(8, 3000)
    ours, theirs = f.run(record).prediction, table[INDIRECT].predict(record, whiten=True)
    assert np.allclose(ours[500:], theirs[500:], atol=1e-6)


def test_eiv_filter_of_coloured_noise_keeps_its_promise():
    """tau_3 is autoregressive: what is left of it has the variance the filter states."""
    net = dynamic_network(
        {(2, 1): _first_order(0.7), (3, 1): _first_order(0.4, 0.5)},
        disturbances={1: 4.0, 2: 0.5, 3: Signal(0.2, Q / (Q - 0.9))},
        measured=(2, 3),
    )
    f = eiv_filter(net, 2)
    record = simulate_network(net, 40_000, seed=4)
    out = f.run(record)
    for n in f.noisy:
        error = (out.noise_free[n] - (record[f"w{n}"] - record[f"tau_{n}"]))[500:]
        stated = f.noise_free_variances()[n]
        r = np.array([np.mean(error[k:] * error[: len(error) - k]) for k in range(200)])
        spread = np.sqrt(2 * (r[0] ** 2 + 2 * np.sum(r[1:] ** 2)) / len(error))
        assert abs(np.mean(error**2) - stated) < 3.5 * spread


# -- refusals and their mends ----------------------------------------------------------------------


def test_a_hidden_node_in_a_row_is_refused_and_named():
    from casid.unknown_inputs.networks.equations import node_equations

    with pytest.raises(ModelError, match="still holds w5, which no sensor measures.*measure it"):
        row_predictor(network, node_equations(network), 2, "own row")
    mended = network.with_sensors((1, 2, 3, 4, 5, 7))
    assert row_predictor(mended, node_equations(mended), 2, "own row").variance == pytest.approx(1)


def test_a_module_between_observations_is_no_obstacle_where_one_of_them_suffices():
    """(6.13) holds with w3 alone, whose other input w4 is then a known one, and with w4 alone."""
    net = dynamic_network(
        {
            (2, 1): _first_order(0.7),
            (3, 1): _first_order(0.4),
            (4, 1): _first_order(0.2),
            (3, 4): _first_order(0.1),
        },
        measured=(2, 3, 4),
    )
    alone = {n: eiv_filter(net, 2, sets=node_sets(net, 2, indirect=(n,))) for n in (3, 4)}
    assert {n: f.noisy for n, f in alone.items()} == {3: (2, 3), 4: (2, 4)}
    assert eiv_filter(net, 2).variance == min(f.variance for f in alone.values())


def test_continuous_networks_are_to_be_sampled_first():
    s = Rational.derivative()
    net = dynamic_network({(2, 1): 1 / (s + 1)})
    for refused in (lambda: compare_predictors(net, 2), lambda: simulate_network(net, 10)):
        with pytest.raises(ModelError, match="in continuous time.*sample its modules first"):
            refused()


def test_an_improper_inverse_cannot_be_run_and_says_so():
    net = dynamic_network(
        {(2, 1): _first_order(0.7), (3, 1): _first_order(0.4) / Q}, measured=(2, 3)
    )
    found = compare_predictors(net, 2)
    assert "improper" in found[INDIRECT].obstacle
    assert "improper" in str(found)
    with pytest.raises(ModelError, match="cannot be run; choose other nodes"):
        found[INDIRECT].predict(simulate_network(net, 50))


def test_signals_that_are_not_there_are_named():
    found = compare_predictors(network, 2)
    with pytest.raises(DataError, match="no signal 'w3'; there are w1, w2"):
        found[INDIRECT].predict({"w1": np.zeros(5), "w2": np.zeros(5)})
    with pytest.raises(ModelError, match="needs 1 sample of the future"):
        filtered(Q, np.zeros(5))
