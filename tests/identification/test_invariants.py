"""A declared choice: what is told whatever it is, and how far the rest moves."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.stats import binom

import casid
from analysis.ship_algorithm.study import ALL, along
from casid.errors import IdentifiabilityError
from casid.identifiability.requirement import unidentifiable_families
from casid.identification.invariants import Invariants
from problems import ship
from problems.ship import TABLE_8_2 as V

QUIET = ship.Sensors(gyro=0.001, accel=0.0, r=0.0)
"""Noise on the output alone: what the simulation error is consistent for."""


def records(seed: int) -> list[casid.Experiment]:
    return ship.experiments(duration=10.0, seed=seed, sensors=QUIET)


def once(problem: casid.Problem, experiments: list[casid.Experiment]) -> casid.Estimate:
    return casid.identify(problem, experiments, settings=casid.FitSettings(starts=1, substeps=1))


@pytest.fixture(scope="module")
def families():
    return unidentifiable_families(ship.nine_parameters().model, records(0))


@pytest.fixture(scope="module")
def nine(families) -> Invariants:
    return casid.invariants(ship.nine_parameters(), records(0), hold=["z_f"], families=families)


# -- the nine parameters of the ship ---------------------------------------------------------------


@pytest.mark.slow
def test_of_the_nine_parameters_only_the_height_of_the_load_is_told(nine):
    assert list(nine.identifiable) == ["zbar_m"]
    assert set(nine.moving) == {"k", "A_x", "d", "K_r", "K_vdot", "K_delta", "z_f", "m"}
    assert (
        abs(nine.identifiable["zbar_m"].value - V["zbar_m"])
        < 4 * nine.identifiable["zbar_m"].std_error
    )
    low, high = nine.interval("m")
    assert low < V["m"] < high
    assert nine.moving["m"].spread < 1.0 < nine.moving["k"].spread


@pytest.mark.slow
def test_the_mass_moves_with_the_slope_of_the_thesis(nine):
    """d m/d z_f = m [1/(zbar_c + z_f) - 1/(zbar_m + z_f)], -0.0952 kg/m at the truth."""

    def slope(m: float, zbar_m: float, z_f: float) -> float:
        return m * (1 / (-0.172 + z_f) - 1 / (zbar_m + z_f))

    assert slope(V["m"], V["zbar_m"], V["z_f"]) == pytest.approx(-0.0952, abs=1e-4)
    at = nine.along[0].values
    wanted = slope(at["m"], at["zbar_m"], at["z_f"])
    assert nine.moving["m"].slope == pytest.approx(wanted, rel=1e-9)
    assert nine.moving["m"].held == "z_f"


@pytest.mark.slow
def test_a_moving_parameter_is_a_range_and_never_a_number_with_an_error(nine):
    lines = str(nine).splitlines()
    for name in nine.moving:
        row = next(line for line in lines if line.split()[:1] == [name])
        assert "+-" not in row
    saved = json.loads(json.dumps(nine.to_json()))
    assert "value" not in saved["moving"]["m"]
    assert "std_error" not in saved["moving"]["m"]
    assert saved["held"] == {"z_f": nine.along[0].at}
    assert "z_f" in lines[1]
    assert "a choice" in lines[1]


@pytest.mark.slow
def test_combinations_are_told_in_place_of_what_moves(nine):
    """All invariants but zbar_m itself: each at the truth within 4 standard errors."""
    import sympy

    truth = {**V, "zbar_m_calibration": -0.172, "m_calibration": 0.2}
    assert len(nine.combinations) == 7
    for c in nine.combinations:
        expected = float(sympy.sympify(c.name).subs(truth))
        assert c.std_error is not None
        assert abs(c.value - expected) < 4 * c.std_error


@pytest.mark.slow
def test_intervals_of_mass_and_height_hold_the_truth_whatever_was_held(families):
    """Six draws, z_f held off the truth; fewer than the 0.1 % point of a 95 % interval fails."""
    hits = {"m": 0, "zbar_m": 0}
    for seed in range(6):
        found = casid.invariants(
            ship.nine_parameters(), records(seed + 1), once, hold={"z_f": -0.032}, families=families
        )
        for n in hits:
            low, high = found.interval(n)
            hits[n] += low <= V[n] <= high
    assert min(hits.values()) >= binom.ppf(0.001, 6, 0.95)


@pytest.mark.slow
def test_least_squares_and_simulation_error_say_the_same_of_noiseless_records(families):
    """One calibrated ship, two estimators: m and zbar_m to what the bilinear rule leaves, 1 %."""
    made = ship.experiments(duration=20.0, sensors=ship.NOISELESS)
    found = casid.invariants(
        ship.nine_parameters(), made, casid.least_squares, hold={"z_f": V["z_f"]}, families=families
    )
    assert list(found.identifiable) == ["zbar_m"]
    assert found.identifiable["zbar_m"].value == pytest.approx(V["zbar_m"], rel=0.01)
    moved = along(found.estimate, families[0])
    for n in found.moving:
        np.testing.assert_allclose(found.moving[n].range, moved.ranges[n], rtol=1e-3)
    assert set(ALL.parameters) == set(ship.nine_parameters().model.parameters)


# -- force and mass ------------------------------------------------------------------------------


def spring(**bounds: float) -> casid.Model:
    """M x'' = -k x - d x' + b F, read with an offset c: only ratios to M, and c, are told."""
    m = casid.Model("mass on a spring")
    x, v, F = m.state("x", "m"), m.state("v", "m/s"), m.input("F", "N", hold="zoh")
    M = m.parameter("M", "kg", start=1.0, **({"lower": 0.1, "upper": 10.0} | bounds))
    k = m.parameter("k", "N/m", start=3.0, **({"lower": 0.1, "upper": 100.0} | bounds))
    d = m.parameter("d", "N s/m", start=0.3, **({"lower": 0.01, "upper": 10.0} | bounds))
    b = m.parameter("b", "1", start=1.0, **({"lower": 0.1, "upper": 5.0} | bounds))
    c = m.parameter("c", "m", start=0.0, lower=-1.0, upper=1.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[-k * x, -d * v, b * F])
    m.output("pos", x + c, "m")
    return m


SPRING = {"M": 2.0, "k": 8.0, "d": 0.8, "b": 1.5, "c": 0.1}


def sprung(seed: int) -> casid.Experiment:
    """Exact steps under a force held over each sample, read with white noise of 5 mm."""
    from scipy.linalg import expm

    rng = np.random.default_rng(seed)
    M, k, d, b, c = SPRING.values()
    step = expm(0.05 * np.array([[0, 1, 0], [-k / M, -d / M, b / M], [0, 0, 0]]))
    F = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    x, path = np.zeros(2), []
    for force in F:
        path.append(x[0])
        x = step[:2, :2] @ x + step[:2, 2] * force
    pos = np.array(path) + c + 0.005 * rng.standard_normal(F.size)
    record = casid.Record({"F": F, "pos": pos}, {"F": "N", "pos": "m"}, Ts=0.05, name="run")
    return casid.Experiment(record, {}, "run")


@pytest.fixture(scope="module")
def ratios():
    return unidentifiable_families(spring(), [sprung(0)])


def test_of_a_mass_moved_by_a_scaled_force_only_ratios_are_told(ratios):
    found = casid.invariants(spring(), sprung(0), families=ratios)
    assert list(found.identifiable) == ["c"]
    assert {c.name for c in found.combinations} == {"k/M", "b/M", "d/M"}
    # The scaling ends where the first parameter meets a bound: lam = 5/b above, 0.1/b and so on.
    a = found.along[0]
    at = a.values
    top = min(10 / at["M"], 100 / at["k"], 10 / at["d"], 5 / at["b"])
    low = max(0.1 / at["M"], 0.1 / at["k"], 0.01 / at["d"], 0.1 / at["b"])
    assert found.moving["k"].range == pytest.approx((low * at["k"], top * at["k"]), rel=1e-6)


@pytest.mark.slow
def test_intervals_of_ratios_hold_the_truth_in_95_of_100_draws(ratios):
    """Twenty draws of a white error; each count at least its 0.1 % point."""
    wanted = {"k/M": 4.0, "b/M": 0.75, "d/M": 0.4, "c": 0.1}
    hits = dict.fromkeys(wanted, 0)
    for seed in range(20):
        found = casid.invariants(
            casid.Problem("spring", spring()), sprung(seed), once, hold={"M": 1.0}, families=ratios
        )
        for p in (*found.combinations, *found.identifiable.values()):
            assert p.std_error is not None
            hits[p.name] += abs(p.value - wanted[p.name]) < 1.96 * p.std_error
    assert min(hits.values()) >= binom.ppf(0.001, 20, 0.95)


# -- asked for what cannot be ----------------------------------------------------------------------


def test_where_all_is_told_nothing_is_held():
    found = casid.invariants(spring().with_known(M=2.0), sprung(0))
    assert not found.moving
    assert not found.held
    assert set(found.identifiable) == {"k", "d", "b", "c"}


def test_the_refusal_of_identify_names_the_way_out():
    with pytest.raises(IdentifiabilityError, match="casid.invariants reports what is identifiable"):
        casid.identify(spring(), sprung(0))


@pytest.mark.slow
def test_what_cannot_be_held_is_refused_with_the_mend(ratios):
    """M = 9.9 kg would take b = 7.4, above its bound of 5."""

    def beyond(problem: casid.Problem, experiments: list[casid.Experiment]) -> casid.Estimate:
        return casid.identify(problem, experiments, start={"k": 39.0, "b": 4.9, "d": 3.9})

    with pytest.raises(IdentifiabilityError, match="one of M, k, d, b"):
        casid.invariants(spring(), sprung(0), hold=["c"], families=ratios)
    with pytest.raises(IdentifiabilityError, match="give lower= and upper="):
        casid.invariants(spring(upper=np.inf), sprung(0), families=ratios)
    with pytest.raises(IdentifiabilityError, match="name a value: hold="):
        casid.invariants(spring(), sprung(0), beyond, hold={"M": 9.9}, families=ratios)
    with pytest.raises(IdentifiabilityError, match="a surface and no curve"):
        casid.invariants(spring(), sprung(0), families=[*ratios, *ratios])
