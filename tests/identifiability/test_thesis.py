"""What can be told in Linder (2017): the pendulum of chapter 7, the ship of chapter 8.

The thesis' ranks and tables of the ship are those of a sensor at a known height beside an axis at
an unknown one; where the sensor's height moves with the axis, as in the model that is fitted, ranks
differ, and the tests say so. Sets are compared one by one, not only by number.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import casadi as ca
import numpy as np
import pytest

from analysis.identifiability_tables import study as identifiability_tables
from analysis.identifiability_tables.models import (
    BOTH,
    GYRO,
    PENDULUM,
    as_sets,
    calibration,
    excluded,
    exclusions,
    holding,
    nominal,
    pendulum_rule,
    pendulum_system,
    ship_family,
    ship_records,
    ship_rule,
    ship_slopes,
    ship_system,
    three_record_rule,
    true_ship,
    with_sought,
)
from casid.algebra.prime_field import matmul, random_prime, to_field
from casid.algebra.symbolic import evaluate_exactly
from casid.identifiability.combinations.fixing_sets import fixing_sets
from casid.identifiability.equations.model_system import translated
from casid.identifiability.rank.observability import observability, rank_at
from problems import pendulum, ship
from problems.ship import NINE

PENDULUMS = [(False, GYRO), (False, BOTH), (True, GYRO)]
TURNS = ("K_ur", "K_r")


def sought(**how):
    """The ship with M and zbar_g known, nine parameters unknown."""
    return with_sought(ship_system(**how))


def fixed(systems, name):
    return [s.with_known(name) if name in s.parameters else s for s in systems]


# -- the pendulum ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("is_indirect", "outputs"), PENDULUMS)
def test_at_most_three_pendulum_parameters_are_told_and_table_7_1_says_which(is_indirect, outputs):
    """Rank 5 with two states; 1 of 28 pairs, 22 of 56 triples; the indirect model loses nothing.

    (a) I_x with I_xm, (b) any three of I_x, M, z_g, I_xm, m, z_m: Table 7.1, Result 7.1.
    """
    found = observability(pendulum_system(is_indirect=is_indirect, outputs=outputs))
    assert found.rank == 5
    assert found.error_bound <= 1e-12
    assert excluded(found, 1).count == 0
    assert as_sets(excluded(found, 2)) == {frozenset({"I_x", "I_xm"})}
    triples = excluded(found, 3)
    assert (triples.count, triples.total) == (22, 56)
    assert as_sets(triples) == holding(PENDULUM, 3, pendulum_rule())
    assert excluded(found, 4).count == excluded(found, 4).total


@pytest.mark.parametrize(("is_indirect", "outputs"), PENDULUMS)
def test_a_pendulum_whose_cart_rests_tells_two_parameters_though_a_s_moves(is_indirect, outputs):
    """Rank 4: with a_y = 0 the input a_s is a function of the states (section 7.3.1)."""
    system = pendulum_system(is_indirect=is_indirect, outputs=outputs, is_moved=False)
    found = observability(system)
    assert found.rank == 4
    assert excluded(found, 1).count == 0
    assert as_sets(excluded(found, 2)) == {frozenset({"I_x", "I_xm"})}
    assert excluded(found, 3).count == 56


def test_an_input_taken_as_arbitrary_would_hide_that_the_cart_rests():
    """The same indirect model with a_s free has rank 5: the feedback is what takes one away."""
    resting = pendulum_system(is_indirect=True, is_moved=False)
    assert resting.inputs == ()
    assert observability(pendulum_system(is_indirect=True)).rank == observability(resting).rank + 1


@pytest.mark.parametrize("is_indirect", [False, True])
def test_nominal_and_loaded_pendulums_tell_five_of_seven_parameters(is_indirect):
    """Section 7.4 with I_xm = 0: to be known are M, z_g or I_x, and one more of all but z_m.

    The records tell S and I_1 up to a common factor, so z_m is the ratio of their changes.
    """
    loaded = pendulum_system(is_indirect=is_indirect).with_known("I_xm").substituted({"I_xm": 0.0})
    found = observability([nominal(loaded), loaded])
    assert (found.rank, found.unknowns, found.deficiency) == (9, 11, 2)
    assert found.identifiable["z_m"]
    point = found.points[0]
    fixing = fixing_sets(point.information, point.parameters, point.prime)
    hull = {"M", "z_g", "I_x"}
    others = hull | {"k", "d", "m"}
    wanted = {frozenset(p) for p in combinations(others, 2) if hull & {*p}}
    assert {frozenset(s) for s in fixing.sets} == wanted


# -- the ship: ranks -------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize(("how", "ranks"), identifiability_tables.RANK_TABLE)
def test_the_ships_rank_by_sensor_model_and_number_of_records(how, ranks, turn):
    """1, 2, 3 and 4 records: the thesis has 7, 11 and 15; (8.20) as used has 14 with three."""
    records = ship_records(ship_system(turn=turn, **how))
    assert tuple(observability(s).rank for s in records.values()) == ranks


def test_direct_and_indirect_model_tell_the_same_only_of_a_sensor_at_a_known_height():
    """Eliminating the sway acceleration costs a parameter where z_s = zbar_s + z_f."""
    for tied, lost in ((False, 0), (True, 1)):
        direct, indirect = (
            observability(ship_records(ship_system(tied=tied, is_indirect=i))["with calibration"])
            for i in (False, True)
        )
        assert direct.rank - indirect.rank == lost


# -- the ship: sets of parameters ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("turn", "counts"), [("K_ur", (0, 0, 20, 115, 296, 462)), ("K_r", (0, 0, 20, 130, 326, 462))]
)
def test_table_8_1_holds_set_by_set_for_a_sensor_at_a_known_height(turn, counts):
    """165, 330 and 462 sets of 3, 4 and 5; with K_r free {k, K_vdot} stands for {k, K_ur, K_vdot}.

    No set of six is identifiable: rank 7 leaves five parameters.
    """
    system = ship_system(tied=False, turn=turn, outputs=BOTH)
    found = exclusions([system], range(1, 7))
    assert tuple(e.count for e in found.values()) == counts
    assert [found[n].total for n in (3, 4, 5)] == [165, 330, 462]
    for size in (1, 2, 3, 4, 5):
        assert as_sets(found[size]) == holding(system.parameters, size, ship_rule(turn))


@pytest.mark.parametrize(("turn", "count"), [("K_ur", 43), ("K_r", 46)])
@pytest.mark.parametrize(("tied", "outputs"), [(False, BOTH), (True, GYRO), (True, BOTH)])
def test_three_records_of_the_direct_model_tell_nine_parameters_by_the_rule(
    turn, count, tied, outputs
):
    """Not those that hold {A_x, M, zbar_g}, or the turning set and two of them: of 55 sets."""
    system = ship_system(tied=tied, turn=turn, outputs=outputs)
    nines = exclusions(ship_records(system)["with calibration"], [9])[9]
    assert (nines.count, nines.total) == (count, 55)
    assert as_sets(nines) == holding(system.parameters, 9, three_record_rule(turn))


def test_no_nine_parameters_are_told_by_three_records_of_the_indirect_model():
    system = ship_system(is_indirect=True)
    nines = exclusions(ship_records(system)["with calibration"], [9])[9]
    assert nines.count == nines.total == 55


# -- the ship: the nine parameters -----------------------------------------------------------------


def test_the_nine_parameters_as_they_are_fitted_have_rank_14_of_15():
    """By generic numbers, and with the very numbers of Table 8.2, where zbar_g = 0."""
    records = ship_records(sought(is_indirect=True))["with calibration"]
    fitted = translated(ship.nine_parameters(), ship.experiments(duration=1.0)).systems
    for systems in (records, fitted):
        found = observability(systems)
        assert (found.rank, found.unknowns, found.deficiency) == (14, 15, 1)
        assert [n for n in NINE if found.identifiable[n]] == ["zbar_m"]
    direct = ship_records(sought(outputs=BOTH))["with calibration"]
    assert observability(direct).is_full


def test_eight_parameters_with_z_f_known_are_told_by_the_problem_as_it_stands():
    assert observability(translated(ship.problem, ship.experiments(duration=1.0)).systems).is_full


@pytest.mark.parametrize("name", NINE)
def test_knowing_any_of_the_nine_but_zbar_m_tells_the_others(name):
    records = ship_records(sought(is_indirect=True))["with calibration"]
    assert observability(fixed(records, name)).is_full == (name != "zbar_m")


def test_a_second_calibration_helps_at_another_height_only():
    """The calibration tells a ratio that its height alone decides."""
    system = sought(is_indirect=True)
    first = calibration(system)
    seconds = {
        "again": (first, 16),
        "another weight": (calibration(system, mass="m_c2"), 16),
        "another height": (calibration(system, height="zbar_c2"), 17),
        "both": (calibration(system, mass="m_c2", height="zbar_c2"), 17),
    }
    for second, rank in seconds.values():
        assert observability([nominal(system), first, second, system]).rank == rank
    fitted = ship.two_calibrations()
    cases = ("nominal", "calibration", "second calibration", "loaded")
    assert observability(translated(fitted, ship.experiments(cases, duration=1.0)).systems).is_full


def test_the_family_of_the_nine_parameters_leaves_all_three_records_as_they_are():
    """Exact fractions: f of (8.20) is the same at random states, for any height of the axis."""
    e = ship.indirect_model().explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    true = true_ship()
    rng = np.random.default_rng(5)

    def rates(values, load, x, u):
        v = {**values, **load}
        return evaluate_exactly(f, x, u, [v[n] for n in e.parameters])

    weight = {"m": true["m_c"], "zbar_m": true["zbar_c"]}
    for z_f in (Fraction(-1, 10), Fraction(-3, 100), Fraction(1, 7)):
        moved = {**true, **ship_family(true, z_f)}
        assert moved["zbar_m"] == true["zbar_m"]
        assert moved["m"] != true["m"]
        for load in ({"m": Fraction(0)}, weight, {}):
            x, u = ([Fraction(int(i), 7) for i in rng.integers(1, 99, n)] for n in (2, 3))
            assert rates(moved, load, x, u) == rates(true, load, x, u)
    assert ship_family(true, true["z_f"]) == {n: true[n] for n in NINE}


def test_the_direction_that_the_rank_leaves_open_is_the_familys():
    """Tangent at Table 8.3, modulo a prime; its slopes are those printed in four digits."""
    records = ship_records(sought(is_indirect=True))["with calibration"]
    slopes, rng = ship_slopes(), np.random.default_rng(1)
    prime = random_prime(rng)
    values = {n: to_field(v, prime) for n, v in true_ship().items()}
    point = rank_at(records, prime, values=values, rng=rng)
    direction = np.array([[to_field(slopes[n], prime)] for n in point.parameters])
    assert point.information.shape == (8, 9)
    assert not matmul(point.information, direction, prime).any()
    found = {n: float(s) for n, s in slopes.items()}
    printed = {"k": -238.0, "d": -1.0335, "K_r": 2.5, "K_vdot": -19.45, "K_delta": 2.025}
    for name, slope in {**printed, "A_x": -0.0618, "m": -0.0952, "zbar_m": 0.0}.items():
        assert found[name] == pytest.approx(slope, rel=5e-4, abs=1e-12)


def test_the_mass_is_told_where_the_load_stands_as_high_as_the_calibration_weight():
    """zbar_m always is; m exactly where zbar_m = zbar_c, which no generic point shows."""
    records = ship_records(sought(is_indirect=True))["with calibration"]
    rng = np.random.default_rng(2)
    point = rank_at(records, random_prime(rng), values={"zbar_m": 12345, "zbar_c": 12345}, rng=rng)
    told = dict(zip(point.parameters, point.identifiable(), strict=True))
    assert {n for n in NINE if told[n]} == {"m", "zbar_m"}


# -- the program -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_tables_are_printed_with_every_target_met(capsys, tmp_path):
    assert identifiability_tables.STUDY.main(["--quick", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "MISS" not in printed
    assert (tmp_path / "identifiability_tables.json").stat().st_size > 0


def test_the_models_are_those_that_are_fitted():
    """Nothing was written anew: all parameters of the systems are the models' own."""
    assert set(PENDULUM) <= set(pendulum.linear_model().parameters)
    assert set(ship_system(is_indirect=True).parameters) == {*NINE, "M", "zbar_g"}
