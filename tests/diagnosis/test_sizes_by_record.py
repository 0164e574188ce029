"""Several records of one body: one size of a cause for all of them, or a size of each.

The differences of the sizes, estimated record by record, are judged by Wald's test against zero.
The records are integrated by scipy, which shares no code with casid.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from tests.diagnosis.test_diagnose import mass_on_a_spring

TS, NOISE = 0.02, 1e-3
M, D, K = 2.0, 1.5, 50.0


def swung(drag: float, seed: int, N: int = 1000) -> casid.Record:
    """m x'' = -k x - d x' - drag |x'| x' + F, F held over steps of 0.5 s, from rest."""
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.uniform(-15.0, 15.0, N // 25 + 1), 25)[:N]
    state, path = np.zeros(2), []
    for start in range(0, N, 25):
        F, samples = force[start], TS * np.arange(26)
        found = solve_ivp(
            lambda _, s, F=F: [s[1], (F - K * s[0] - D * s[1] - drag * abs(s[1]) * s[1]) / M],
            (0.0, samples[-1]),
            state,
            t_eval=samples,
            rtol=1e-8,
            atol=1e-10,
        )
        path.append(found.y[0, :-1])
        state = found.y[:, -1]
    position = np.concatenate(path)[:N] + NOISE * rng.standard_normal(N)
    return casid.Record(
        {"force": force, "position": position},
        {"force": "N", "position": "m"},
        Ts=TS,
        name=f"run {seed}",
    )


@functools.cache
def diagnosed(*drags: float) -> casid.Diagnosis:
    records = [swung(drag, seed) for seed, drag in enumerate(drags, start=1)]
    return casid.diagnose(mass_on_a_spring(), records, max_causes=1, advise=False)


@pytest.mark.slow
def test_one_size_that_explains_all_records_is_said_once():
    d = diagnosed(1.0, 1.0)
    (cause,) = d.causes
    assert (cause.kind, cause.where) == ("quadratic_damping", "force balance")
    assert cause.by_record == {}
    (size,) = cause.parameters
    assert size.value == pytest.approx(1.0, abs=3 * size.std_error)


@pytest.mark.slow
def test_sizes_that_differ_are_said_for_each_record():
    d = diagnosed(1.0, 2.0)
    (cause,) = d.causes
    assert (cause.kind, cause.where) == ("quadratic_damping", "force balance")
    assert list(cause.by_record) == ["run 1", "run 2"]
    for record, true in zip(("run 1", "run 2"), (1.0, 2.0), strict=True):
        (size,) = cause.by_record[record].values()
        assert size.value == pytest.approx(true, abs=3 * size.std_error)
        # A size is known to far less than the two differ: Wald's test has something to see.
        assert size.std_error < 0.2


@pytest.mark.slow
def test_sizes_of_single_records_stand_in_the_json_and_in_the_text():
    d = diagnosed(1.0, 2.0)
    (cause,) = d.to_json()["causes"]
    (name,) = cause["by_record"]["run 1"]
    assert set(cause["by_record"]["run 2"][name]) == {"value", "std_error", "unit"}
    assert "run 1" in str(d)
    assert "run 2" in str(d)
    assert diagnosed(1.0, 1.0).to_json()["causes"][0]["by_record"] == {}


@pytest.mark.slow
def test_the_fit_with_sizes_of_their_own_is_as_good_as_the_sensor():
    d = diagnosed(1.0, 2.0)
    assert d.fitted["extended_rmse"]["position"] == pytest.approx(NOISE, rel=0.1)
    assert d.fitted["baseline_rmse"]["position"] > 2 * NOISE
