"""Where the search for a polynomial model begins: consistent, and exact without noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from casid.errors import ModelError
from casid.estimation.prediction_error.polynomial import estimation as polynomial
from casid.estimation.prediction_error.polynomial.estimation import (
    Orders,
    arx,
    oe,
    prediction_error,
)
from casid.estimation.prediction_error.polynomial.orders import Layout
from casid.estimation.prediction_error.polynomial.start_values import candidates, steiglitz_mcbride
from tests.support.polynomial_systems import STRUCTURES, A, B, coloured, record
from tests.support.recursion import filtered, simulated


@STRUCTURES
def test_start_values_are_consistent(structure):
    """Hannan-Rissanen and Steiglitz-McBride after a long ARX: the search starts near the truth."""
    y, u, orders, theta = record(structure, 5000, seed=40)
    points = candidates([(y, {"u": u})], Layout.of(orders, ["u"]))
    model = prediction_error(y, u, orders)
    sigma = np.sqrt(np.diag(model.covariance))
    nearest = min(float(np.max(np.abs(point - theta) / sigma)) for _, point, _ in points)
    # Consistent, not efficient: a few times the efficient error, 4 of them to cover the worst.
    assert nearest < 12


def test_steiglitz_mcbride_is_exact_without_noise():
    u = coloured(np.random.default_rng(41), 200)
    b, f, out = steiglitz_mcbride([(filtered(B, A, u), u)], 2, 2, 1)
    assert b == pytest.approx(B, abs=1e-9)
    assert f == pytest.approx(A, abs=1e-9)
    assert out == ()


def test_steiglitz_mcbride_is_consistent_in_white_output_noise_and_least_squares_is_not():
    """Least squares of z_t = -f z_{t-1} + b x_{t-1}: f is attenuated by r/(r + noise variance)."""
    rng = np.random.default_rng(43)
    n, f = 20_000, -0.8
    x = rng.normal(size=n)
    z = filtered((0.0, 1.0), (1.0, f), x) + rng.normal(size=n)
    r = 1 / (1 - f**2)  # variance of the noise-free output
    attenuated = arx(z, x, na=1, nb=1)["a1"]
    assert attenuated == pytest.approx(f * r / (r + 1), abs=0.02)
    b, poly, _ = steiglitz_mcbride([(z, x)], 1, 1, 1)
    sigma = oe(z, x, nb=1, nf=1).std_errors
    assert poly[1] == pytest.approx(f, abs=8 * sigma["f1[u]"])
    assert b[1] == pytest.approx(1.0, abs=8 * sigma["b1[u]"])


def test_without_noise_every_start_of_two_inputs_is_the_truth():
    rng = np.random.default_rng(44)
    u = {"a": coloured(rng, 400), "g": rng.normal(size=400)}
    parts = dict(B={"a": B, "g": (0.0, 0.8)}, F={"a": A, "g": (1.0, -0.3)})
    y = simulated(np.zeros(400), u, **parts)
    orders = Orders(nb={"a": 2, "g": 1}, nf={"a": 2, "g": 1})
    points = candidates([(y, u)], Layout.of(orders, ["a", "g"]))
    assert len(points) == 3
    for _, theta, _ in points:
        assert theta == pytest.approx([1.0, 0.5, 0.8, -1.5, 0.7, -0.3], abs=1e-6)


def test_a_given_start_is_used():
    y, u, orders, _ = record("ARMAX", 500, seed=25)
    first = prediction_error(y, u, orders)
    again = prediction_error(y, u, orders, start=first, discard=first.discarded[0])
    assert again.start == "the model given"
    assert np.all(np.abs(again.theta - first.theta) < 1e-3 * np.sqrt(np.diag(first.covariance)))
    with pytest.raises(ModelError, match="start has the coefficients a1.*give a model of the same"):
        prediction_error(y, u, Orders(nb=2, nf=2), start=first)


def test_a_given_start_is_in_the_units_of_the_data():
    """b of 1000 per input: the search is there at once."""
    y, u, orders, _ = record("BJ", 500, seed=25)
    first = prediction_error(1000 * y, u, orders)
    again = prediction_error(1000 * y, u, orders, start=first, discard=first.discarded[0])
    assert again.iterations <= 2


def test_a_local_optimum_beside_a_lower_end_on_the_unit_circle_is_said_to_be_local(monkeypatch):
    """One start ends at a root of C on the circle, with a lower loss; the next converges."""
    y, u, orders, _ = record("ARMAX", 300, seed=42)
    solve, calls = polynomial._minimise, []

    def first_at_the_circle(criterion, theta, solver):
        calls.append(theta)
        solution = solve(criterion, theta, solver)
        if len(calls) > 1:
            return solution
        x = np.r_[solution.x[:4], -1.0 + 1e-5, 0.0]
        return replace(solution, x=x, value=0.5 * solution.value, scaled_gradient=1.0)

    monkeypatch.setattr(polynomial, "_minimise", first_at_the_circle)
    model = prediction_error(y, u, orders)
    assert model.is_converged
    assert len(calls) == 2
    assert any("root of C of modulus 0.99999" in n and "a local one" in n for n in model.notes)
