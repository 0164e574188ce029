"""A force that no model names is found where it acts, as a function of what it depends on."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.residual.force_functions import hats, knots_of
from casid.diagnosis.evidence.residual.linearised_path import Linearised, Path
from casid.diagnosis.unexplained.missing_force import MissingForce, missing_force
from tests.support.hidden_forces import RECORDED, fitted


@functools.cache
def missing(kind: str, seed: int) -> MissingForce:
    at, made = fitted(kind, seed)
    return missing_force(at, made, "force", recorded=RECORDED, seed=seed)


EXPECTED = [
    ("cubic spring", ("x_m",), "odd", {3.0, 5.0}),
    ("quadratic damping", ("v_m",), "odd", {2.0, 3.0}),
    ("dry friction", ("v_m",), "odd", {0.0, 0.5}),
    ("Stribeck", ("v_m",), "odd", {0.0, 0.5, 2.0}),
    ("speed squared", ("speed",), None, None),
    ("damping by place", ("v_m", "x_m"), "even", {1.0, 2.0}),
    ("damping by speed", ("v_m", "speed"), None, None),
    ("stiffness drift", ("x_m", "time"), None, None),
]


@pytest.mark.parametrize(
    ("kind", "variables", "parity", "powers"),
    [
        EXPECTED[0],
        *(pytest.param(*e, marks=pytest.mark.slow) for e in EXPECTED[1:]),
    ],
)
def test_the_leading_variable_and_its_shape_are_those_of_the_force(
    kind: str, variables: tuple[str, ...], parity: str | None, powers: set[float] | None
) -> None:
    """In two of two records, with most of what is left explained."""
    for seed in (1, 2):
        found = missing(kind, seed)
        assert found.leading is not None
        assert found.leading.variables == variables
        assert found.leading.p_value < 1e-3
        assert found.leading.share > 0.7
        if parity is not None and powers is not None:
            assert found.leading.parity == parity
            assert found.leading.power in powers


def test_the_curve_is_the_force_up_to_what_the_parameters_absorb():
    """Less its best line, -0.3 |v| v to five standard errors and a tenth of its own bend."""
    d = missing("quadratic damping", 2).leading
    assert d is not None
    true = -0.3 * np.abs(d.at) * d.at
    bend = true - np.polyval(np.polyfit(d.at, true, 1), d.at)
    off = d.value - true
    off -= np.polyval(np.polyfit(d.at, off, 1), d.at)
    assert np.all(np.abs(off) < 5 * d.sd + 0.1 * np.abs(bend).max())
    assert np.abs(bend).max() > 5 * np.median(d.sd)  # the last knots are met by few samples


@pytest.mark.slow
def test_a_record_without_an_effect_has_no_missing_force():
    """Eight records at the rate of 5 %: three or more have a probability below 0.6 %."""
    alarms = sum(bool(missing("none", seed).dependences) for seed in range(20, 28))
    assert alarms <= 2
    smoothed = [missing("none", seed).over_time for seed in range(20, 28)]
    assert not any(s is not None and s.is_seen for s in smoothed)


def test_the_smoothed_force_follows_the_true_one_within_its_band():
    """A force of speed squared is slow: what is smoothed is right but for its constant part."""
    found = missing("speed squared", 1).over_time
    assert found is not None
    assert found.is_seen
    s = found.series[0]
    _, made = fitted("speed squared", 1)
    true = 0.1 * made[0].record["speed"] ** 2
    assert np.corrcoef(true, s.force)[0, 1] > 0.9
    off = s.force - true
    assert np.mean(np.abs(off - off.mean()) < 2 * s.sd) > 0.85


def test_the_linearised_simulation_gives_the_sensitivity_of_a_constant_force():
    """F has the model's own column: a step of a constant force added to F, exactly (linear)."""
    at, _ = fitted("none", 20)
    criterion, x = at.criterion, at.fit.x
    d = criterion.data[0]
    sim = criterion.simulated(x, 0)
    moved = criterion.simulate(x, 0, signals=replace(d, u=d.u + 1.0))[0]
    path = Linearised(criterion, x).path(0, sim.x[: d.N], d)
    response = path.respond(0, np.ones((d.N, 1)))[:, :, 0]
    np.testing.assert_allclose(response, moved - sim.y, atol=1e-10)


@pytest.mark.parametrize("columns", [1, 5])
def test_the_response_along_a_path_is_its_recursion(columns):
    rng = np.random.default_rng(4)
    n, nx, ny = 40, 3, 2
    a, b0, b1 = (rng.standard_normal((n, nx, k)) for k in (nx, 2, 2))
    c, d = rng.standard_normal((n, ny, nx)), rng.standard_normal((n, ny, 2))
    path = Path(0.5 * a, b0, b1, c, d, b0, d)
    f = rng.standard_normal((n, columns))
    x, expected = np.zeros((nx, columns)), np.empty((n, ny, columns))
    for k in range(n):
        expected[k] = c[k] @ x + d[k, :, 1:] * f[k]
        x = path.A[k] @ x + b0[k, :, 1:] * f[k] + b1[k, :, 1:] * f[min(k + 1, n - 1)]
    np.testing.assert_allclose(path.respond(1, f), expected, rtol=1e-9, atol=1e-9)


def test_hats_are_a_partition_of_unity_and_reproduce_lines():
    values = np.random.default_rng(0).standard_normal(500)
    knots = knots_of("v", values, 3)
    np.testing.assert_allclose(knots, -knots[::-1])
    h = hats(values, knots)
    np.testing.assert_allclose(h.sum(axis=1), 1.0)
    np.testing.assert_allclose(h @ knots, values, atol=1e-12)


def test_a_place_that_the_model_does_not_have_is_refused_with_those_it_has():
    at, made = fitted("none", 20)
    with pytest.raises(casid.ModelError, match=r"'torque' is neither .* choose one of force, x"):
        missing_force(at, made, "torque")
