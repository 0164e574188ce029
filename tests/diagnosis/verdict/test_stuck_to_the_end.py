"""A sensor that stands still before the held-out part and to the end of the record.

The truth is a room's air, V dc/dt = q (c_o - c) + n G, by its exact solution between the samples.
"""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.baseline import fit_baseline
from casid.diagnosis.settings import DiagnosisSettings
from casid.diagnosis.verdict.cause import Cause, Estimated
from casid.estimation.holdout import held_out_error, split_records
from casid.estimation.simulation.fit import FitSettings

TS, N, V, G, OUTSIDE = 300.0, 240, 200.0, 5.0e-6, 420e-6


def air(seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Flow [m^3/s], persons and CO2 (1), (N,)."""
    rng = np.random.default_rng(seed)
    q = np.repeat(rng.uniform(0.02, 0.15, N // 10), 10)
    n = np.repeat(rng.integers(0, 20, N // 6), 6).astype(float)
    c, level = np.empty(N), 600e-6
    for k in range(N):
        c[k] = level
        rest = OUTSIDE + n[k] * G / q[k]
        level = rest + (level - rest) * np.exp(-q[k] / V * TS)
    return q, n, c + 4e-6 * rng.standard_normal(N)


def test_the_diagnosis_holds_out_what_was_measured():
    m = casid.Model("room")
    c = m.state("c", "ppm")
    q, n = (m.input(i, u, hold="zoh", known=True) for i, u in (("q", "m^3/s"), ("n", "1")))
    volume = m.parameter("V", "m^3", start=150, lower=20, upper=2000)
    each = m.parameter("G", "m^3/s", start=4e-6, lower=1e-7, upper=1e-4)
    m.balance(c, "CO2", inertia=volume, terms=[q * (OUTSIDE - c), n * each])
    m.output("co2", c, "ppm")
    flow, persons, level = air()
    stuck = int(0.66 * N)
    level[stuck:] = level[stuck]
    record = casid.Record(
        {"q": flow, "n": persons, "co2": level}, {"q": "m^3/s", "n": "1", "co2": "1"}, TS, name="r"
    )
    problem = casid.Problem("room", m, starts=1)
    settings = DiagnosisSettings(fit=FitSettings(starts=1))
    split = split_records([casid.Experiment(record, {}, "r")], 0.3)
    found = fit_baseline(problem, split, settings)
    assert found.corrupted.standstills[0].count == N - stuck
    assert any("little is measured in its last 30 %" in note for note in found.notes)
    # 70 % of what was measured is fitted, and the rest of it held out.
    assert int((~found.split.held[0]).sum()) == pytest.approx(0.7 * stuck, abs=2)
    left = held_out_error(found.fit, found.split, anew=True)
    assert np.isfinite(left).sum() == pytest.approx(0.3 * stuck, abs=2)


def test_a_share_and_a_gain_have_no_unit_where_the_channel_has_ppm():
    share, scale = Estimated("share", 0.34, "1"), Estimated("scale_co2", 0.08, "1")
    size = Estimated("size", 3e-4, "1")
    cause = Cause("outliers", "co2", p_value=0.0, parameters=(share, scale, size))
    shown = cause.in_units({"co2": "ppm"}).parameters
    assert [p.unit for p in shown] == ["1", "1", "ppm"]
    assert [p.value for p in shown] == pytest.approx([0.34, 0.08, 300.0])


def test_an_exponent_is_a_number_where_the_state_has_per_cent():
    law = Cause("unknown", "v", p_value=0.0, parameters=(Estimated("exponent_v", 1.5, "1"),))
    (exponent,) = law.in_units({"v": "%"}).parameters
    assert (exponent.value, exponent.unit) == (1.5, "1")
