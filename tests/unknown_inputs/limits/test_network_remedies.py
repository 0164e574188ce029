"""Remedies for a module of a network: every relation by every estimator, one call."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.signal

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.estimation.prediction_error.polynomial.orders import Orders
from casid.unknown_inputs.limits.comparison import Comparison
from casid.unknown_inputs.limits.network_remedies import network_remedies
from casid.unknown_inputs.networks.network import Network, dynamic_network
from problems.network8 import network as network8

Array = np.ndarray
q = Rational.shift(Ts=1.0)
NAMES = ("static gain of G31", "Re G31 at 0.314 rad/s", "Im G31 at 0.314 rad/s")


def small(measured: tuple[int, ...] = (1, 3, 4), excitations: tuple[int, ...] = (1, 2)) -> Network:
    """w2 acts on w3, on its neighbour w1 and on w4; without a sensor of its own."""
    return dynamic_network(
        {(3, 1): 0.6 / (q - 0.5), (3, 2): 0.4 / (q - 0.6), (4, 2): 0.5 / (q - 0.6),
         (1, 2): 0.3 / q},
        excitations=excitations,
        disturbances={1: 0.3, 2: 0.5, 3: 0.4, 4: 0.2},
        measured=measured,
        name="small",
    )  # fmt: skip


@pytest.fixture(scope="module")
def compared() -> Comparison:
    return network_remedies(small(), (3, 1), N=2000)


def test_every_relation_is_there_by_every_estimator(compared: Comparison) -> None:
    """`All inputs known` for reference, and w2 neglected, immersed, or eliminated by w4."""
    ways = ("PEM", "LS", "IV", "two-stage")
    relations = ("all inputs known", "neglect", "immersed", "indirect")
    assert [r.name for r in compared.rows] == [f"{r}, {w}" for r in relations for w in ways]
    assert compared.parameters == NAMES
    assert compared.unknown == ("w2",)
    G = 0.6 / (np.exp(0.1j * np.pi) - 0.5)
    truth = compared["neglect, PEM"].truth
    np.testing.assert_allclose([truth[n] for n in NAMES], [1.2, G.real, G.imag], rtol=1e-12)


def test_only_references_are_free_of_what_confounds(compared: Comparison) -> None:
    """tau_2 confounds w3 and w1, tau_4 the indirect model: IV and two stages alone are exact.

    What neglecting leaves in the error has delta_2 in it, so that there even these are biased.
    """
    bias = {r.name: [r.bias(n) for n in NAMES] for r in compared.rows}
    for relation in ("immersed", "indirect"):
        for way in ("IV", "two-stage"):
            assert bias[f"{relation}, {way}"] == [0, 0, 0]
        for way in ("PEM", "LS"):
            assert all(bias[f"{relation}, {way}"])
    assert all(all(bias[f"neglect, {way}"]) for way in ("PEM", "LS", "IV", "two-stage"))
    assert bias["all inputs known, PEM"] == [0, 0, 0]
    text = str(compared)
    assert "neglect: what w2 sends is in the error; tau_2 confounds w3 and w1" in text
    assert "delta_2 is in the error and no instrument" in text
    assert "indirect: G31 is kept; tau_4 confounds w3 and w1, w4" in text


def test_the_least_mean_square_error_is_chosen_with_its_reason(compared: Comparison) -> None:
    """A short record prefers little variance, a long one no bias."""
    long = Comparison(compared.rows, NAMES, compared.unknown, 1e6, {})
    best = long.best(NAMES[0])
    assert best is not None
    assert best.remedy == "indirect, two-stage"
    assert best.why.startswith("no bias")
    short = compared.best(NAMES[0])
    assert short is not None
    assert "on indirect, two-stage is better" in short.why
    assert "worth measuring" in long.cost_of_neglecting(NAMES[0])


# -- Monte Carlo ---------------------------------------------------------------------------------

RUNS, N, BEFORE = 400, 2000, 120


def simulated() -> dict[str, Array]:
    """The network sample by sample in plain numpy, RUNS times."""
    rng, f, n = np.random.default_rng(5), scipy.signal.lfilter, N + BEFORE
    d1, d2 = rng.standard_normal((2, RUNS, n))
    t1, t2, t3, t4 = (math.sqrt(v) * rng.standard_normal((RUNS, n)) for v in (0.3, 0.5, 0.4, 0.2))
    w2 = d2 + t2
    w1 = f([0, 0.3], [1], w2) + d1 + t1
    w4 = f([0, 0.5], [1, -0.6], w2) + t4
    w3 = f([0, 0.6], [1, -0.5], w1) + f([0, 0.4], [1, -0.6], w2) + t3
    r1, r4 = f([0, 0.3], [1], d2) + d1, f([0, 0.5], [1, -0.6], d2)
    r3 = f([0, 0.6], [1, -0.5], r1) + f([0, 0.4], [1, -0.6], d2)
    return {"w1": w1, "w3": w3, "w4": w4, "d2": d2, "r1": r1, "r3": r3, "r4": r4}


def solved(y: Array, phi: list[Array], zeta: list[Array]) -> Array:
    """IV estimates (RUNS, n)."""
    Phi, Z = np.stack(phi, axis=1), np.stack(zeta, axis=1)
    found = np.linalg.solve(Z @ Phi.swapaxes(1, 2), Z @ y[:, :, None])
    return np.asarray(found[:, :, 0])


def gain(theta: Array, na: int, b: slice) -> Array:
    return np.asarray(theta[:, b].sum(axis=1) / (1 + theta[:, :na].sum(axis=1)))


def test_regressions_of_a_network_are_those_of_a_simulation(compared: Comparison) -> None:
    """400 runs of N = 2000; 3.5 Monte Carlo standard errors and what is of order 1/N."""
    s = simulated()

    def at(name: str, k: int) -> Array:
        return s[name][:, BEFORE - k : BEFORE + N - k]

    y = at("w3", 0)

    def indirect(own: str, first: str, third: str) -> list[Array]:
        """G31 keeps its pole, w4 acts by 0.8: A = 1 - 0.5/q, B4 = 0.8 - 0.4/q."""
        return [-at(own, 1), at(first, 1), at(third, 0), at(third, 1)]

    def neglect(own: str, first: str) -> list[Array]:
        return [-at(own, 1), at(first, 1)]

    plain, clean = indirect("w3", "w1", "w4"), indirect("r3", "r1", "r4")
    found = {
        "indirect, LS": gain(solved(y, plain, plain), 1, slice(1, 2)),
        "indirect, IV": gain(solved(y, plain, clean), 1, slice(1, 2)),
        "neglect, LS": gain(solved(y, *[neglect("w3", "w1")] * 2), 1, slice(1, 2)),
        "neglect, IV": gain(solved(y, neglect("w3", "w1"), neglect("r3", "r1")), 1, slice(1, 2)),
    }
    for remedy, gains in found.items():
        limit, P = compared[remedy][NAMES[0]], compared[remedy].variance(NAMES[0])
        # The mean of a nonlinear function of theta is off by about its variance, P / N.
        assert abs(gains.mean() - limit) < 3.5 * math.sqrt(P / N / RUNS) + 2 * P / N, remedy
        ratio = N * gains.var(ddof=1) / P
        assert abs(ratio - 1) < 3.5 * math.sqrt(2 / RUNS) + 4 * P / N, remedy


# -- what is asked -------------------------------------------------------------------------------


def test_without_an_excitation_there_is_no_instrument() -> None:
    found = network_remedies(small(excitations=()), (3, 1), ways=("LS", "IV"))
    refused = {r.name: r.refused for r in found.rows if r.result is None}
    assert set(refused) == {f"{r}, IV" for r in ("all inputs known", "neglect", "immersed",
                                                 "indirect")}  # fmt: skip
    assert all("excite a node upstream" in why for why in refused.values())


def test_with_every_input_measured_the_true_relation_is_a_remedy() -> None:
    found = network_remedies(small(measured=(1, 2, 3)), (3, 1), ways=("LS", "PEM"))
    assert [r.name for r in found.rows] == ["true relation, PEM", "true relation, LS"]
    assert str(found).startswith("Estimators, every input measured")
    best = found.best(NAMES[0])
    assert best is not None
    assert best.remedy.startswith("true relation")


def test_a_sensor_that_feels_the_input_late_makes_the_relation_see_the_future() -> None:
    """w4 = w2 a sample late: eliminated by w4(t+1), with the output delayed; IV stays exact."""
    late = dynamic_network(
        {(3, 1): 0.6 / (q - 0.5), (3, 2): 0.8, (4, 2): 1 / q},
        excitations=(1, 2),
        measured=(1, 3, 4),
    )
    found = network_remedies(late, (3, 1), ways=("IV", "two-stage"))
    for way in ("IV", "two-stage"):
        row = next(r for r in found.rows if r.name == f"indirect, {way}")
        assert [row.bias(n) for n in NAMES] == [0, 0, 0]


def test_a_noisy_sensor_biases_what_uses_it_and_no_instrument() -> None:
    noisy = dynamic_network(
        {(2, 1): 0.6 / (q - 0.5)}, excitations=(1,), sensor_noise={1: 0.5, 2: 0.1}
    )
    found = network_remedies(noisy, (2, 1), ways=("PEM", "IV"))
    gain_of = "static gain of G21"
    rows = {r.name: r for r in found.rows}
    assert rows["true relation, PEM"].bias(gain_of) < -0.01
    assert rows["true relation, IV"].bias(gain_of) == 0
    assert rows["all inputs known, PEM"].bias(gain_of) == 0
    assert "noisy sensors on w1 (errors in variables)" in rows["true relation, PEM"].remark


@pytest.mark.slow
def test_the_thesis_network_has_its_indirect_model_offered() -> None:
    """(4.31): with w5 unknown, w4 takes its place for G23, which immersion changes."""
    found = network_remedies(network8, (2, 3), Orders(nb=1, nf=1), ways=("PEM", "IV"))
    rows = {r.name: r for r in found.rows}
    assert "G23 is kept; tau_4 confounds w2 and w4" in rows["indirect, PEM"].remark
    assert "G23 becomes -G23/(G25*G52 - 1)" in rows["immersed, PEM"].remark
    assert rows["indirect, PEM"].result is not None
    # One excitation, delta_6, for sixteen regressors.
    assert "Excite further nodes" in rows["indirect, IV"].refused


def test_a_question_that_cannot_be_answered_says_what_can() -> None:
    with pytest.raises(ModelError, match="no module G14; into w1 lead those from w2"):
        network_remedies(small(), (1, 4))
    with pytest.raises(ModelError, match="ways has 'OLS'; choose among PEM, LS, IV, two-stage"):
        network_remedies(small(), (3, 1), ways=["OLS"])
    with pytest.raises(ModelError, match="give 0 .. 3.142 rad/s"):
        network_remedies(small(), (3, 1), frequencies=[4.0])
    with pytest.raises(ModelError, match="give one number each, or leave orders out"):
        network_remedies(small(), (3, 1), Orders(nb={"w1": 1}))
    found = network_remedies(small(), (3, 2), ways=["LS"])
    refused = {r.name: r.refused for r in found.rows if r.result is None}
    assert "w2 has no sensor, so G32 is not in this relation" in refused["immersed"]
