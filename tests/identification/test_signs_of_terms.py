"""A term that makes a model unstable by its sign is named, and a plant that is unstable is not."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import casid
from casid.arrays import Array
from casid.estimation.simulation.fit import FitSettings
from casid.identification.signs_of_terms import _variants, wrong_term
from casid.model.rate_laws import with_balances

N, TS, NOISE = 400, 0.05, 2e-3


def spring(stiffness: float = -1.0, damping: float = -1.0) -> casid.Problem:
    """M v' = F - k x - d v, each of the last two times a sign that may be wrong."""
    m = casid.Model("spring")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="zoh", known=True)
    k = m.parameter("k", "N/m", start=20.0, lower=0.1, upper=1e3)
    d = m.parameter("d", "N*s/m", start=1.0, lower=1e-3, upper=100.0)
    M = m.constant("M", 1.0, "kg")
    m.derivative(x, v)
    m.balance(v, "force", inertia=M, terms=[F, stiffness * k * x, damping * d * v])
    m.output("y", x, "m")
    return casid.Problem("spring", m, starts=1)


def tank(sign: float) -> casid.Problem:
    """h' = (q + sign c sqrt(h)) / A, stated as a rate of change."""
    m = casid.Model("tank")
    h, q = m.state("h", "m", start=1.0), m.input("q", "m^3/s", hold="zoh", known=True)
    A = m.constant("A", 0.5, "m^2")
    c = m.parameter("c", "m^2.5/s", start=0.01, lower=1e-4, upper=1.0)
    m.derivative(h, (q + sign * c * ca.sqrt(h)) / A)
    m.output("y", h, "m")
    return casid.Problem("tank", m, starts=1)


def steps(levels: list[float], length: int, seed: int = 0) -> Array:
    return np.repeat(np.random.default_rng(seed).choice(levels, N // length + 1), length)[:N]


def shaken(stiffness: float, seed: int = 1) -> casid.Record:
    """A mass of 1 kg, damped by 0.8 N s/m; one that a spring pushes away is held by its force."""
    rng, reference = np.random.default_rng(seed), steps([-5.0, 0.0, 5.0], 20)
    x, v, F, y = 0.0, 0.0, np.empty(N), np.empty(N)
    for i in range(N):
        y[i] = x + NOISE * rng.standard_normal()
        F[i] = reference[i] if stiffness > 0 else 0.2 * reference[i] - 60.0 * y[i] - 8.0 * v
        for _ in range(20):
            v += (F[i] - stiffness * x - 0.8 * v) * TS / 20
            x += v * TS / 20
    return casid.Record({"F": F, "y": y}, {"F": "N", "y": "m"}, TS, name="run")


def drained(seed: int = 1) -> casid.Record:
    rng, q, h, y = np.random.default_rng(seed), steps([0.01, 0.02, 0.03], 40), 0.8, np.empty(N)
    for i in range(N):
        y[i] = h + NOISE * rng.standard_normal()
        for _ in range(10):
            h += 0.5 / 0.5 * (q[i] - 0.02 * np.sqrt(h))
    return casid.Record({"q": q, "y": y}, {"q": "m^3/s", "y": "m"}, 5.0, name="run")


@pytest.mark.parametrize(
    ("problem", "record", "said"),
    [
        (spring(stiffness=+1.0), shaken(30.0), "term k * x in the force balance .* Write -k * x"),
        (spring(damping=+1.0), shaken(30.0), "term d * v in the force balance .* Write -d * v"),
        (tank(+1.0), drained(), "sqrt.h. / A in the derivative of h .* reproduces y to 99"),
    ],
    ids=["spring", "damper", "tank"],
)
def test_a_diagnosis_ends_with_the_term_that_makes_the_model_unstable(
    problem: casid.Problem, record: casid.Record, said: str
) -> None:
    said = said.replace("*", r"\*").replace(r".\*", ".*")
    with pytest.raises(casid.ModelError, match=said):
        casid.diagnose(problem, record)


def test_an_estimate_suspects_the_term() -> None:
    found = casid.identify(spring(damping=+1.0), shaken(30.0), intervals="quick")
    assert "the term d * v in the force balance probably has the wrong sign" in found.suspects[0]


def test_no_term_of_an_unstable_plant_that_is_held_is_suspected() -> None:
    problem, record = spring(stiffness=+1.0), [casid.Experiment(shaken(-30.0), {}, "run")]
    assert wrong_term(problem.model, record, FitSettings(starts=1), None) is None
    found = casid.identify(problem, shaken(-30.0), intervals="quick")
    assert not found.suspects


def test_terms_of_a_quotient_are_negated_one_by_one_and_together() -> None:
    m = casid.Model("law")
    x, k, M = m.state("x", "m"), m.parameter("k", "N/m", start=1.0), m.constant("M", 2.0, "kg")
    c, F = m.parameter("c", "N*s/m", start=1.0), m.input("F", "N")
    m.derivative(x, (F - k * x + k * x**3 / c) / M)
    m.output("y", x, "m")
    written = [[old for old, _ in each.terms] for each in _variants(with_balances(m))]
    assert len(written) == 3
    assert written[2] == [*written[0], *written[1]]
