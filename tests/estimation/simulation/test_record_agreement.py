"""Records that share a parameter and disagree on it are named with it."""

from __future__ import annotations

import re

import numpy as np

import casid


def tank() -> casid.Model:
    """A store that loses heat: T' = (q - h T) / C, C known."""
    m = casid.Model("store")
    T, q = m.state("T", "K"), m.input("q", "W", hold="zoh")
    h = m.parameter("h", "W/K", start=1.5, lower=0.0)
    b = m.parameter("b", "1", start=0.8, lower=0.0)
    C = m.constant("C", 10.0, "J/K")
    m.balance(T, "heat", inertia=C, terms=[-h * T, b * q])
    m.output("temperature", T, "K")
    return m


def recorded(name: str, h: float, seed: int) -> casid.Experiment:
    """Five minutes at 2 Hz, the exact solution under held steps of heat."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(0.0, 20.0, 20).repeat(30)
    T, path = np.zeros(600), 0.0
    for k in range(600):
        T[k] = path
        path = q[k] / h + (path - q[k] / h) * np.exp(-h / 10.0 * 0.5)
    channels = {"q": q, "temperature": T + 0.05 * rng.standard_normal(600)}
    record = casid.Record(channels, {"q": "W", "temperature": "K"}, Ts=0.5, name=name)
    return casid.Experiment(record, name=name)


def disagreements(*experiments: casid.Experiment) -> list[str]:
    problem = casid.Problem("store", tank(), starts=1)
    warnings = casid.identify(problem, list(experiments)).warnings
    return [text for text in warnings if "the records disagree" in text]


def test_records_of_one_system_agree():
    found = disagreements(*(recorded(f"run {k}", 2.0, k) for k in range(4)))
    assert not found


def test_records_of_systems_with_different_losses_disagree_on_the_loss():
    """The first-order estimates of each record lie near its own loss."""
    (first, *_) = disagreements(recorded("june", 2.0, 1), recorded("july", 2.3, 2))
    assert first.startswith("the records disagree on h by more than their errors")
    june, july = (float(value) for value in re.findall(r"([\d.]+) in ju", first))
    assert abs(june - 2.0) < 0.1
    assert abs(july - 2.3) < 0.15


def test_a_model_that_explains_nearly_nothing_is_warned_of():
    e = recorded("run", 2.0, 3)
    noise = 3.0 * np.random.default_rng(5).standard_normal(600)
    unrelated = e.record.with_channel("temperature", noise, "K")
    estimate = casid.identify(casid.Problem("store", tank(), starts=1), unrelated)
    assert any("explains next to nothing of temperature in run" in w for w in estimate.warnings)
    assert not any(
        "next to nothing" in w
        for w in casid.identify(casid.Problem("store", tank(), starts=1), e).warnings
    )


def test_a_record_with_few_samples_for_its_unknowns_says_nothing_of_its_own_estimate():
    """Five samples about a step of heat, for a loss, a gain and an initial state: two are left."""
    few = [recorded(f"run {k}", 2.0, k).record.between(13.5, 15.5) for k in range(4)]
    assert few[0].N == 5
    few = [casid.Experiment(record, name=f"run {k}") for k, record in enumerate(few)]
    assert not disagreements(recorded("june", 2.0, 1), *few)
