"""The study of the diagnosis's power: what its cases, its rules and its counts stand on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from analysis.diagnosis_power import study as diagnosis_power
from analysis.diagnosis_power.cases import SETTINGS, SINGLE, STRANGE, draw_case, make
from analysis.diagnosis_power.energy import (
    SHARE,
    divergence_of_outliers,
    energy_of_samples,
    strength_of_outliers,
    visible_energy,
)
from analysis.diagnosis_power.figures import figures_of
from analysis.diagnosis_power.judgement import (
    found_of_pair,
    has_truth,
    is_doubtful,
    is_flagged,
    is_right,
    is_wrong_name,
)
from analysis.diagnosis_power.page import NONE, TABLES, page_of
from analysis.diagnosis_power.runs import judged_by_oracles, problem_of
from analysis.diagnosis_power.study import key_of, rows_of, run_cases, tasks_of
from analysis.diagnosis_power.tables import rate, summary_of
from analysis.diagnosis_power.targets import targets_of
from casid.model.effects.effect import KINDS

Row = dict[str, Any]
WHO = ("peer", "casid")


def cause(kind: str, where: str, *alternatives: tuple[str, str]) -> Row:
    rivals = [[kind, where, 0.2] for kind, where in alternatives]
    return {"kind": kind, "where": where, "p": 1e-6, "alternatives": rivals}


def row(kind: str, where: str, *causes: Row, energy: float = 500.0, **more: Any) -> Row:
    return {
        "part": "single",
        "number": 0,
        "kind": kind,
        "where": where,
        "energy": energy,
        "verdict": "deficient" if causes else "adequate",
        "causes": list(causes),
        "unexplained": None,
        "duration": 60.0,
        "Ts": 0.01,
        "noise": 0.01,
        **more,
    }


# -- the cases ------------------------------------------------------------------------------------


def test_a_case_depends_on_its_part_and_number_alone() -> None:
    assert draw_case("single", 7) == draw_case("single", 7)
    assert draw_case("single", 7).seed != draw_case("single", 7 + len(SINGLE)).seed
    first = make(draw_case("nulls", 0)).record["gyro"]
    np.testing.assert_array_equal(first, make(draw_case("nulls", 0)).record["gyro"])


def test_null_records_fill_every_cell_alike() -> None:
    cells = [(c.duration, c.noise) for c in (draw_case("nulls", n) for n in range(24))]
    assert len(set(cells)) == 2 * len(SETTINGS)
    assert all(cells.count(cell) == 4 for cell in cells)


def test_every_kind_is_hidden_equally_often() -> None:
    singles = [draw_case("single", n).kind for n in range(2 * len(SINGLE))]
    assert sorted(singles) == sorted([kind for kind, _ in SINGLE] * 2)
    unlisted = [draw_case("unlisted", n) for n in range(2 * len(STRANGE))]
    assert {c.kind for c in unlisted if not c.without} == set(STRANGE) - set(KINDS)
    assert {c.kind for c in unlisted} >= set(STRANGE)
    assert all(c.kind in c.without for c in unlisted if c.without)


def test_energies_are_spread_evenly_in_their_logarithm() -> None:
    """The mean of log(lambda) over n draws has the spread (log 10000/30) / sqrt(12 n)."""
    logs = [np.log(draw_case("single", n).energy) for n in range(300)]
    middle, width = 0.5 * np.log(30 * 10_000), np.log(10_000 / 30)
    assert np.mean(logs) == pytest.approx(middle, abs=4 * width / np.sqrt(12 * 300))


def test_what_the_set_up_cannot_show_has_no_energy_and_an_effect_has_some() -> None:
    """A null leaves less than a tenth of the smallest energy drawn; an effect near what was asked.

    The energy is less than the strength says where accelerometer noise takes some, and at most the
    share 1.5 more that it is asked for.
    """
    problem = problem_of("pendulum")
    for part, number, low, high in (("nulls", 0, 0.0, 3.0), ("single", 9, 0.2, 1.6)):
        hidden = make(draw_case(part, number))
        energy = visible_energy(problem, hidden.clean, hidden.sd, hidden.start)
        asked = hidden.case.energy or 1.0
        assert low * asked <= energy <= high * asked


@pytest.mark.parametrize(("number", "low", "high"), [(0, 0.0, 3.0), (3, 0.5, 2.0)])
def test_a_ship_shows_the_energy_that_is_asked_for_and_none_where_nothing_is_hidden(
    number: int, low: float, high: float
) -> None:
    """A search of three steps ends well within a factor of two; a null leaves what foh leaves."""
    hidden = make(draw_case("ship", number))
    assert (hidden.case.kind == "none") == (number % 2 == 0)
    energy = visible_energy(problem_of("ship"), hidden.clean, hidden.sd, hidden.start)
    asked = hidden.case.energy or 1.0
    assert low * asked <= energy <= high * asked


def test_every_second_ship_hides_nothing_and_the_kinds_come_by_turns() -> None:
    kinds = [draw_case("ship", n).kind for n in range(20)]
    assert kinds[::2] == ["none"] * 10
    assert all(kinds[1::2].count(kind) == 2 for kind in set(kinds[1::2]))


# -- energies of outliers -------------------------------------------------------------------------


@pytest.mark.parametrize("size", [3.0, 8.0])
def test_the_energy_of_outliers_is_the_mean_log_likelihood_ratio(size: float) -> None:
    """Against n draws from the mixture: within four standard errors of their mean."""
    n, rng = 400_000, np.random.default_rng(1)
    height = size * rng.uniform(0.7, 1.3, n) * rng.choice([-1.0, 1.0], n)
    x = rng.standard_normal(n) + np.where(rng.random(n) < SHARE, height, 0.0)
    tall = sum(norm.cdf(s * x - 0.7 * size) - norm.cdf(s * x - 1.3 * size) for s in (1.0, -1.0))
    f = (1 - SHARE) * norm.pdf(x) + SHARE * tall / (2 * 0.6 * size)
    best = np.sqrt(1.0 + SHARE * size**2 * (1.0 + 0.3**2 / 3.0))
    ratio = np.log(f) - norm.logpdf(x, scale=best)
    error = float(ratio.std()) / np.sqrt(n)
    assert divergence_of_outliers(size) == pytest.approx(float(ratio.mean()), abs=4 * error)


def test_small_outliers_are_a_larger_noise_and_nothing_else() -> None:
    """Two densities of equal variance differ by cumulants of order four.

    KL = c_4^2 / 48 to first order (Edgeworth), with the fourth cumulant c_4 = q E[h^4] - 3 q^2
    E[h^2]^2 growing as the size to the fourth: the energy as its eighth power, where the squared
    distance grows as the second.
    """
    size = 0.3
    h_2, h_4 = 1.0 + 0.3**2 / 3, (1.3**5 - 0.7**5) / (5 * 0.6)
    fourth = SHARE * h_4 * size**4 - 3 * (SHARE * h_2 * size**2) ** 2
    assert divergence_of_outliers(size) == pytest.approx(fourth**2 / 48, rel=0.15)


@pytest.mark.parametrize("energy", [30.0, 1000.0, 10_000.0])
def test_outliers_of_an_energy_have_it(energy: float) -> None:
    strength = strength_of_outliers(energy, 6000)
    assert energy_of_samples("outliers", strength, 6000) == pytest.approx(energy, rel=1e-4)


def test_outliers_written_by_an_older_definition_are_counted_by_the_present_one(
    tmp_path: Path,
) -> None:
    old = {**row("outliers", "gyro", energy=1500.0), "N": 6000, "strength": 0.5}
    pair = {**row("deadzone", "torque"), "part": "pairs", "N": 6000, "strength": 0.5}
    pair |= {"second": {"kind": "outliers", "where": "gyro", "strength": 0.5}, "second_energy": 1.0}
    clipped = {**row("saturation", "gyro", energy=7.0), "number": 1, "N": 6000, "strength": 0.5}
    file = tmp_path / "cases.jsonl"
    file.write_text("".join(json.dumps(r) + "\n" for r in (old, pair, clipped)), encoding="utf-8")
    single, two, third = rows_of(file)
    now = energy_of_samples("outliers", 0.5, 6000)
    assert 100.0 < now < 1050.0  # 0.5^2 * 0.7 * 6000: what knowing the places would give
    assert single["energy"] == pytest.approx(now)
    assert (two["energy"], two["second_energy"]) == pytest.approx((500.0, now))
    assert third["energy"] == 7.0


# -- the rules ------------------------------------------------------------------------------------


def test_timing_is_one_class_and_strictly_three() -> None:
    late = row("sensor_lag", "gyro", cause("time_delay", "accel"))
    assert is_right(late)
    assert not is_right(late, strictly=True)
    assert not is_wrong_name(late)
    assert is_right(row("time_delay", "gyro", cause("hold", "accel")))


def test_timing_of_another_channel_or_of_an_actuator_is_another_cause() -> None:
    assert is_wrong_name(row("time_delay", "gyro", cause("time_delay", "r")))
    assert is_wrong_name(row("time_delay", "gyro", cause("actuator_lag", "delta")))
    assert is_wrong_name(row("time_delay", "delta", cause("time_delay", "gyro")))


def test_a_place_must_be_right_and_a_load_has_many() -> None:
    assert is_wrong_name(row("parameter_jump", "k", cause("parameter_jump", "d")))
    assert is_right(row("parameter_jump", "m", cause("parameter_jump", "I_x")))
    assert is_wrong_name(row("parameter_jump", "m", cause("parameter_jump", "d")))
    assert is_wrong_name(row("parameter_drift", "k", cause("parameter_jump", "k")))
    assert is_wrong_name(row("extra_input", "yaw_rate", cause("extra_input", "ref")))


@pytest.mark.parametrize(("hidden", "named"), [("k", "m"), ("m", "k"), ("k", "I_x")])
def test_stiffness_and_load_stand_for_each_other_only_side_by_side(hidden: str, named: str) -> None:
    alone = row("parameter_jump", hidden, cause("parameter_jump", named))
    assert is_wrong_name(alone)
    beside = cause("parameter_jump", named, ("parameter_jump", hidden))
    both = row("parameter_jump", hidden, beside)
    assert is_right(both)
    assert not is_right(both, strictly=True)
    drift = cause("parameter_drift", named, ("parameter_jump", hidden))
    assert not is_right(row("parameter_jump", hidden, drift))


def test_unknown_is_a_flag_and_no_name() -> None:
    flagged = row("quadratic_damping", "torque", cause("unknown", "torque"))
    assert is_flagged(flagged)
    assert not is_wrong_name(flagged)
    doubted = cause("quadratic_damping", "torque", ("unknown", "torque"))
    assert is_flagged(row("quadratic_damping", "torque", doubted))
    plain = row("quadratic_damping", "torque", cause("quadratic_damping", "torque"))
    assert not is_flagged(plain)
    assert is_flagged({**plain, "unexplained": "a line at 2 Hz"})


def test_the_truth_may_stand_among_the_alternatives() -> None:
    doubted = row("deadzone", "torque", cause("cubic_stiffness", "torque", ("deadzone", "torque")))
    assert has_truth(doubted)
    assert is_doubtful(doubted)
    assert not is_right(doubted)
    assert not is_wrong_name(doubted)
    alone = row("deadzone", "torque", cause("cubic_stiffness", "torque"))
    assert is_wrong_name(alone)
    assert not is_doubtful(alone)


def test_one_cause_does_not_stand_for_two() -> None:
    both: Row = {"second": {"kind": "sensor_lag", "where": "gyro"}}
    once = row("time_delay", "gyro", cause("time_delay", "gyro"), **both)
    assert found_of_pair(once) == (True, False)
    twice = [cause("time_delay", "gyro"), cause("sensor_lag", "gyro")]
    assert found_of_pair(row("time_delay", "gyro", *twice, **both)) == (True, True)


# -- the counts -----------------------------------------------------------------------------------


def test_the_interval_of_a_rate_is_clopper_and_pearsons() -> None:
    """No hit of n leaves 1 - 0.025^(1/n) above; Clopper and Pearson (1934)."""
    none = rate(0, 20)
    assert none["low"] == 0.0
    assert none["high"] == pytest.approx(1 - 0.025 ** (1 / 20))
    assert rate(20, 20)["low"] == pytest.approx(0.025 ** (1 / 20))


def test_a_short_study_misses_a_target_only_beyond_chance() -> None:
    """One of four missed is likely at 95 % (19 %), three are not (5e-4)."""

    def met(wrong: int) -> bool:
        good = row("deadzone", "torque", cause("deadzone", "torque"))
        bad = row("deadzone", "torque")
        rows = [{**(bad if n < wrong else good), "number": n} for n in range(4)]
        targets = targets_of(summary_of(rows), quick=True)
        return next(t.is_met for t in targets if t.what == "named right, lambda >= 100")

    assert met(1)
    assert not met(3)


def test_a_failed_case_misses_the_first_target() -> None:
    rows = [{**row("deadzone", "torque"), "error": "SolveError: the criterion is not finite"}]
    first, *_ = targets_of(summary_of(rows))
    assert first.what == "cases that fail"
    assert not first.is_met


def test_peers_are_held_to_the_false_alarms_of_null_records() -> None:
    """At 5 % the threshold is the nulls' 95th percentile: below it nothing is named.

    The peers are said to name deadzones alone, so that of three kinds they have two at best.
    """
    from analysis.diagnosis_power.peers import PEERS

    def found(statistic: float) -> Row:
        name = {"statistic": statistic, "kind": "deadzone", "where": "torque"}
        return dict.fromkeys(PEERS, name)

    nulls = [{**row("none", "torque"), "part": "nulls", "number": n} for n in range(101)]
    quiet = [
        {"part": "peers", "of": "nulls", "number": n, "peers": found(n), "kind": "none"}
        for n in range(101)
    ]
    singles, judged = [], []
    hidden_kinds = (("deadzone", 94.0), ("deadzone", 96.0), ("outliers", 97.0))
    for n, (kind, statistic) in enumerate(hidden_kinds):
        singles.append({**row(kind, "torque", cause(kind, "torque")), "number": n})
        peer = {"part": "peers", "of": "single", "number": n, "peers": found(statistic)}
        judged.append({**peer, "kind": kind, "where": "torque"})
    rivals = summary_of([*nulls, *quiet, *singles, *judged])["rivals"]
    assert rivals["t-test"]["threshold"] == pytest.approx(95.0)

    def counts(group: str) -> list[tuple[int, int]]:
        return [(r["hits"], r["of"]) for r in (rivals["t-test"][group][w] for w in WHO)]

    assert counts("expressible") == [(1, 2), (2, 2)]
    assert counts("all") == [(1, 3), (3, 3)]  # a peer cannot name what it has no column for
    every = [*nulls, *quiet, *singles, *judged]
    target = next(t for t in targets_of(summary_of(every)) if "best peer" in t.what)
    assert target.is_met
    assert "3 of 3" in target.found
    assert "1 of 3" in target.found


# -- the file of cases ----------------------------------------------------------------------------


def test_a_run_that_was_stopped_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line cut off by a kill is done again, a failed case too, a finished one is not."""
    asked = []

    def work(part: str, number: int) -> Row:
        asked.append(number)
        return {"part": part, "number": number}

    monkeypatch.setattr(diagnosis_power, "diagnosed", work)
    file = tmp_path / "cases.jsonl"
    lines = [{"part": "single", "number": 0}, {"part": "single", "number": 1, "error": "x"}]
    file.write_text("\n".join(json.dumps(r) for r in lines) + '\n{"part": "si', encoding="utf-8")
    assert len(list(run_cases(file, tasks_of("single", 0, 3), jobs=1))) == 2
    assert asked == [1, 2]
    assert sorted(key_of(r)[2] for r in rows_of(file)) == [0, 1, 2]
    assert not any("error" in r for r in rows_of(file))


def test_figures_show_what_was_counted() -> None:
    rows = [
        {**row("deadzone", "torque", cause("deadzone", "torque"), energy=e), "number": n}
        for n, e in enumerate((60.0, 700.0, 800.0))
    ]
    nulls = [{**row("none", "torque"), "part": "nulls", "number": n} for n in range(3)]
    figures = figures_of(summary_of([*rows, *nulls]))
    assert set(figures) == {"power_curve", "confusion_matrix", "false_alarms"}
    assert list(figures["power_curve"].data[0].y) == [1.0, 1.0]
    assert figures["confusion_matrix"].data[0].z[0][0] == 2  # energies below 100 are left out


def test_the_page_has_a_table_of_every_part_and_says_where_there_is_none() -> None:
    """Three of four singles are right: 75 %, between 19 and 99 % (Clopper and Pearson 1934)."""
    right = row("deadzone", "torque", cause("deadzone", "torque"))
    rows = [{**right, "number": n} for n in range(3)]
    rows.append({**row("deadzone", "torque", cause("offset", "torque")), "number": 3})
    summary = summary_of([{**r, "cpu": 2.0, "scoring": 0.1} for r in rows])
    assert "3 of 4, 75.0 % (19 to 99)" in page_of(summary, "power")
    assert "deadzone 3, offset 1" in page_of(summary, "confusion")
    assert "60 s at 100 Hz" in page_of(summary, "time")
    empty = {what for what in TABLES if page_of(summary, what) == NONE}
    assert empty == {"targets", "nulls", "pairs", "unlisted", "gain", "rivals", "small"}


def test_the_numbers_of_the_release_fill_the_page() -> None:
    numbers = json.loads(diagnosis_power.RESULTS.read_text(encoding="utf-8"))
    for what in ("cases", "targets", "power", "kinds", "confusion", "nulls", "rivals", "time"):
        assert page_of(numbers, what) != NONE


def test_a_peer_names_a_force_that_it_has_a_column_for() -> None:
    """An extra input of lambda above 10 000 is found by the t-test of the equation error.

    Which one it is, it does not tell: the reference acts as what noise does to the regressors.
    """
    pytest.importorskip("pysindy")
    from analysis.diagnosis_power.runs import judged_by_peers

    found = judged_by_peers("single", 4)
    assert (found["kind"], found["where"]) == ("extra_input", "yaw_rate")
    assert found["peers"]["t-test"]["kind"] == "extra_input"


# -- the oracle -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("part", "number"), [pytest.param("single", 5, marks=pytest.mark.slow), ("roll", 1)]
)
def test_the_oracle_names_what_is_hidden_where_it_shows_much(part: str, number: int) -> None:
    """A periodic disturbance of the pendulum and drag of a roll, lambda in the thousands."""
    found = judged_by_oracles(part, number)
    assert found["oracle_2"] == found["oracle_1"] == [found["kind"], found["where"]]
    assert "oracle_2" not in judged_by_oracles("ship", 0)  # nothing hidden


def test_names_are_compared_with_the_oracle_record_by_record() -> None:
    """Both right, and the oracle alone: R = 1/2, half of the errors avoidable."""
    right = row("deadzone", "torque", cause("deadzone", "torque"), number=0)
    wrong = row("deadzone", "torque", cause("offset", "torque"), number=1)
    said = [
        {"part": "oracle", "of": "single", "number": n, "oracle_2": ["deadzone", "torque"]}
        for n in (0, 1)
    ]
    found = summary_of([right, wrong, *said])["oracle"]["pendulum"]
    assert (found["R"], found["avoidable"], found["of"]) == (0.5, 0.5, 2)
    missed = [t.what for t in targets_of(summary_of([right, wrong, *said])) if not t.is_met]
    assert "pendulum: right names over an oracle's" in missed
