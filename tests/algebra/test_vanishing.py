"""Which expressions vanish identically, exactly for rational and analytic functions."""

from __future__ import annotations

from fractions import Fraction

import casadi as ca
import pytest

from casid.algebra.vanishing import vanishing
from casid.errors import ModelError


def test_identities_of_algebra_and_of_trigonometry_vanish():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    identities = [
        (x + y) ** 2 - x**2 - 2 * x * y - y**2,
        1 / (x - y) + 1 / (y - x),
        0.1 * 3 * x - 0.3 * x,
        ca.sin(2 * x) - 2 * ca.sin(x) * ca.cos(x),
        ca.exp(x + y) - ca.exp(x) * ca.exp(y),
        ca.sqrt(x**2 * y) / x - ca.sqrt(y),
        ca.SX(0),
    ]
    assert all(vanishing(identities))
    assert not any(vanishing([x, x - y, 1e-9 * x, ca.sin(x) - x, ca.log(x), ca.SX(1)]))


def test_what_vanishes_at_a_point_need_not_vanish():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    assert vanishing([x * y, x + y], at={"x": Fraction(0)}) == [True, False]
    assert vanishing([x * y]) == [False]


def test_a_pole_everywhere_is_refused():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    with pytest.raises(ModelError, match="vanishes identically"):
        vanishing([1 / (x - y + (y - x)), x])
    with pytest.raises(ModelError, match="x = 0"):
        vanishing([y / x], at={"x": Fraction(0)})
