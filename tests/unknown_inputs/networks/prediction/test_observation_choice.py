"""More observations than unknown inputs: which are taken, and what is told where none can be."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import sympy

import casid
from casid.errors import ModelError
from casid.unknown_inputs.networks.estimation.module_equation import module_equation
from casid.unknown_inputs.networks.network import dynamic_network
from casid.unknown_inputs.networks.node_sets import node_sets
from casid.unknown_inputs.networks.prediction.eiv_filter import eiv_filter
from casid.unknown_inputs.networks.prediction.observation_choice import MOST, observation_choices
from casid.unknown_inputs.networks.prediction.predictors import INDIRECT, compare_predictors
from casid.unknown_inputs.networks.simulation import simulate_network

Q = casid.Rational.shift(Ts=1.0)
WEAK, STRONG = 0.1 / (Q - 0.2), 4 / (Q - 0.2)
LATE = 1 / Q**3 / (Q - 0.5)


def observed(**modules):
    """Unknown u acts on a by 1/(q - 0.5), and on the sensors named."""
    given = {("a", "u"): 1 / (Q - 0.5)} | {(n, "u"): g for n, g in modules.items()}
    return dynamic_network(given, measured=("a", *modules))


def test_of_a_weak_and_a_strong_observation_the_strong_one_is_taken():
    """1 + ||G_au/G_mu||^2 var(tau_m): in closed form 1 + (1 + 0.3^2/(1 - 0.5^2))/gain^2."""
    net = observed(m1=WEAK, m2=STRONG)
    found = compare_predictors(net, "a")
    norm = 1 + 0.3**2 / (1 - 0.5**2)
    assert found[INDIRECT].variance == pytest.approx(1 + norm / 4**2, rel=1e-9)
    alone = compare_predictors(net, "a", sensors=["a", "m2"])
    assert found[INDIRECT].variance == alone[INDIRECT].variance
    assert found.observations.evaluated[1].variance == pytest.approx(1 + norm / 0.1**2, rel=1e-9)
    assert "u by m2: 1.07, the least error variance of 2 choices (m1: 113)" in str(found)


def test_a_late_observation_is_left_for_one_that_can_be_run():
    """With m1 the model looks three samples ahead; the filter says so by the user's names."""
    net = observed(m1=LATE, m2=STRONG)
    assert set(compare_predictors(net, "a")[INDIRECT].inputs) == {"m2"}
    assert eiv_filter(net, "a").noisy == ("a", "m2")
    late = node_sets(net, "a", indirect="m1")
    assert "improper: q^3" in compare_predictors(net, "a", sets=late)[INDIRECT].obstacle
    with pytest.raises(ModelError) as refused:
        eiv_filter(net, "a", sets=late)
    text = str(refused.value)
    assert "u from m1 leaves no proper and stable filter" in text
    assert "improper: it needs 4 samples ahead (a zero at infinity)" in text
    assert "delayed: error up to" in text
    assert "noncausal" in text
    assert "Measure another node that u acts on with less delay" in text
    assert "y1" not in text


def test_a_zero_outside_the_unit_circle_is_told_with_its_frequency_and_approximations():
    """q - 2: 0.6931 = log 2 rad/s, as the Root of it says."""
    net = observed(m=(Q - 2) / Q / (Q - 0.5))
    text = str(compare_predictors(net, "a"))
    assert "f is unstable, from the zero q = 2" in text
    assert "0.6931 rad/s" in text
    assert "delayed and mirrored: error up to" in text


def test_observations_that_fail_one_by_one_are_combined_where_that_can_be_run():
    """Zeros 2 and 3 are no zeros of both: a left inverse of the two is stable (4.22)."""
    net = observed(m1=(Q - 2) / Q / (Q - 0.5), m2=(Q - 3) / Q**2)
    found = compare_predictors(net, "a")
    p = found[INDIRECT]
    assert set(p.inputs) == {"m1", "m2"}
    assert "with a free gain, since no choice of as many as needed can be run" in str(found)
    record = simulate_network(net, 30_000, seed=3)
    error = (record["a"] - p.predict(record))[200:]
    r = np.array([np.mean(error[k:] * error[: len(error) - k]) for k in range(100)])
    spread = np.sqrt(2 * (r[0] ** 2 + 2 * np.sum(r[1:] ** 2)) / len(error))
    assert abs(np.mean(error**2) - p.variance) < 3.5 * spread


def random_observed(seed: int):
    """Two unknown inputs, four or five observations of random gains, poles and delays."""
    rng = np.random.default_rng(seed)
    sensors = [f"m{k}" for k in range(int(rng.integers(4, 6)))]
    modules = {("a", u): 1 / (Q - 0.5) for u in "uv"}
    for m in sensors:
        for u in "uv":
            pole, gain = (round(float(x), 2) for x in rng.uniform(0.1, 0.9, 2))
            modules[m, u] = gain / (Q - pole) / Q ** int(rng.integers(0, 2))
    return dynamic_network(modules, measured=["a", *sensors])


SEEDS = [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))]


@pytest.mark.parametrize("seed", SEEDS)
def test_no_other_choice_of_as_many_observations_leaves_less(seed):
    """Against every pair tried alone, with only those sensors; the variances are the same ones."""
    net = random_observed(seed)
    found = observation_choices(net, node_sets(net, "a"))
    alone = {}
    for pair in combinations(net.measured[1:], 2):
        p = compare_predictors(net, "a", sensors=["a", *pair])[INDIRECT]
        alone[pair] = np.inf if p.obstacle else p.variance
    assert found.possible == len(alone)
    assert found.best.observations in alone or found.best.how
    assert np.isfinite(min(alone.values())) == (not found.best.how and found.best.is_usable)
    if np.isfinite(min(alone.values())):
        assert found.best.variance == pytest.approx(min(alone.values()), rel=1e-8)
        best = alone[found.best.observations]
        assert found.best.variance == pytest.approx(best, rel=1e-8)


def test_the_filter_takes_the_choice_to_which_it_applies():
    """(6.13) wants no module between indirect observations; of three pairs one has none."""
    net = dynamic_network(
        {
            ("a", "u"): 1 / (Q - 0.5),
            ("a", "v"): 1 / (Q - 0.3),
            ("m1", "u"): 3 / (Q - 0.2),
            ("m2", "v"): 3 / (Q - 0.1),
            ("m3", "v"): 1 / (Q - 0.1),
            ("m1", "m2"): 0.2 / Q,
        },
        measured=("a", "m1", "m2", "m3"),
    )
    assert set(eiv_filter(net, "a").noisy) == {"a", "m1", "m3"}
    with pytest.raises(ModelError, match=r"G\[m1,m2\] acts on the indirect observation m1"):
        eiv_filter(net, "a", sets=node_sets(net, "a", indirect=("m1", "m2")))


def test_too_many_choices_are_evaluated_in_part_which_is_stated():
    """1 of 70 sensors: as many choices as sensors."""
    net = observed(**{f"m{k:02d}": (1 + k) / (Q - 0.2) for k in range(MOST + 10)})
    text = str(compare_predictors(net, "a"))
    assert f"only the first {MOST} of {MOST + 10} were evaluated" in text
    assert "sets=node_sets(network, target, direct=, indirect=)" in text
    named = node_sets(net, "a", indirect="m69")
    assert set(compare_predictors(net, "a", sets=named)[INDIRECT].inputs) == {"m69"}


def test_a_network_without_disturbances_is_predicted_without_error():
    quiet = dynamic_network(observed(m1=WEAK).modules, measured=("a", "m1"), disturbances=())
    found = compare_predictors(quiet, "a")
    assert found[INDIRECT].whitened_variance == found[INDIRECT].variance == 0.0
    assert "indirect" in str(found)


def test_letters_have_no_variance_and_the_filter_names_what_lacks_a_value():
    net = observed(m1=sympy.Symbol("g") / (sympy.Symbol("q") - 0.2), m2=STRONG)
    assert observation_choices(net, node_sets(net, "a")).possible == 1
    with pytest.raises(ModelError, match="a / m1 = .*: a realisation needs a value for g"):
        eiv_filter(net, "a")


def test_sets_of_another_target_are_refused_with_the_mend():
    net = observed(m1=WEAK, m2=STRONG)
    with pytest.raises(ModelError, match="sets= has target = 'm1'.* same network, target and"):
        compare_predictors(net, "a", sets=node_sets(net, "m1"))
    with pytest.raises(ModelError, match="sets= has S = .* same network, target and sensors"):
        eiv_filter(net, "a", sets=node_sets(net, "a", sensors=("a", "m1")))


def test_a_module_is_estimated_from_the_observations_of_least_error():
    """Those named are used all the same, the others left out; G_ak is kept either way."""
    net = dynamic_network(
        {("a", "u"): 1 / (Q - 0.5), ("a", "k"): 0.5 / Q, ("m1", "u"): WEAK, ("m2", "u"): STRONG},
        measured=("a", "k", "m1", "m2"),
        excitations=("k",),
    )
    best = module_equation(net, ("a", "k"), (), "indirect")
    assert best.inputs == ("k", "m2")
    named = module_equation(net, ("a", "k"), ("k", "m1"), "indirect")
    assert named.inputs == ("k", "m1")
    assert best.is_kept
    assert named.is_kept
    assert named.equations.module("a", "m1") == 40 * best.equations.module("a", "m2")
    assert named.delays == {"k": 1, "m1": 0}
