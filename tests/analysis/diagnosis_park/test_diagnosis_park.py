"""The park of systems: its simulators against closed forms, its noise, its oracle, its counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2, norm

from analysis.diagnosis_park.bench import Bench, Variant, sensitivities, whitener_of
from analysis.diagnosis_park.cases import CYCLE, Case, make
from analysis.diagnosis_park.judgement import is_misnamed
from analysis.diagnosis_park.oracle import judged, posterior, probability_right, signatures_of
from analysis.diagnosis_park.runs import system_and_problem
from analysis.diagnosis_park.study import STUDY, rows_of, run_cases
from analysis.diagnosis_park.tables import ratio_of, targets_of
from tests.support.park.simulator import Disturbance, System, simulate
from tests.support.park.systems import SYSTEMS

Row = dict[str, Any]


def bench_of(system: System, n: int = 200, seed: int = 1) -> Bench:
    rng = np.random.default_rng(seed)
    u = np.stack([i.signal(rng, n, system.Ts) for i in system.inputs])
    x0 = np.array([mean + sd for mean, sd in system.start.values()])
    z = {c.name: rng.standard_normal(n) for c in system.beside}
    return Bench(system, dict(system.theta), x0, u, z, n)


# -- simulators -----------------------------------------------------------------------------------


def test_the_two_mass_drive_follows_the_matrix_exponential() -> None:
    """Held inputs and linear equations: x_{k+1} = e^{A Ts} x_k + A^-1 (e^{A Ts} - 1) B u_k."""
    bench = bench_of(SYSTEMS["two_mass"])
    p = bench.theta
    A = np.array(
        [
            [-(p["c"] + p["d1"]) / p["J1"], p["c"] / p["J1"], -p["k"] / p["J1"]],
            [p["c"] / p["J2"], -(p["c"] + p["d2"]) / p["J2"], p["k"] / p["J2"]],
            [1.0, -1.0, 0.0],
        ]
    )
    B = np.array([1 / p["J1"], 0.0, 0.0])
    step = expm(A * bench.system.Ts)
    held = np.linalg.solve(A, (step - np.eye(3)) @ B)
    x, expected = bench.x0, []
    for u in bench.u[0]:
        expected.append(x[[0, 2]])
        x = step @ x + held * u
    y = bench.outputs([bench.null()])[:, :, 0]
    sd = np.array([o.sd for o in bench.system.outputs])
    assert np.max(abs(y - expected) / sd) < 0.05  # a twentieth of the noise, after 12 oscillations


def test_rooms_conserve_energy() -> None:
    """Heat stored is heat supplied less heat lost: Simpson's sum of a RK4 run closes to 1e-6."""
    bench = bench_of(SYSTEMS["rooms"], n=50)
    U, (x0, p) = bench.stages(), bench.columns([bench.null()])
    Y, X = simulate(bench.system, x0, p, U)
    t = bench.theta
    stored = t["C1"] * (X[-1, 0] - X[0, 0]) + t["C2"] * (X[-1, 1] - X[0, 1])
    T = Y[::2, :, 0].T  # at the steps; trapezoids with the end of the last step
    T = np.concatenate([T, X[-1]], axis=1)
    out = np.append(U[:, 0, 1, 0], U[-1, 2, 1, 0])
    lost = t["H1"] * (T[0] - out) + t["H2"] * (T[1] - out)
    h = bench.system.Ts / bench.system.substeps
    supplied = h * float(np.sum(U[:, 1, 0, 0]))
    assert stored[0] == pytest.approx(supplied - np.trapezoid(lost, dx=h), rel=2e-3)


@pytest.mark.parametrize("name", sorted(SYSTEMS))
def test_halving_the_steps_changes_less_than_the_noise_shows(name: str) -> None:
    system = SYSTEMS[name]
    fine = replace(system, more={**system.more, "substeps": 2 * system.substeps})
    n = 120
    y, z = (bench_of(s, n).outputs([bench_of(s, n).null()])[:, :, 0] for s in (system, fine))
    sd = np.array([o.sd for o in system.outputs])
    assert np.sqrt(np.mean(((y - z) / sd) ** 2)) < 0.03


def test_a_disturbance_has_its_standard_deviation_and_its_colour() -> None:
    waves = Disturbance(2.0, 3.0, 1.1)
    d = waves.draw(np.random.default_rng(1), 200_000, 0.1)
    a1, a2, sd = waves.coefficients(0.1)
    assert d.std() == pytest.approx(2.0, rel=0.03)
    assert np.std(d[2:] - a1 * d[1:-1] - a2 * d[:-2]) == pytest.approx(sd, rel=0.01)


@pytest.mark.parametrize("name", ["crane", "hull", "quarter_car"])
def test_what_the_noise_leaves_is_white_beside_coloured_disturbances(name: str) -> None:
    """Innovations of n samples have a sum of squares within 4 sd of n: chi-squared."""
    hidden = make(Case(name, 3, 1), replace(SYSTEMS[name], N=800))
    bench = hidden.bench
    y = hidden.y[: bench.n, :, None]
    e = hidden.white(y - bench.outputs([bench.null()]))[:, 0]
    free = np.count_nonzero(e)
    assert chi2.sf(np.sum(e**2), free) > 3e-5
    assert chi2.cdf(np.sum(e**2), free) > 3e-5


def test_sensitivities_by_steps_are_those_of_whole_simulations() -> None:
    bench = bench_of(SYSTEMS["hull"])
    white = whitener_of(bench)
    nominal = bench.motions([bench.null()])[0]
    moved = sensitivities(bench, white, nominal)
    eps = 1e-4
    for i in range(bench.n_phi):
        two = [Variant(s * eps * np.eye(bench.n_phi)[i]) for s in (1, -1)]
        y = bench.outputs(two)
        expected = white((y[:, :, :1] - y[:, :, 1:]) / (2 * eps))[:, 0]
        assert np.linalg.norm(moved[:, i] - expected) < 1e-4 * np.linalg.norm(expected)


# -- cases ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_case_shows_the_energy_that_is_drawn_and_comes_again_the_same() -> None:
    system = replace(SYSTEMS["motor"], N=600)
    one, again = (make(Case("motor", 1, 2), system) for _ in range(2))
    np.testing.assert_array_equal(one.y, again.y)
    assert one.kind == again.kind
    assert 70 < one.energy < 4300
    assert CYCLE[1] == "null"
    assert make(Case("motor", 1, 1), system).kind == "none"


@pytest.mark.parametrize("kind", ["random_mechanical", "random_thermal"])
def test_random_networks_state_to_casid_what_is_simulated(kind: str) -> None:
    """The derivatives of the stated model are those of the simulator at a point drawn."""
    for number in range(3):
        system, problem = system_and_problem(Case(kind, 1, number))
        assert set(problem.model.parameters) >= set(system.theta)
        assert list(problem.model.outputs) == [o.name for o in system.outputs]
        assert list(problem.model.states) == list(system.start)


# -- the oracle -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("energy", "cosine"), [(30.0, 0.9), (30.0, 0.98), (100.0, 0.98)])
def test_the_oracle_of_two_candidates_is_as_often_right_as_the_closed_form_says(
    energy: float, cosine: float
) -> None:
    """P = Phi(a) Phi(b) + Phi(-a) Phi(-b); of 4000 records within 4 sd."""
    rng, runs, n = np.random.default_rng(5), 4000, 12
    first = np.eye(n)[0]
    second = cosine * first + np.sqrt(1 - cosine**2) * np.eye(n)[1]
    signatures = [first[:, None], second[:, None]]
    right = 0
    for _ in range(runs):
        e = np.sqrt(energy) * first * rng.choice([-1, 1]) + rng.standard_normal(n)
        scores, _ = posterior(e, np.zeros((n, 0)), signatures, (1, 1), (False, False))
        right += int(np.argmax(scores)) == 0
    p = probability_right(energy, cosine)
    assert right / runs == pytest.approx(p, abs=4 * np.sqrt(p * (1 - p) / runs))


def test_the_closed_form_has_its_published_values() -> None:
    assert probability_right(30, 0.9) == pytest.approx(0.890, abs=5e-4)
    assert probability_right(1000, 0.98) == pytest.approx(0.999, abs=5e-4)
    assert probability_right(50, 0.0) == pytest.approx(norm.cdf(5) ** 2 + norm.cdf(-5) ** 2)


@pytest.mark.slow
def test_the_oracle_finds_a_spring_that_hardens_between_two_bodies() -> None:
    system = SYSTEMS["two_mass"]
    bench = bench_of(system, 300)
    from analysis.diagnosis_park.bench import scales_of
    from tests.support.park.effects import catalogue_of

    catalogue = catalogue_of(system, scales_of(bench))
    white = whitener_of(bench)
    effect = next(e for e in catalogue if (e.kind, e.where) == ("cubic_stiffness", "shaft"))
    size = np.array([0.3])
    y = bench.outputs([Variant(np.zeros(bench.n_phi), effect, size)])[:, :, 0]
    y = y + np.random.default_rng(2).standard_normal(y.shape) * [o.sd for o in system.outputs]
    found = judged(bench, white, y, signatures_of(bench, white, catalogue), (effect, 0.0, size))
    assert found.effect is effect
    assert ("cubic_stiffness", "w1-w2") in found.same


# -- counts ---------------------------------------------------------------------------------------


def row(kind: str, named: str, oracle: str, *, part: str = "single") -> Row:
    causes = [{"kind": named, "where": "a", "alternatives": []}] if named else []
    return {
        "system": "motor",
        "seed": 1,
        "number": 0,
        "part": part,
        "kind": kind,
        "where": "a",
        "names": [],
        "energy": 500.0,
        "verdict": "deficient" if named else "adequate",
        "causes": causes,
        "unexplained": None,
        "oracle_2": [oracle, "a"],
        "oracle_2_set": [[oracle, "a"]],
        "cpu": 1.0,
    }


def test_the_ratio_is_paired() -> None:
    """Of 10: both right 7, oracle alone 2, casid alone 1: R = 8/9, avoidable 0.2."""
    rows = [row("x", "x", "x")] * 7 + [row("x", "y", "x")] * 2 + [row("x", "x", "y")]
    R, low, high, avoidable = ratio_of(rows)
    assert R == pytest.approx(8 / 9)
    assert avoidable == pytest.approx(0.2)
    half = 1.96 * np.sqrt(3 - 1 / 10) / 10 / 0.9
    assert (low, high) == pytest.approx((R - half, R + half))


def test_a_park_of_wrong_names_misses_its_targets_and_one_of_right_names_meets_them() -> None:
    good = [row("x", "x", "x")] * 20 + [row("none", "", "x", part="null")] * 10
    bad = [row("x", "y", "x")] * 20 + [row("none", "y", "x", part="null")] * 10
    assert all(t.is_met for t in targets_of(good, quick=False))
    missed = {t.what for t in targets_of(bad, quick=True) if not t.is_met}
    assert {"right name", "wrong name without a flag", "motor: false alarms"} <= missed


def test_what_the_named_cause_leaves_tells_whether_a_record_shows_that_the_name_is_wrong() -> None:
    """Six values estimated leave more than 16.8 of chi-squared in one record of a hundred."""
    named = row("pulse", "x", "x", part="unlisted") | {"free": 6}
    limit = float(chi2.isf(0.01, 6))
    assert is_misnamed(named | {"left": limit + 1.0})
    assert not is_misnamed(named | {"left": limit - 1.0})
    assert not is_misnamed(named | {"left": 500.0, "unexplained": "something remains"})


@pytest.mark.slow
def test_the_study_runs_a_record_and_goes_on_where_it_was(tmp_path: Path) -> None:
    """A null of the motor: its row, tables and targets; the second call has nothing to do."""
    options = ["--quick", "--systems", "motor", "--first", "1", "--records", "1"]
    options += ["--without-oracles", "--out", str(tmp_path)]
    assert STUDY.main(options) == 0
    rows = rows_of(tmp_path / "cases.jsonl")
    assert [(r["part"], r["verdict"]) for r in rows] == [("null", "adequate")]
    assert list(run_cases(tmp_path / "cases.jsonl", [Case("motor", 1, 1)])) == []
