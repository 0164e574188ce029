"""A wrong type given to a public call is refused with its name, and what belongs there."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import casid
from casid.argument_types import names_wrong_types


def falling() -> casid.Model:
    """A body that falls and is slowed."""
    m = casid.Model("falling body")
    v = m.state("v", "m/s")
    g = m.input("g", "m/s^2")
    c = m.parameter("c", "1/s", start=0.1)
    m.derivative(v, g - c * v)
    m.output("speed", v, "m/s")
    return m


def record() -> casid.Record:
    values = np.zeros(20)
    return casid.Record({"g": values, "speed": values}, {"g": "m/s^2", "speed": "m/s"}, Ts=0.1)


def without_terms() -> None:
    m = casid.Model("falling body")
    m.balance(m.state("v", "m/s"), "force", inertia=1, terms=None)  # type: ignore[arg-type]


def without_aim() -> None:
    casid.design_experiment(
        falling(),
        None,  # type: ignore[arg-type]
        {"g": (-1.0, 1.0)},
        1.0,
        noise={"speed": 1e-3},
    )


WRONG = {
    "external": (lambda: casid.Problem("p", falling(), external=None), r"external = None; .*text"),
    "model": (lambda: casid.Problem("p", None), r"model = None; give a casid.Model"),
    "channel": (lambda: casid.Problem("p", falling(), channels={"g": 3}), r"channels 3 is no text"),
    "effects": (lambda: casid.Problem("p", falling(), effects=None), r"effects = None; .* a list"),
    "bound": (lambda: falling().parameter("k", "N/m", lower=None), r"\('k', ...\): lower = None; "),
    "start": (lambda: falling().parameter("k", "N/m", start="3"), r"start = '3'; give a number"),
    "value": (lambda: falling().with_known(c=None), r"with_known: c = None; give a number"),
    "terms": (lambda: without_terms(), r"terms = None; .*list"),
    "expression": (lambda: falling().output("y", [None], "m"), r"no expression; give a number"),
    "state": (lambda: falling().der(None), r"state is given as None; give its symbol or its name"),
    "units": (lambda: casid.Record({"a": [0.0, 1.0]}, None, Ts=1.0), r"units = None; give a dict"),
    "experiments": (lambda: casid.identify(falling(), [None]), r"None is no record; give one"),
    "problem": (lambda: casid.diagnose(None, record()), r"None is no problem; give casid.Problem"),
    "aim": (
        lambda: without_aim(),
        r"aim = None; give a casid.Aim",
    ),
    "path": (lambda: casid.load_problem(None), r"path = None; give text or a Path"),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_type_is_named_with_what_belongs_there(what: str) -> None:
    call, said = WRONG[what]
    with pytest.raises(casid.CasidError, match=said):
        call()


@pytest.mark.parametrize("wrong", [None, object(), b"x", [None], {"a": None}, float("nan")])
@pytest.mark.parametrize("call", [casid.Problem, casid.Record, casid.Experiment, casid.Model])
def test_no_argument_of_a_constructor_gives_an_error_of_python(
    call: Callable[..., Any], wrong: object
) -> None:
    """Each argument in turn, the others as they should be; what is taken is no fault here."""
    good: dict[str, Any] = {"name": "x", "model": falling(), "record": record()}
    good |= {"channels": {"a": [0.0, 1.0]}, "units": {"a": "m"}, "Ts": 1.0}
    if call is casid.Problem:
        good["channels"] = {"speed": "v"}
    names = inspect.signature(call).parameters
    for name in names:
        given = {n: v for n, v in good.items() if n in names} | {name: wrong}
        with contextlib.suppress(casid.CasidError):
            call(**given)


def test_what_a_function_itself_gets_wrong_stays_its_own_error() -> None:
    """Every argument fits, so that the fault is none of the caller's arguments."""

    @names_wrong_types()
    def share(parts: dict[str, float], name: str, *, scale: float = 1.0) -> float:
        return parts[name] * scale

    with pytest.raises(KeyError, match="b"):
        share({"a": 1.0}, "b", scale=np.float32(2.0))
    with pytest.raises(TypeError, match="missing 1 required"):
        share({"a": 1.0})  # type: ignore[call-arg]
    with pytest.raises(casid.DataError, match=r"share: parts\['b'\] = 'x'; give a number"):
        share({"a": 1.0, "b": "x"}, "b", scale=np.float32(2.0))  # type: ignore[dict-item]
    with pytest.raises(casid.DataError, match="scale = None; give a number, or leave it out"):
        share({"a": 1.0}, "a", scale=None)  # type: ignore[arg-type]


def test_no_public_function_answers_none_with_an_error_of_python() -> None:
    """Each with None for everything that it needs; what a function takes is no fault here."""
    for name in casid.__all__:
        function = getattr(casid, name)
        if not inspect.isfunction(function):
            continue
        needed = [
            p.name
            for p in inspect.signature(function).parameters.values()
            if p.default is p.empty and p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)
        ]
        with contextlib.suppress(casid.CasidError):
            function(**dict.fromkeys(needed))
