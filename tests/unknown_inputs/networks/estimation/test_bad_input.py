"""What estimating a module refuses: which condition fails, where, and what mends it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from casid.algebra.rational import Rational
from casid.data.record import Record
from casid.errors import DataError, IdentifiabilityError, ModelError
from casid.estimation.prediction_error.polynomial.orders import Orders
from casid.unknown_inputs.networks.estimation.module_equation import module_equation
from casid.unknown_inputs.networks.estimation.module_estimation import (
    estimate_module,
    with_references,
)
from casid.unknown_inputs.networks.estimation.reachability import rank
from casid.unknown_inputs.networks.network import Network, dynamic_network
from casid.unknown_inputs.networks.simulation import simulate_network
from problems.network8 import MEASURED, network, simulate, symbolic

q = Rational.shift(Ts=1.0)
FIRST = Orders(nb=1, nf=1)
MODULES = {
    (2, 1): 0.5 / (q - 0.6),
    (1, 2): -0.3 / (q - 0.4),
    (1, 3): 0.8 / (q - 0.5),
    (2, 3): 1 / (q - 0.7),
}


def confounded(modules=MODULES, **changes) -> Network:
    given = {"excitations": {1: 4.0}, "measured": (1, 2), "name": "confounded", "nodes": (1, 2, 3)}
    return dynamic_network(modules, **(given | changes))


@pytest.fixture(scope="module")
def record():
    return simulate_network(confounded(measured=(1, 2, 3), excitations={1: 4.0}), 1500, seed=1)


# -- least squares ---------------------------------------------------------------------------------


def test_a_confounder_is_named_with_its_paths_and_the_mends(record):
    with pytest.raises(ModelError) as refused:
        estimate_module(confounded(), (2, 1), record, orders=FIRST)
    text = str(refused.value)
    assert "tau_3 confounds w2 and w1 (w3 -> w2; w3 -> w1)" in text
    assert "method='iv' with delta_1" in text
    assert "sensors for inputs=(1, 3) (a sensor on w3)" in text
    assert "accept_bias=True" in text


def test_the_sensor_that_is_offered_makes_least_squares_consistent(record):
    found = estimate_module(confounded(measured=(1, 2, 3)), (2, 1), record, orders=FIRST)
    assert found.equation.inputs == (1, 3)
    assert found.consistency.is_consistent


def test_without_a_reference_the_mend_is_an_excitation(record):
    with pytest.raises(ModelError, match="an excitation of w1 or w2"):
        estimate_module(confounded(excitations=()), (2, 1), record, orders=FIRST)


def test_noise_of_an_inputs_sensor_is_errors_in_variables(record):
    quiet = {k: g for k, g in MODULES.items() if 3 not in k}
    noisy = dynamic_network(quiet, excitations={1: 4.0}, sensor_noise={1: 1.0})
    with pytest.raises(ModelError, match="sensor noise of w1 .*errors in variables.*method='iv'"):
        estimate_module(noisy, (2, 1), record, orders=FIRST)


def test_noise_of_the_outputs_sensor_counts_where_the_output_acts_back(record):
    loop = {k: g for k, g in MODULES.items() if 3 not in k}
    noisy = dynamic_network(loop, excitations={1: 4.0}, sensor_noise={2: 1.0})
    with pytest.raises(ModelError, match=r"acts back on its inputs \(w2 -> w1\)"):
        estimate_module(noisy, (2, 1), record, orders=FIRST)
    chain = dynamic_network({(2, 1): MODULES[2, 1]}, excitations={1: 4.0}, sensor_noise={2: 1.0})
    assert estimate_module(chain, (2, 1), record, orders=FIRST).consistency.is_consistent


def test_a_loop_without_delay_is_an_algebraic_loop(record):
    direct = {(2, 1): 0.5 * q / (q - 0.6), (1, 2): -0.3 * q / (q - 0.4)}
    of = dynamic_network(direct, excitations={1: 4.0})
    with pytest.raises(ModelError, match=r"w2 -> w1\): an algebraic loop"):
        estimate_module(of, (2, 1), record, orders=Orders(nb=1, nf=1, nk=0))
    delayed = dynamic_network({**direct, (1, 2): -0.3 / (q - 0.4)}, excitations={1: 4.0})
    orders = Orders(nb=1, nf=1, nk=0)
    assert estimate_module(delayed, (2, 1), record, orders=orders).consistency.is_consistent


def test_an_excitation_that_is_left_out_counts_as_a_disturbance():
    """delta_3 unknown confounds; known, it is an input of the equation."""
    of = confounded(disturbances=(1, 2), excitations={1: 4.0, 3: 1.0})
    data = simulate_network(of, 1500, seed=2)
    with pytest.raises(ModelError, match="tau_3 confounds"):
        estimate_module(of, (2, 1), data, orders=FIRST, references=(1,))
    found = estimate_module(of, (2, 1), data, orders=FIRST)
    assert found.equation.excitations == (3,)
    assert found["b1[delta_3]"] == pytest.approx(1.0, abs=3.5 * found.std_error("b1[delta_3]"))
    assert with_references(of, None) is of


# -- references ------------------------------------------------------------------------------------


def test_a_reference_that_does_not_reach_an_input_is_refused_with_the_nodes_to_excite(record):
    no_loop = {k: g for k, g in MODULES.items() if k != (1, 2)}
    of = confounded(modules=no_loop, excitations={2: 4.0})
    for method in ("iv", "two_stage", "joint"):
        with pytest.raises(
            IdentifiabilityError, match=r"w1 is not reached by delta_2.*an excitation of w1"
        ):
            estimate_module(of, (2, 1), record, orders=FIRST, method=method, accept_bias=True)


def test_a_reference_in_the_equation_itself_is_no_instrument():
    """delta_6 acts on w2 past w1 and w3 (w6 -> w8 -> w5 -> w2), Example 3.4."""
    with pytest.raises(IdentifiabilityError) as refused:
        estimate_module(network, (2, 3), simulate(1, 500), orders=FIRST, method="iv", inputs=(1, 3))
    assert "delta_6 enters the equation past the inputs" in str(refused.value)
    assert "an excitation of w1" in str(refused.value)


def test_responses_to_one_reference_cannot_be_divided_by_those_of_two_inputs():
    of = dynamic_network(network.modules, excitations={6: 1.0}, measured=(1, 2, 7))
    with pytest.raises(ModelError) as refused:
        estimate_module(of, (1, 7), simulate(1, 500), orders=FIRST, method="joint")
    assert "delta_6 move w2, w7 in 1 of 2 independent ways" in str(refused.value)
    assert "an excitation of" in str(refused.value)


def test_two_stages_do_not_go_with_past_outputs(record):
    with pytest.raises(ModelError, match="give nf instead of na"):
        estimate_module(confounded(), (2, 1), record, orders=Orders(na=1, nb=1), method="two_stage")


def test_references_have_to_be_excitations(record):
    with pytest.raises(ModelError, match="w2 has no excitation .* those of w1"):
        estimate_module(confounded(), (2, 1), record, orders=FIRST, references=(2,))


def test_a_reference_that_never_moves_is_refused(record):
    still = record.without("delta_1").with_channel("delta_1", np.zeros(record.N), "1")
    with pytest.raises(DataError, match="delta_1 never moves.*references="):
        estimate_module(confounded(), (2, 1), still, orders=FIRST, method="iv")


# -- structure -------------------------------------------------------------------------------------


def test_a_module_that_is_not_in_the_structure_is_refused_with_those_that_are(record):
    with pytest.raises(ModelError, match="no module G31; it has G21, G12, G13, G23"):
        estimate_module(confounded(), (3, 1), record, orders=FIRST)


def test_where_no_inputs_keep_the_module_the_open_loop_and_its_sensor_are_named():
    """Example 3.5: the loop w2 -> w5 -> w2 has no sensor on it."""
    with pytest.raises(ModelError) as refused:
        estimate_module(network, (2, 1), simulate(1, 500), orders=FIRST)
    text = str(refused.value)
    assert "w2 -> w5 -> w2" in text
    assert "one on w5 would" in text
    assert "elimination='indirect'" in text


@pytest.mark.parametrize(
    ("inputs", "told"),
    [
        ((1, 3, 5), "w5 has no sensor; choose inputs among w1, w2, w3, w4, w7"),
        ((3,), "cannot be estimated without w1 among the predictor inputs w3; add it"),
        ((1, 2), "w2 cannot be its own predictor input"),
    ],
)
def test_inputs_that_do_not_fit_are_refused(inputs, told):
    with pytest.raises(ModelError, match=told):
        estimate_module(network, (2, 1), simulate(1, 200), orders=FIRST, inputs=inputs)


def test_inputs_of_the_indirect_model_are_its_own():
    with pytest.raises(ModelError, match="has the inputs w1, w3, w4, not w1; leave inputs= out"):
        module_equation(network, (2, 1), (1,), "indirect")


def test_an_improper_indirect_model_is_refused_with_the_samples_it_lacks():
    """G25/G45 with a delay more in G45: w2 would have to be told by w4 one sample later."""
    slow = {**network.modules, (4, 5): network.modules[4, 5] / q}
    of = dynamic_network(slow, excitations={6: 1.0}, measured=MEASURED)
    with pytest.raises(ModelError, match=r"from w4 to w2 .* improper: it needs w4 1 sample ahead"):
        estimate_module(
            of, (2, 3), simulate(1, 500), orders=FIRST, method="iv", elimination="indirect"
        )


def test_a_delay_of_the_model_longer_than_the_modules_is_refused():
    """G25/G45 has a direct term, and nk = 1 leaves it out."""
    with pytest.raises(ModelError, match=r"from w4 to w2 .* delay of 0 samples, and nk = 1"):
        estimate_module(
            network, (2, 3), simulate(1, 500), orders=FIRST, method="iv", elimination="indirect"
        )


def test_delays_are_those_of_the_eliminated_network():
    """delta_6 reaches w2 past w1, w3 and w7 by w6 -> w8 -> w5 -> w2, three delays."""
    found = module_equation(network, (2, 1), (1, 3, 7))
    assert found.delays == {"w1": 1, "w3": 1, "w7": 3, "delta_6": 3}
    assert module_equation(symbolic(), (2, 1), (1, 3, 7)).delays == {}


def test_letters_for_modules_are_structure_enough():
    """Nothing but which modules there are enters the estimate."""
    record = simulate(3, 1500)
    sensors = (1, 2, 3, 5, 7)
    numbers = dynamic_network(network.modules, excitations={6: 1.0}, measured=sensors)
    a, b = (
        estimate_module(of, (2, 1), record, orders=FIRST) for of in (numbers, symbolic(sensors))
    )
    assert np.array_equal(a.theta, b.theta)
    assert a.equation.inputs == b.equation.inputs


def test_a_continuous_network_is_to_be_sampled_first(record):
    s = Rational.derivative()
    of = dynamic_network({(2, 1): 1 / (s + 1)}, excitations=(1,))
    with pytest.raises(ModelError, match="sample its modules first"):
        estimate_module(of, (2, 1), record, orders=FIRST)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"method": "pem"}, "method = 'pem'; choose one of ls, iv, two_stage, joint"),
        ({"elimination": "none", "inputs": (1,)}, "choose 'immersion' or 'indirect'"),
    ],
)
def test_options_are_told_with_what_there_is(record, options, told):
    with pytest.raises(ModelError, match=told):
        estimate_module(confounded(), (2, 1), record, orders=FIRST, **options)


# -- records ---------------------------------------------------------------------------------------


def test_missing_channels_are_named_all_at_once(record):
    short = record.without("w1", "delta_1")
    with pytest.raises(DataError, match="has no channel w1, delta_1; it has .*rename"):
        estimate_module(confounded(), (2, 1), short, orders=FIRST, method="iv")


def test_missing_samples_are_refused(record):
    gap = record.mark_missing("w1", np.arange(record.N) == 5)
    with pytest.raises(DataError, match="w1 has missing samples.*record.between"):
        estimate_module(confounded(), (2, 1), gap, orders=FIRST, method="iv")


def test_another_sample_time_is_refused(record):
    slow = Record(dict(record.channels), dict(record.units), Ts=0.5, name="fast")
    with pytest.raises(DataError, match="sampled every 0.5 s, the network .* every 1 s"):
        estimate_module(confounded(), (2, 1), slow, orders=FIRST, method="iv")


@pytest.mark.parametrize("method", ["ls", "iv"])
def test_orders_too_high_for_the_record_are_refused(record, method):
    with pytest.raises(DataError, match="lower the orders, or give a longer record"):
        estimate_module(
            confounded(),
            (2, 1),
            record.between(0, 40),
            orders=Orders(nb=6, nf=6),
            method=method,
            accept_bias=True,
        )


def test_responses_longer_than_the_record_pays_for_are_refused(record):
    with pytest.raises(DataError, match="lower lags=, or give a longer record"):
        estimate_module(
            confounded(), (2, 1), record, orders=FIRST, method="two_stage", lags=record.N // 2
        )


# -- numbers ---------------------------------------------------------------------------------------


def test_weak_references_are_told_beside_the_numbers_they_spoil():
    of = confounded(excitations={1: 0.02})
    found = estimate_module(
        of, (2, 1), simulate_network(of, 1500, seed=8), orders=FIRST, method="iv"
    )
    assert any("weak instruments" in note for note in found.fit.notes)


def test_responses_cut_before_they_die_out_are_told():
    of = confounded(modules={(2, 1): 0.5 / (q - 0.6), (1, 2): -0.03 / (q - 0.97)}, nodes=(1, 2))
    slow = dynamic_network({(2, 1): 0.05 / (q - 0.6), (1, 4): 1 / (q - 0.97)}, excitations={4: 9.0})
    data = simulate_network(slow, 3000, seed=4)
    cut = estimate_module(slow, (2, 1), data, orders=FIRST, method="two_stage", lags=15)
    assert any("w1 to the references has not died out after 15" in n for n in cut.fit.notes)
    fast = simulate_network(of, 3000, seed=4)
    whole = estimate_module(of, (2, 1), fast, orders=FIRST, method="two_stage", lags=150)
    assert not any("died out" in n for n in whole.fit.notes)


def test_an_unstable_estimate_is_not_simulated(record):
    found = estimate_module(confounded(), (2, 1), record, orders=FIRST, method="iv")
    outside = replace(found, fit=replace(found.fit, theta=np.array([0.5, -1.2])))
    with pytest.raises(ModelError, match="module from w1 is estimated unstable.*lower its order"):
        outside.simulate()
    assert np.isnan(outside.simulated_fit())


def test_a_coefficient_that_is_not_there_is_told_with_those_that_are(record):
    found = estimate_module(confounded(), (2, 1), record, orders=FIRST, method="joint")
    with pytest.raises(ModelError, match=r"no coefficient 'b2'; there are b1\[w1\], f1\[w1\]"):
        found["b2"]


@pytest.mark.parametrize("seed", range(10))
def test_exact_rank_is_that_of_the_factors(seed):
    from fractions import Fraction

    rng = np.random.default_rng(seed)
    r = int(rng.integers(0, 4))
    product = rng.integers(-5, 6, (4, max(r, 1))) @ rng.integers(-5, 6, (max(r, 1), 5)) * (r > 0)
    table = [[Fraction(int(x), 7) for x in row] for row in product]
    assert rank(table) == np.linalg.matrix_rank(product)
