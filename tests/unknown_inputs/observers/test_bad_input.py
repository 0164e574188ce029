"""What the rooms of unknown inputs refuse, each with its mend."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import control
import numpy as np
import pytest

from casid.data.record import Record
from casid.errors import CasidError, DataError
from casid.linear.linear_model import linearise
from casid.model.model import Model
from casid.unknown_inputs.observers.decoupled_observer import decoupled_observer
from casid.unknown_inputs.observers.input_smoother import reconstruct_input
from casid.unknown_inputs.observers.noncausal_inverse import noncausal_inverse
from casid.unknown_inputs.observers.system_reader import unknown_input_system
from casid.unknown_inputs.observers.unknown_input_system import UnknownInputSystem


def system(**changed: Any) -> UnknownInputSystem:
    """A mass with damping: velocity and position measured, sampled at 0.1 s."""
    fields: dict[str, Any] = {
        "A": [[0.9, 0.0], [0.1, 0.8]],
        "B": [[1.0], [0.0]],
        "E": [[1.0], [0.0]],
        "C": np.eye(2),
        "D": np.zeros((2, 1)),
        "F": np.zeros((2, 1)),
        "Ts": 0.1,
    }
    return UnknownInputSystem(**(fields | changed))


def record(N: int = 60) -> Record:
    rng = np.random.default_rng(0)
    names = ("y1", "y2", "k1")
    return Record(
        {n: rng.standard_normal(N) for n in names}, dict.fromkeys(names, "1"), Ts=0.1, name="r"
    )


def offset_model() -> Model:
    m = Model("tank")
    x, u = m.state("x", "m"), m.unknown_input("u", "m/s")
    m.derivative(x, -x / m.constant("T", 2.0, "s") + u)
    m.output("level", x + m.constant("height", 1.0, "m"), "m")
    return m


def estimate() -> Any:
    return noncausal_inverse(system()).run(record(), noise={"y1": 1.0, "y2": 1.0})


REFUSALS: list[tuple[Callable[[], Any], str]] = [
    (lambda: system(A=[[np.nan, 0.0], [0.0, 1.0]]), "A holds entries that are not finite; check"),
    (lambda: system(E=np.zeros((2, 0)), F=np.zeros((2, 0))), "no unknown input; name one with"),
    (lambda: system(Ts=-1.0), "give the sample time in seconds, 0 for continuous"),
    (lambda: system(outputs=("y", "y")), "outputs are y, y; give 2 different names"),
    (lambda: system().sampled(0.2), "sampled already, with Ts = 0.1 s; resample the record"),
    (lambda: system(Ts=0.0).sampled(0.0), "Ts = 0.0; give a positive sample time"),
    (lambda: unknown_input_system(offset_model()), "level are not zero at rest; subtract"),
    (lambda: unknown_input_system(control.tf([1], [1, 1])), r"give a realisation, control.ss"),
    (lambda: unknown_input_system("plant"), "a str is no linear system; give a casid Model"),
    (lambda: decoupled_observer(system(), noise={"y3": 1.0}), "noise names 'y3', no output"),
    (
        lambda: decoupled_observer(system(), noise={"y1": 1.0, "y2": 1.0}, process=np.eye(3)),
        r"process is \(3, 3\); give \(2, 2\)",
    ),
    (
        lambda: decoupled_observer(system(), poles=[0.1, 0.2]).run(record()).std_error("x1"),
        "no noise was given, so no standard deviation.*design the observer with noise=",
    ),
    (lambda: decoupled_observer(system(), poles=[0.1, 0.2]).run(record())["x9"], "no state 'x9'"),
    (lambda: noncausal_inverse(system(), noise={"a": 1.0}), "noise names 'a', no output"),
    (
        lambda: noncausal_inverse(system()).amplification(np.ones(1), {"y1": 1.0}),
        "no noise of y2; give a positive standard deviation for every output",
    ),
    (lambda: estimate().added_to(record(50)), "50 samples, the estimate 60; give the record it"),
    (
        lambda: estimate().added_to(record().rename({"k1": "u1"})),
        "has a channel 'u1' already; take it out with record.without",
    ),
    (lambda: estimate()["wind"], "no unknown input 'wind'"),
    (lambda: reconstruct_input(system(), record().without("k1")), "no channel 'k1'"),
]


@pytest.mark.parametrize(("attempt", "said"), REFUSALS)
def test_each_refusal_says_how_to_mend_it(attempt: Callable[[], Any], said: str) -> None:
    with pytest.raises(CasidError, match=said):
        attempt()


def test_a_continuous_observer_knows_two_ways_between_samples() -> None:
    slow = system(A=[[-1.0, 0.0], [1.0, -2.0]], Ts=0.0)
    observer = decoupled_observer(slow, poles=[-3.0, -4.0])
    with pytest.raises(DataError, match="hold = 'linear'; give 'foh' or 'zoh'"):
        observer.run(record(), hold="linear")
    assert observer.run(record(), hold="zoh").x.shape == (60, 2)


def test_a_linear_model_is_told_which_input_is_unknown() -> None:
    m = Model("cart")
    v, F = m.state("v", "m/s"), m.input("F", "N")
    m.balance(v, "force", inertia=2.0, terms=[F])
    m.output("speed", v, "m/s")
    s = unknown_input_system(linearise(m), "F")
    assert s.unknown == ("F",)
    np.testing.assert_allclose(s.E, [[0.5]])
    with pytest.raises(CasidError, match="which input is unknown.*one of F"):
        unknown_input_system(linearise(m))


def test_reports_say_what_was_found() -> None:
    s = system()
    assert "unknown u1" in repr(s)
    observer = decoupled_observer(s, poles=[0.1, 0.2])
    assert "free of u1, slowest pole z = 0.2" in repr(observer)
    assert "an observer decoupled from the unknown input exists" in str(observer.found)
    inverse = noncausal_inverse(system(C=[[-1.2, 1.0]], D=[[0.0]], F=[[0.0]]))
    assert "runs forward" in str(inverse)
    text = str(estimate())
    assert "standard deviation" in text
    assert "noise of y1" in text
