"""The shortest record that decides, and the designs that come from a diagnosis."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import casid
from casid import Aim
from casid.experiment_design.shortest_record import ends_of, shortest
from casid.experiment_design.thresholds import DURATION

SMALL: dict[str, Any] = {"Ts": 0.1, "intervals": 15, "candidates": 5, "starts": 1}


def spring(**noise: float) -> casid.Problem:
    """A first-order lag with a known start: two parameters."""
    m = casid.Model("lag")
    x, u = m.state("x", "m", initial=0.0), m.input("u", "N")
    c, k = m.parameter("c", "N s/m", start=1.0), m.parameter("k", "N/m", start=2.0)
    m.balance(x, "force", inertia=c, terms=[-k * x, u])
    m.output("y", x, "m")
    return casid.Problem("lag", m, noise=noise or {"y": 0.01})


def found_at(score: float) -> Any:
    return SimpleNamespace(best=SimpleNamespace(least=score))


@pytest.mark.parametrize("power", [1.0, 2.5])
def test_a_length_is_enclosed_whatever_the_power_by_which_information_grows(power: float) -> None:
    """Energy (T / 7)^power is 1, what is wanted, at 7 s."""
    best, tried = shortest(
        lambda T, _: found_at(power * np.log(T / 7.0)), (0.5, 60.0), 0.0, lambda _: None
    )
    length = 7.0 * np.exp(best.best.least / power)
    assert 7.0 <= length <= 7.0 * (1 + DURATION.exact) ** 1.5
    assert len(tried) <= DURATION.designs


def test_where_no_length_is_enough_the_longest_is_what_is_given() -> None:
    best, tried = shortest(lambda T, _: found_at(-1.0), (1.0, 5.0), 0.0, lambda _: None)
    assert best.best.least == -1.0
    assert [t.duration for t in tried] == [5.0]


def test_lengths_at_which_a_design_is_refused_are_not_enough() -> None:
    def design(T: float, _: Any) -> Any:
        if T < 3.0:
            raise casid.SolveError("no input keeps every limit")
        return found_at(1.0)

    best, tried = shortest(design, (1.0, 9.0), 0.0, lambda _: None)
    enough = [t.duration for t in tried if t.share >= 1]
    assert 3.0 <= min(enough) <= 3.0 * (1 + DURATION.exact) ** 2
    assert best.best.least == 1.0


@pytest.mark.parametrize("given", [(5, 1), (0, 5), (1, 2, 3), (2, 2), float("nan")])
def test_durations_that_are_none_are_refused(given: Any) -> None:
    with pytest.raises(casid.DataError, match="duration"):
        ends_of(given)


@pytest.mark.slow
def test_the_shortest_record_names_the_cause_and_a_shorter_one_does_not() -> None:
    arguments = (
        spring(y=0.008),
        Aim.separate("quadratic_damping", "cubic_damping"),
        {"u": (-2, 2), "y": (-0.8, 0.8)},
    )
    sizes = {"quadratic_damping": 1.0, "cubic_damping": 1.0}
    found = casid.design_experiment(*arguments, (1.0, 12.0), sizes=sizes, **SMALL)
    assert 1.0 < found.duration < 12.0
    assert found.power >= 0.95
    least = min(o.energy for o in found.outcomes)
    assert found.power >= norm.cdf(np.sqrt(least) / 2) >= 0.95
    tried = found.details["durations"]
    below = max(t["duration"] for t in tried if t["share"] < 1)
    assert found.duration <= below * (1 + 2 * DURATION.exact)
    assert "Designs for other durations" in str(found)


def test_an_estimate_has_no_shortest_record() -> None:
    with pytest.raises(casid.DataError, match="say how exact|Say how exact"):
        casid.design_experiment(spring(), Aim.estimate("k"), {"u": (-1, 1)}, (1, 5), **SMALL)


def shaken(seed: int) -> casid.Record:
    """The lag with cubic damping, driven by small steps; an integration of its own."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1, 1, 30), 10)
    x, out = 0.0, []
    for now in u:
        out.append(x)
        for _ in range(20):
            x += 0.005 * (now - 2.0 * x - 1.5 * x**3)
    y = np.array(out) + 0.01 * rng.standard_normal(len(u))
    return casid.Record({"u": u, "y": y}, {"u": "N", "y": "m"}, Ts=0.1)


def test_a_fit_brings_its_values_and_its_error_as_the_noise() -> None:
    """The noise of the new record is the RMS error that the fit of the old one left."""
    fit = casid.identify(spring(), shaken(1))
    found = casid.design_experiment(fit, Aim.estimate(), {"u": (-2, 2)}, 4.0, **SMALL)
    rmse = next(iter(fit.fit.rmse.values()))["y"]
    assert found.noise["y"] == pytest.approx(rmse)
    assert found.parameters[0].value == pytest.approx(fit.model.values["c"])


def test_a_diagnosis_that_ended_in_a_tie_brings_the_question() -> None:
    cause = SimpleNamespace(
        kind="quadratic_damping",
        where="force",
        alternatives=[SimpleNamespace(kind="cubic_damping", where="force")],
    )
    aim = Aim.of(SimpleNamespace(causes=[cause]))
    assert aim.names == ("quadratic_damping@force", "cubic_damping@force")
    with pytest.raises(casid.DataError, match="without a tie"):
        Aim.of(SimpleNamespace(causes=[SimpleNamespace(kind="a", where="b", alternatives=[])]))
