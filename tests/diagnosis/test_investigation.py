"""Diagnosis and design in turns: a tie that a weak record leaves is broken by a designed one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import casid
from casid import Aim

SMALL: dict[str, Any] = {"Ts": 0.1, "intervals": 24, "candidates": 12, "starts": 1, "seconds": 6.0}


def store() -> casid.Problem:
    """A first-order lag; the truth beside it has a force that grows with the cube of the state."""
    m = casid.Model("store")
    x, u = m.state("x", "m", initial=0.0), m.input("u", "N", hold="zoh")
    c, k = m.parameter("c", "N s/m", start=1.0), m.parameter("k", "N/m", start=2.0)
    m.balance(x, "force", inertia=c, terms=[-k * x, u])
    m.output("y", x, "m")
    return casid.Problem("store", m, noise={"y": 0.01})


def bench(u: np.ndarray, seed: int, cubic: float = 1.0) -> casid.Record:
    """The truth by Euler steps of 5 ms, which shares no code with casid."""
    rng, x, y = np.random.default_rng(seed), 0.0, []
    for now in u:
        y.append(x)
        for _ in range(20):
            x += 0.005 * (now - 2.0 * x - cubic * x**3)
    noisy = np.array(y) + 0.01 * rng.standard_normal(len(u))
    return casid.Record({"u": u, "y": noisy}, {"u": "N", "y": "m"}, Ts=0.1, name=f"record {seed}")


def weak(cubic: float = 1.0) -> casid.Record:
    """Steps so small that a cube and a square look alike."""
    levels = np.random.default_rng(3).uniform(-1, 1, 20)
    return bench(np.repeat(levels, 10), 1, cubic)


def _not_called(_: casid.DesignedExperiment) -> casid.Record:
    raise AssertionError("two records decide")


@pytest.mark.slow
def test_a_tie_is_broken_by_the_record_that_was_designed_for_it(tmp_path: Path) -> None:
    """Without a bench it ends at the experiment to take; with its record it names the truth."""
    first = casid.investigate(store(), [weak()], {"u": (-3, 3)}, 12.0, **SMALL)
    assert not first.is_decided
    assert first.next is not None
    assert first.next.power > 0.99
    assert "record the designed experiment" in str(first)
    second = bench(first.next.record["u"], 2)
    found = casid.investigate(
        store(),
        [weak(), second],
        {"u": (-3, 3)},
        12.0,
        measure=_not_called,
        **SMALL,
    )
    assert found.is_decided
    assert found.next is None
    assert [c.kind for c in found.diagnosis.causes] == ["cubic_damping"]
    first.write(tmp_path)
    assert (tmp_path / "design-1" / "input.csv").exists()
    assert (tmp_path / "diagnosis-1" / "diagnosis.json").exists()
    saved = casid.load(tmp_path / "diagnosis-1")
    assert Aim.of(saved).names == Aim.of(first.diagnosis).names
    played = casid.read_record(tmp_path / "input.csv")
    assert played["u"] == pytest.approx(second["u"])
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "The experiment to record next" in page
    assert first.to_json()["is_decided"] is False


def test_a_model_that_is_right_needs_no_experiment() -> None:
    found = casid.investigate(store(), [weak(cubic=0.0)], {"u": (-3, 3)}, 12.0, **SMALL)
    assert found.is_decided
    assert not found.designs
    assert found.diagnosis.verdict == "adequate"


@pytest.mark.slow
def test_a_bench_is_called_for_as_many_records_as_it_may_take() -> None:
    """It answers with the weak record again, from which nobody is the wiser."""
    calls: list[casid.DesignedExperiment] = []

    def measure(design: casid.DesignedExperiment) -> casid.Record:
        calls.append(design)
        return bench(np.zeros(20), 5 + len(calls))

    found = casid.investigate(
        store(), [weak()], {"u": (-3, 3)}, 12.0, measure=measure, most=1, **SMALL
    )
    assert len(calls) == 1
    assert len(found.records) == 2
    assert found.is_decided or "after 1 record" in found.ending


@pytest.mark.slow
def test_what_is_no_record_is_refused() -> None:
    with pytest.raises(casid.DataError, match="no record to begin with"):
        casid.investigate(store(), [], {"u": (-3, 3)}, 12.0)
    with pytest.raises(casid.DataError, match="measure gave ndarray"):
        casid.investigate(
            store(), [weak()], {"u": (-3, 3)}, 12.0, measure=lambda _: np.zeros(3), **SMALL
        )
