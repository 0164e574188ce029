"""The same cause in consecutive records of an asset is one finding, with the time it began."""

from __future__ import annotations

import json
import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from casid.fleets.findings import Finding, Key, Outcome, findings_of, maximal_stretches
from casid.fleets.fleet_table import laws_of

OFFSET, BIAS = ("offset", "torque"), ("sensor_bias", "roll")


def outcome(
    number: int,
    *keys: Key,
    when: float | None = None,
    answer: bool = True,
    rivals: frozenset[Key] = frozenset(),
) -> Outcome:
    return Outcome(
        number,
        float(number) if when is None else when,
        answer,
        dict.fromkeys(keys, rivals),
        {key: (1.0 + 0.1 * number, 0.1) for key in keys},
        1e6 if keys else 0.5,
    )


def only(records: list[Outcome]) -> Finding:
    (finding,) = findings_of({"ship": records})
    return finding


def test_consecutive_records_with_one_cause_are_one_finding() -> None:
    found = only([outcome(i, *([OFFSET] if i >= 3 else [])) for i in range(7)])
    assert found.records == (3, 4, 5, 6)
    assert found.onset == (2.0, 3.0)
    assert found.is_lasting
    assert found.is_present
    assert found.size == pytest.approx(1.45)
    assert found.e_value == 1e6


def test_one_record_that_misses_a_lasting_cause_does_not_end_it() -> None:
    shown = {2, 3, 4, 6, 7, 8}
    found = only([outcome(i, *([OFFSET] if i in shown else [])) for i in range(9)])
    assert found.records == (2, 3, 4, 6, 7, 8)
    # Valid under any dependence: the mean over all records of the stretch, that without it too.
    assert found.e_value == pytest.approx((6e6 + 0.5) / 7)


def test_a_cause_that_comes_back_after_a_year_is_two_findings() -> None:
    shown = {1, 10}
    found = findings_of(
        {"ship": [outcome(i, *([OFFSET] if i in shown else [])) for i in range(12)]}
    )
    assert [f.records for f in found] == [(1,), (10,)]
    assert not any(f.is_lasting for f in found)
    assert not found[0].is_present


def test_records_without_an_answer_widen_the_onset() -> None:
    records = [outcome(i, *([OFFSET] if i >= 5 else []), answer=i not in (3, 4)) for i in range(8)]
    found = only(records)
    assert found.onset == (2.0, 5.0)


def test_a_cause_in_the_first_record_may_have_been_there_before() -> None:
    found = only([outcome(i, OFFSET) for i in range(3)])
    assert found.onset[0] == -math.inf


def test_rivals_that_no_record_separates_are_one_finding() -> None:
    """Named by what most of the records may have, whichever each of them names."""
    records = [
        outcome(0, OFFSET, rivals=frozenset({BIAS})),
        outcome(1, BIAS, rivals=frozenset({OFFSET})),
        outcome(2, OFFSET, rivals=frozenset({BIAS})),
    ]
    found = only(records)
    assert found.key == OFFSET
    assert found.also == (BIAS,)
    assert len(found.records) == 3


def test_two_causes_of_one_asset_are_two_findings() -> None:
    records = [outcome(i, OFFSET, *([BIAS] if i == 1 else [])) for i in range(4)]
    found = findings_of({"ship": records})
    assert {(f.key, len(f.records)) for f in found} == {(OFFSET, 4), (BIAS, 1)}


def test_a_cause_of_half_the_fleet_at_once_is_common() -> None:
    fouled = [outcome(i, *([OFFSET] if i > 1 else [])) for i in range(5)]
    clean = [outcome(i) for i in range(5)]
    fleet = {f"ship {i}": fouled if i < 4 else clean for i in range(6)}
    fleet["ship 5"] = [outcome(i, *([BIAS] if i > 2 else [])) for i in range(5)]
    common = {(f.asset, f.is_common) for f in findings_of(fleet)}
    assert common == {(f"ship {i}", True) for i in range(4)} | {("ship 5", False)}


@given(st.lists(st.integers(-5, 5).map(float), max_size=14))
def test_the_best_stretch_is_the_one_of_largest_sum(score: list[float]) -> None:
    found = maximal_stretches(score)
    sums = [sum(score[i:j]) for i in range(len(score)) for j in range(i + 1, len(score) + 1)]
    best = max([0.0, *sums])
    assert max([0.0, *(sum(score[a : b + 1]) for a, b in found)]) == best
    # They are apart, and each positive score lies in one.
    inside = [i for a, b in found for i in range(a, b + 1)]
    assert len(inside) == len(set(inside))
    assert set(np.flatnonzero(np.array(score) > 0)) <= set(inside)


def test_a_dead_voltage_is_called_one_in_a_fleet_too() -> None:
    """As in the diagnosis of its record, beside what it may be as well."""
    law = "a constant voltage that opposes i, as a dead voltage or a brush drop does"
    offset = ["offset", "coil", "a constant voltage"]
    dead = {"kind": "coulomb_friction", "where": "coil", "description": law, "rivals": [offset]}
    old = {"kind": "offset", "where": "coil", "rivals": [["sensor_bias", "i"]]}
    table = pd.DataFrame({"causes": [json.dumps([old]), "[]", json.dumps([dead])]})
    assert laws_of(table) == {
        ("coulomb_friction", "coil"): law,
        ("offset", "coil"): "a constant voltage",
    }
