"""Roll in zigzags: derived channels against closed forms, the hull of the files, the study."""

from __future__ import annotations

import json

import casadi as ca
import numpy as np
import pytest

import casid
from analysis.kvlcc2_zigzag import study
from casid.data.derived import propagated_noise
from casid.data.local_polynomial import LocalPolynomial
from casid.estimation.equation_error import equation_error
from problems import kvlcc2_zigzag
from problems.kvlcc2_zigzag import OMEGA_0, TRUTH
from tests.support.shared import ROOT, shared

FILES = "data/kvlcc2_marin_free"


@pytest.fixture(scope="module")
def measured():
    folder = shared(FILES)
    return {n: kvlcc2_zigzag.problem.read(folder / f"{n}.csv") for n in study.RECORDS}


# -- its equations and channels --------------------------------------------------------------------


def test_the_balance_is_the_roll_row_divided_by_its_inertia():
    """(1) of the problem, term by term."""
    e = kvlcc2_zigzag.roll_model().explicit()
    values = {
        "C_1": 2.0,
        "B_1": 3.0,
        "b_a": 5.0,
        "b_rdot": 7.0,
        "b_r": 11.0,
        "b_v": 13.0,
        "b_delta": 17.0,
        "c_0": 19.0,
    }
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    p = [values[n] for n in e.parameters]
    for j, (name, factor) in enumerate(zip(e.inputs, (5.0, 7.0, 11.0, 13.0, 17.0), strict=True)):
        u = np.zeros(5)
        u[j] = 1.0
        assert float(f([0, 0], u, p)[1]) == pytest.approx(19.0 + factor), name
    assert float(f([1, 0], np.zeros(5), p)[1]) == pytest.approx(19.0 - 2.0)
    assert float(f([0, 1], np.zeros(5), p)[1]) == pytest.approx(19.0 - 3.0)


def test_on_a_circle_the_lateral_acceleration_is_speed_times_yaw_rate():
    """Heading psi = r t, speed U along and v across the hull, both constant: a_y = U r, rdot = 0.

    Along and across the hull nothing changes, so the smoother loses nothing.
    """
    r, U, v, Ts = 0.006, 7.5, -0.9, 0.135
    psi = r * Ts * np.arange(2000)
    still = np.zeros_like(psi)
    channels = {
        "phi": still,
        "p": still,
        "delta": still,
        "r": still + r,
        "psi": psi,
        "u_earth": U * np.cos(psi) - v * np.sin(psi),
        "v_earth": U * np.sin(psi) + v * np.cos(psi),
    }
    units = {n: "rad" for n in channels} | {"p": "rad/s", "r": "rad/s"}
    units |= {"u_earth": "m/s", "v_earth": "m/s"}
    e = kvlcc2_zigzag.problem.experiment(casid.Record(channels, units, Ts))
    for name, expected in (("a_y", U * r), ("v", v), ("U", U), ("rdot", 0.0)):
        np.testing.assert_allclose(e.record[name], expected, atol=1e-12)


def test_every_derived_channel_says_how_it_is_made_and_how_noisy_it_is():
    """The sway speed: a rotation of white noises, times the norm of the taps of the smoother."""
    e = kvlcc2_zigzag.problem.experiment(kvlcc2_zigzag.simulate(duration=100.0))
    lines = [line for line in e.record.provenance if "derived from" in line]
    assert len(lines) == len(kvlcc2_zigzag.DERIVED)
    assert all("half power" in line and "noise" in line for line in lines)
    raw, noise = kvlcc2_zigzag.simulate(duration=100.0), kvlcc2_zigzag.NOISE
    found = propagated_noise("v", kvlcc2_zigzag.DERIVED["v"], raw, noise)
    psi, U = raw["psi"], kvlcc2_zigzag.surge_speed(raw)
    white = np.mean(
        (np.cos(psi) * noise["v_earth"]) ** 2
        + (np.sin(psi) * noise["u_earth"]) ** 2
        + (U * noise["psi"]) ** 2
    )
    expected = np.sqrt(white) * np.linalg.norm(kvlcc2_zigzag.SMOOTHER.taps(raw.Ts))
    # Neighbours share up to 31 samples, of eight draws: four standard errors.
    assert found == pytest.approx(expected, rel=4 * np.sqrt(31 / (2 * 8 * raw.N)))


# -- its simulation --------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_zigzag_without_noise_returns_the_truth():
    """At the roll frequency the smoother loses 0.1 % of v and a_y, and none of delta."""
    quiet = kvlcc2_zigzag.problem.experiment(kvlcc2_zigzag.simulate(noise=0.0, duration=300.0))
    estimate = casid.identify(kvlcc2_zigzag.problem, quiet)
    assert estimate["C_1"] == pytest.approx(TRUTH["C_1"], rel=1e-3)
    for name in ("B_1", "b_a", "b_rdot", "b_r", "b_v", "b_delta"):
        assert estimate[name] == pytest.approx(TRUTH[name], rel=0.02), name


@pytest.mark.slow
def test_with_the_noise_of_the_files_the_roll_frequency_is_within_a_percent():
    omega, _ = study.frequency(casid.identify(kvlcc2_zigzag.problem))
    assert omega == pytest.approx(OMEGA_0, rel=0.01)


def test_both_files_are_problems_of_the_command_line():
    right = casid.load_problem(ROOT / "problems" / "kvlcc2_zigzag.py")
    wrong = casid.load_problem(ROOT / "problems" / "kvlcc2_zigzag_alone.py")
    assert set(right.model.inputs) == set(kvlcc2_zigzag.INPUTS) == set(wrong.recorded)
    assert not wrong.model.inputs
    assert {"u_earth", "v_earth", "psi"} <= set(right.columns())
    assert not {"a_y", "rdot", "v", "U"} & set(right.columns())
    assert len(wrong.examples()) == 1


# -- the hull of the files -------------------------------------------------------------------------


def test_the_speeds_of_the_files_are_those_over_ground(measured):
    """What makes rotation necessary: v follows dy/dt, and across the hull it opposes the turn."""
    for name, e in measured.items():
        r = e.record
        frame = np.genfromtxt(shared(FILES) / f"{name}.csv", delimiter=",", names=True)
        y = np.interp(r.t, frame["t_s"], frame["y_m"])
        smooth = LocalPolynomial(12.0).apply(y, r.Ts, 1)
        assert np.corrcoef(smooth[50:-50], r["v_earth"][50:-50])[0, 1] > 0.999
        assert np.corrcoef(r["v"], r["r"])[0, 1] < -0.9


@pytest.mark.parametrize("name", ["zz_10", pytest.param("zz_20", marks=pytest.mark.slow)])
def test_the_roll_frequency_is_the_published_one(measured, name):
    """Within 6 and 12 % by regression; by simulation, whose states hold no noise, within 2 %."""
    problem, e = kvlcc2_zigzag.problem, measured[name]
    regression = equation_error(problem, e, prefilter=study.PREFILTER, decimate=4)
    omega, error = study.frequency(regression.estimate)
    assert abs(omega / OMEGA_0 - 1) < study.RECORDS[name]
    assert 0 < error < 0.05
    simulated, _ = study.frequency(casid.identify(problem, kvlcc2_zigzag.coarse(e)))
    assert abs(simulated / OMEGA_0 - 1) < 0.02
    alone = equation_error(kvlcc2_zigzag.without_inputs(), e, prefilter=study.PREFILTER, decimate=4)
    assert study.frequency(alone.estimate)[0] == pytest.approx(study.ALONE[name], rel=0.1)


@pytest.mark.slow
def test_without_inputs_the_diagnosis_says_that_they_are_missing(measured):
    """On a grid of 1.08 s, which are 16 samples a roll period; one cause is enough to see it.

    In the zigzag of the smaller angle, which the missing inputs move less.
    """
    found = casid.diagnose(
        kvlcc2_zigzag.without_inputs(),
        kvlcc2_zigzag.coarse(measured["zz_10"], 8),
        starts=1,
        max_causes=1,
        advise=False,
    )
    assert found.verdict == "deficient"
    assert found.causes[0].kind == "extra_input"
    # Sway and yaw push the roll: in a zigzag the one shows the other, as speeds or accelerations.
    assert found.causes[0].where in {"v", "a_y", "r", "rdot"}


@pytest.mark.slow
def test_the_quick_study_meets_its_targets(tmp_path, capsys):
    shared(FILES)
    assert study.STUDY.main(["--quick", "--out", str(tmp_path)]) == 0
    targets = json.loads((tmp_path / "targets.json").read_text())
    assert all(t["is_met"] for t in targets)
    text = capsys.readouterr().out
    assert "delta is fed back from psi" in text
    assert "may not be called consistent" in text


def test_every_extension_at_its_null_value_is_the_model_itself():
    model = kvlcc2_zigzag.roll_model()
    rng = np.random.default_rng(7)
    x, u, values = rng.standard_normal(2), rng.standard_normal(5), dict(TRUTH)
    e = model.explicit()
    plain = ca.Function("f", [e.x, e.u, e.p], [e.f])(x, u, [values[n] for n in e.parameters])
    for effect in study.extensions(model):
        wider = effect.extend(model)
        casid.Problem("wider", wider)  # its units hold together
        w = wider.explicit()
        p = [values.get(n, study.U_0 if n == "U_0" else 0.0) for n in w.parameters]
        more = [*u, 5.5] if "U" in w.inputs else u
        there = ca.Function("f", [w.x, w.u, w.p], [w.f])(x, more, p)
        np.testing.assert_allclose(np.array(there), np.array(plain), rtol=1e-14)
