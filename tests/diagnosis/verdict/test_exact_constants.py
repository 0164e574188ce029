"""Constants are taken as exact: a diagnosis that finds a deficiency says which they are."""

from __future__ import annotations

import numpy as np
import pytest

import casid


def cooled(eta: float) -> casid.Record:
    """A store of 1 kJ/K that leaks 0.05 kW/K and is cooled by `eta` times a stepped power."""
    rng, T = np.random.default_rng(2), [0.0]
    P = np.repeat(rng.uniform(0, 1, 40), 20)
    for power in P[:-1]:
        # The step of a linear store under constant power is exact.
        rest = -eta * power / 0.05
        T.append(rest + (T[-1] - rest) * float(np.exp(-0.05)))
    noisy = np.array(T) + 0.01 * rng.standard_normal(len(T))
    return casid.Record({"P": 1e3 * P, "T": noisy}, {"P": "W", "T": "K"}, Ts=1.0)


def store(*, is_constant: bool) -> casid.Problem:
    m = casid.Model("store")
    T, P = m.state("T", "K"), m.input("P", "kW", hold="zoh")
    UA = m.parameter("UA", "kW/K", start=0.05, lower=1e-3)
    eta = m.constant("eta", 2.0, "1") if is_constant else m.parameter("eta", "1", value=2.0)
    C = m.parameter("C", "kJ/K", value=1.0)
    m.balance(T, "heat", inertia=C, terms=[-UA * T, -eta * P], unit="kW")
    m.output("T", T, "K")
    return casid.Problem("store", m)


def notes_on_eta(problem: casid.Problem, eta: float) -> list[str]:
    found = casid.diagnose(problem, cooled(eta), advise=False)
    return [n for n in found.notes if "never suspected: eta." in n]


@pytest.mark.slow
def test_a_deficient_model_names_the_constants_that_no_cause_stands_for():
    """The efficiency is 1.5 where the model has 2: a wrong one makes the model deficient."""
    assert len(notes_on_eta(store(is_constant=True), 1.5)) == 1


@pytest.mark.slow
def test_an_adequate_model_and_one_without_constants_have_no_such_note():
    assert notes_on_eta(store(is_constant=True), 2.0) == []
    assert notes_on_eta(store(is_constant=False), 1.5) == []
