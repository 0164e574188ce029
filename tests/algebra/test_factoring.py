"""Factors do not depend on what random numbers were drawn before, nor change those after."""

from __future__ import annotations

import sympy
from sympy.core.random import rng

from casid.algebra.factoring import factored

X, Y, Z = sympy.symbols("x y z")


def test_factors_are_those_of_the_product() -> None:
    assert factored(sympy.expand((X + Y) * (X - Z) ** 2)) == (X + Y) * (X - Z) ** 2


def test_random_numbers_of_others_go_on_as_they_would() -> None:
    """An evaluation point is drawn for three symbols."""
    rng.seed(7)
    expected = [rng.random() for _ in range(3)]
    rng.seed(7)
    factored(sympy.expand((X * Y + 3 * Z + 1) * (X - Y * Z + 2)))
    assert [rng.random() for _ in range(3)] == expected


def test_the_points_are_the_same_every_time(monkeypatch) -> None:
    points = []
    whole = sympy.polys.factortools.dmp_eval_tail

    def noted(f, a, u, K):
        points[-1].append(list(map(int, a)))
        return whole(f, a, u, K)

    monkeypatch.setattr(sympy.polys.factortools, "dmp_eval_tail", noted)
    for seed in (1, 2):
        rng.seed(seed)
        points.append([])
        factored(sympy.expand((X * Y + 3 * Z + 1) * (X - Y * Z + 2) * (X + Y + Z**2)))
    assert points[0]
    assert points[0] == points[1]
