"""Modules of a network estimated from records: where each method goes, and how sure it is."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from casid.algebra.rational import Rational
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.prediction_limit import prediction_error_limit
from casid.unknown_inputs.limits.regression import Regression, arx
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.networks.dynamics import is_stable, network_states
from casid.unknown_inputs.networks.estimation.consistency import consistency
from casid.unknown_inputs.networks.estimation.module_equation import module_equation
from casid.unknown_inputs.networks.estimation.module_estimation import estimate_module
from casid.unknown_inputs.networks.network import Network, Signal, dynamic_network
from casid.unknown_inputs.networks.nodes import node_label
from casid.unknown_inputs.networks.predictor_inputs import predictor_inputs
from casid.unknown_inputs.networks.simulation import filtered, simulate_network
from problems.network8 import MEASURED, TABLE_6_1, network

q = Rational.shift(Ts=1.0)
FIRST = Orders(nb=1, nf=1)
SIGMAS = 3.5

# Node 3 has no sensor and disturbs 1 and 2 alike; 2 acts back on 1.
CONFOUNDED = dynamic_network(
    {
        (2, 1): 0.5 / (q - 0.6),
        (1, 2): -0.3 / (q - 0.4),
        (1, 3): 0.8 / (q - 0.5),
        (2, 3): 1 / (q - 0.7),
    },
    excitations={1: 4.0},
    measured=(1, 2),
    name="confounded",
)
TRUTH_21 = {"b1[w1]": 0.5, "f1[w1]": -0.6}


def excited(
    of: Network, excitations: dict[int, float], measured: tuple[int, ...], **more
) -> Network:
    return dynamic_network(
        of.modules, nodes=of.nodes, excitations=excitations, measured=measured, name=of.name, **more
    )


@cache
def linear_signals(of: Network) -> LinearSignals:
    """The signals of a record of the network as `casid.asymptotics` has them."""
    states = network_states(of)
    place = {n: i for i, n in enumerate(of.nodes)}
    kinds = {"delta": of.excitations, "tau": of.disturbances}
    columns = {
        f"{what}_{n}": (place[n], s.variance) for what, k in kinds.items() for n, s in k.items()
    }
    pick = [i for i, _ in columns.values()]
    noise = dict(of.sensor_noise)
    variances = {name: v for name, (_, v) in columns.items()} | {
        f"s_{n}": v for n, v in noise.items()
    }
    D_noise = np.zeros((len(of.nodes), len(noise)))
    for column, n in enumerate(noise):
        D_noise[place[n], column] = 1.0
    B = np.hstack([states.B[:, pick], np.zeros((len(states.A), len(noise)))])
    D = np.hstack([states.D[:, pick], D_noise])
    names = [node_label(n) for n in of.nodes]
    return LinearSignals.of_state_space(
        (states.A, B, states.C, D), variances, signals=names, Ts=1.0
    )


def truth8(target: int, sources: tuple[int, ...]) -> dict[str, float]:
    out = {}
    for k in sources:
        beta, alpha = TABLE_6_1[target, k]
        out |= {f"b1[w{k}]": beta, f"f1[w{k}]": -alpha}
    return out


def assert_near(found, limit, N: int) -> None:
    """Every coefficient within SIGMAS of the asymptotic standard error of its limit."""
    for name in limit.names:
        assert abs(found[name] - limit[name]) < SIGMAS * limit.std_error(name, N), name


def assert_consistent(found, truth: dict[str, float]) -> None:
    for name, value in truth.items():
        assert abs(found[name] - value) < SIGMAS * found.std_error(name), name


# -- a confounder ----------------------------------------------------------------------------------

N_LONG = 20_000


@pytest.fixture(scope="module")
def confounded_record():
    return simulate_network(CONFOUNDED, N_LONG, seed=4)


def test_a_confounder_takes_prediction_error_to_its_limit_and_not_to_the_module(confounded_record):
    limit = prediction_error_limit(linear_signals(CONFOUNDED), "w2", ["w1"], FIRST, TRUTH_21)
    found = estimate_module(CONFOUNDED, (2, 1), confounded_record, orders=FIRST, accept_bias=True)
    assert_near(found, limit, N_LONG)
    for name in limit.names:  # far from the module: no interval of any use holds both
        assert abs(limit.bias(name)) > SIGMAS * limit.std_error(name, N_LONG)
    assert not found.consistency.is_consistent


def test_least_squares_of_an_arx_model_goes_to_the_limit_of_its_regression(confounded_record):
    regression = Regression("w2", arx("w2", ["w1"], 1, 1))
    limit = regression_limit(linear_signals(CONFOUNDED), regression)
    found = estimate_module(
        CONFOUNDED, (2, 1), confounded_record, orders=Orders(na=1, nb=1), accept_bias=True
    )
    assert_near(found, limit, N_LONG)


@pytest.mark.parametrize("method", ["iv", "two_stage", "joint"])
def test_methods_with_references_do_not_see_the_confounder(confounded_record, method):
    found = estimate_module(CONFOUNDED, (2, 1), confounded_record, orders=FIRST, method=method)
    assert found.consistency.is_consistent
    assert_consistent(found, TRUTH_21)
    for name, value in TRUTH_21.items():  # and tell it from where least squares goes
        assert found.std_error(name) < 0.2 * abs(value)


@pytest.mark.parametrize("method", ["iv", "joint"])
def test_a_reference_at_the_output_serves_where_the_output_acts_back_on_the_input(method):
    """delta_2 is known in the equation of w2, and reaches w1 by G12 alone."""
    of = excited(CONFOUNDED, {2: 25.0}, (1, 2))
    found = estimate_module(
        of, (2, 1), simulate_network(of, 8000, seed=6), orders=FIRST, method=method
    )
    assert found.equation.subtracted
    assert_consistent(found, TRUTH_21)
    assert found.std_error("b1[w1]") < 0.1


@pytest.mark.parametrize("method", ["iv", "two_stage", "joint"])
def test_a_coloured_reference_serves_as_a_white_one_does(method):
    coloured = Signal(4.0, 1 / (1 - 0.8 / q))
    of = dynamic_network(CONFOUNDED.modules, excitations={1: coloured}, measured=(1, 2))
    record = simulate_network(of, 6000, seed=12)
    found = estimate_module(of, (2, 1), record, orders=FIRST, method=method)
    assert_consistent(found, TRUTH_21)


RUNS, N_SHORT = 20, 1000


@pytest.mark.slow
@pytest.mark.parametrize("method", ["iv", "two_stage", "joint"])
def test_means_are_the_module_and_intervals_cover_it(method):
    """Bias within SIGMAS standard errors of the mean; 95 % intervals within binomial chance."""
    from scipy.stats import binom

    lags = 12 if method == "iv" else 25
    values, inside = [], []
    for seed in range(RUNS):
        found = estimate_module(
            CONFOUNDED,
            (2, 1),
            simulate_network(CONFOUNDED, N_SHORT, seed=100 + seed),
            orders=FIRST,
            method=method,
            lags=lags,
        )
        values.append([found[n] for n in TRUTH_21])
        bounds = [found.interval(n) for n in TRUTH_21]
        inside.append([a < t < b for (a, b), t in zip(bounds, TRUTH_21.values(), strict=True)])
    error = np.std(values, axis=0, ddof=1) / np.sqrt(RUNS)
    assert np.all(np.abs(np.mean(values, axis=0) - list(TRUTH_21.values())) < SIGMAS * error)
    # Chance that a right interval covers less often: 1e-3 for each coefficient.
    assert np.all(np.sum(inside, axis=0) >= binom.ppf(1e-3, RUNS, 0.95))


# -- the eight nodes -------------------------------------------------------------------------------


LONG = Regression("w2", arx("w2", ["w1", "w3"], 8, 8))
MARKOV = {f"b1[w{k}]": TABLE_6_1[2, k][0] for k in (1, 3)}


def unexcited(disturbances: tuple[int, ...]) -> Network:
    """The eight nodes in Example 3.4: delta_6 is not there, tau are as given."""
    return dynamic_network(network.modules, disturbances=disturbances, measured=MEASURED)


def test_example_3_4_tau_6_and_tau_7_confound_w2_with_w1_and_w3():
    """A long ARX model goes to its limit, whose b_1 is not the module's first Markov parameter."""
    of, N = unexcited(tuple(range(1, 9))), 10_000
    limit = regression_limit(linear_signals(of), LONG, MARKOV)
    found = estimate_module(
        of, (2, 1), simulate_network(of, N, seed=2), orders=Orders(na=8, nb=8), inputs=(1, 3),
        accept_bias=True,
    )  # fmt: skip
    assert_near(found, limit, N)
    assert abs(limit.bias("b1[w1]")) > SIGMAS * limit.std_error("b1[w1]", N)
    assert {c.node for c in found.equation.confounders} == {6, 7}
    assert not found.equation.is_kept
    assert found.equation.becomes == "-G21/(G25*G52 - 1)"


def test_without_tau_6_and_tau_7_the_same_model_begins_with_the_modules_markov_parameters():
    """A noise model is monic, so that b_1 of a long ARX model is that of Gt_2k, here of G_2k."""
    limit = regression_limit(linear_signals(unexcited((1, 2, 3, 4, 5, 8))), LONG, MARKOV)
    for name in MARKOV:
        assert limit.bias(name) == pytest.approx(0, abs=1e-8)


def test_with_all_predictor_inputs_measured_prediction_error_is_consistent():
    all_in = excited(network, {6: 1.0}, (1, 2, 3, 5, 7))
    N, truth = 6000, truth8(2, (1, 3, 5))
    found = estimate_module(all_in, (2, 1), simulate_network(all_in, N, seed=5), orders=FIRST)
    assert found.equation.inputs == (1, 3, 5)
    assert found.equation.is_kept
    assert not found.equation.confounders
    limit = prediction_error_limit(
        linear_signals(all_in), "w2", ["w1", "w3", "w5"], FIRST, truth, start=truth
    )
    for name in limit.names:
        assert limit.bias(name) == pytest.approx(0, abs=1e-6)
    assert_near(found, limit, N)


NO_41 = network.without((4, 1))  # G41 = 0, so that Proposition 4.1 keeps G21 as well as G23
INDIRECT = excited(NO_41, {1: 10.0, 3: 10.0, 6: 10.0, 8: 10.0}, MEASURED)
INDIRECT_ORDERS = Orders(nb={"w1": 1, "w3": 1, "w4": 2}, nf=1, nk={"w1": 1, "w3": 1, "w4": 0})


def indirect_truth() -> dict[str, float]:
    """(4.31): w4 acts by G25/G45 = (b25/b45) (1 - a45 q^-1)/(1 - a25 q^-1)."""
    (b25, a25), (b45, a45) = TABLE_6_1[2, 5], TABLE_6_1[4, 5]
    own = {"b0[w4]": b25 / b45, "b1[w4]": -b25 / b45 * a45, "f1[w4]": -a25}
    return truth8(2, (1, 3)) | own


@pytest.mark.slow
def test_the_indirect_model_is_errors_in_variables_biased_and_instruments_mend_it():
    N, truth = 10_000, indirect_truth()
    record = simulate_network(INDIRECT, N, seed=7)
    ways = {"orders": INDIRECT_ORDERS, "elimination": "indirect"}
    direct = estimate_module(INDIRECT, (2, 3), record, accept_bias=True, **ways)
    limit = prediction_error_limit(
        linear_signals(INDIRECT), "w2", ["w1", "w3", "w4"], INDIRECT_ORDERS, truth
    )
    assert_near(direct, limit, N)
    assert limit["b0[w4]"] < 0.5 * truth["b0[w4]"]  # attenuated, as errors in variables are
    assert [c.node for c in direct.equation.confounders] == [4]
    for method in ("iv", "joint", "two_stage"):
        found = estimate_module(INDIRECT, (2, 3), record, method=method, **ways)
        assert found.equation.is_kept
        assert_consistent(found, truth)
        assert SIGMAS * found.std_error("b0[w4]") < abs(limit.bias("b0[w4]"))


def test_sensor_noise_attenuates_b_and_delta_6_as_an_instrument_does_not_know_of_it():
    """w6 = delta_6 + tau_6 is white, so that b goes to b (5 / (5 + 4)) and f to f."""
    noisy = excited(network, {6: 4.0}, (6, 7), sensor_noise={6: 4.0})
    N, truth = 6000, truth8(7, (6,))
    record = simulate_network(noisy, N, seed=3)
    direct = estimate_module(noisy, (7, 6), record, orders=FIRST, accept_bias=True)
    b, f = truth["b1[w6]"], truth["f1[w6]"]
    assert abs(direct["b1[w6]"] - b * 5 / 9) < SIGMAS * direct.std_error("b1[w6]")
    assert abs(direct["f1[w6]"] - f) < SIGMAS * direct.std_error("f1[w6]")
    for method in ("iv", "two_stage", "joint"):
        found = estimate_module(noisy, (7, 6), record, orders=FIRST, method=method)
        assert_consistent(found, truth)
        assert found.std_error("b1[w6]") < 0.1 * b


# -- random networks -------------------------------------------------------------------------------


def random_loop(seed: int) -> tuple[Network, tuple[int, ...]]:
    """A stable network of six nodes, some without a sensor, and inputs that keep G21."""
    rng = np.random.default_rng(seed)
    while True:
        modules = {
            (i, k): round(float(rng.choice([-1, 1]) * rng.uniform(0.2, 0.6)), 2)
            / (q - round(float(rng.uniform(-0.4, 0.4)), 2))
            for i in range(1, 7)
            for k in range(1, 7)
            if i != k and ((i, k) == (2, 1) or rng.random() < 0.3)
        }
        measured = [1, 2, *(k for k in range(3, 7) if rng.random() < 0.5)]
        of = dynamic_network(modules, nodes=range(1, 7), measured=measured)
        if is_stable(of) and (sets := predictor_inputs(of, 2, 1).sets):
            return of, sets[-1].inputs


LAGS = 12  # of the long ARX model: poles of 0.4 are 2e-5 by then


def module_error(limit, module: Rational) -> float:
    """Largest |B/A - G21| on three frequencies."""
    z = np.exp(1j * np.array([0.1, 1.0, 2.5]))
    A = 1 + sum(limit[f"a{m}"] * z**-m for m in range(1, LAGS + 1))
    B = sum(limit[f"b{m}[w1]"] * z**-m for m in range(1, LAGS + 1))
    return float(np.max(np.abs(B / A - module.response(z))))


@pytest.fixture(scope="module")
def verdicts_and_errors():
    """Of 60 networks: what the structure says of least squares, and where its limit is."""
    found = []
    for seed in range(60):
        of, inputs = random_loop(seed)
        equation = module_equation(of, (2, 1), inputs)
        assert equation.is_kept
        layout = Layout.of(Orders(na=LAGS, nb=LAGS), equation.names)
        regression = Regression("w2", arx("w2", list(equation.names), LAGS, LAGS))
        limit = regression_limit(linear_signals(of), regression)
        verdict = consistency(equation, "ls", layout)
        found.append((verdict.is_consistent, module_error(limit, of.module(2, 1))))
    return found


def test_where_no_confounder_is_found_long_least_squares_goes_to_the_module(verdicts_and_errors):
    errors = [error for is_consistent, error in verdicts_and_errors if is_consistent]
    assert len(errors) >= 10
    assert max(errors) < 1e-4


def test_where_a_confounder_is_named_least_squares_goes_elsewhere(verdicts_and_errors):
    errors = [error for is_consistent, error in verdicts_and_errors if not is_consistent]
    assert len(errors) >= 10
    assert min(errors) > 1e-3


# -- the result ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def by_iv(confounded_record):
    return estimate_module(
        CONFOUNDED, (2, 1), confounded_record.between(0, 4000), orders=FIRST, method="iv"
    )


def test_the_transfer_function_is_what_the_coefficients_say(by_iv):
    omega = np.array([0.0, 0.3, 2.0])
    z = np.exp(1j * omega)
    wanted = by_iv["b1[w1]"] / (z + by_iv["f1[w1]"])
    assert by_iv.transfer.frequency_response(omega) == pytest.approx(wanted, rel=1e-12)
    assert by_iv.response(omega).value == pytest.approx(wanted, rel=1e-12)


def test_the_error_of_the_static_gain_is_that_of_b_over_one_plus_f(by_iv):
    b, f = by_iv["b1[w1]"], by_iv["f1[w1]"]
    slope = np.array([1 / (1 + f), -b / (1 + f) ** 2])
    at_zero = by_iv.response(0.0)
    assert at_zero.magnitude_error[0] ** 2 == pytest.approx(
        slope @ by_iv.covariance @ slope, rel=1e-6
    )
    low, high = at_zero.band()
    assert low[0] < 0.5 / 0.4 < high[0]
    assert at_zero.phase_error[0] == pytest.approx(0, abs=1e-12)


def test_the_report_tells_the_equation_the_terms_and_the_errors(by_iv):
    text = str(by_iv)
    for part in (
        "G21 is kept",
        "iv is consistent here, provided",
        "b1[w1]",
        "errors assume",
        "+/-",
    ):
        assert part in text
    assert repr(by_iv) == "<ModuleEstimate G21 by iv>"


def test_the_simulated_fit_of_another_record_is_that_of_the_transfer_function(by_iv):
    other = simulate_network(CONFOUNDED, 4000, seed=9)
    w1, w2 = other["w1"] - other["w1"].mean(), other["w2"] - other["w2"].mean()
    made, w2 = filtered(by_iv.transfer, w1)[400:], w2[400:]
    wanted = 100 * (1 - np.linalg.norm(w2 - made) / np.linalg.norm(w2 - w2.mean()))
    assert by_iv.simulated_fit(other) == pytest.approx(wanted, rel=1e-9)


def test_a_wrong_order_shows_in_the_residual_and_in_the_surplus_moments(confounded_record):
    wrong = estimate_module(
        CONFOUNDED, (2, 1), confounded_record, orders=Orders(nb=1), method="iv", lags=12
    )
    right = estimate_module(
        CONFOUNDED, (2, 1), confounded_record, orders=FIRST, method="iv", lags=12
    )
    assert wrong.reference_correlation()["delta_1"] > 5
    assert right.reference_correlation()["delta_1"] <= 4
    assert wrong.fit.evidence["overidentified"].endswith("p < 1e-300")
