"""The model as Modelica, checked and simulated by the compiler Rumoca."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import casid
from casid.estimation.fitted.fitted_model import FittedModel
from casid.export.modelica import modelica_text, modelica_unit
from tests.support.fitted_models import (
    assert_same,
    extended_emps,
    extended_pendulum,
    extended_roll_decay,
    fitted_model,
    simulated,
    with_steps,
)


def assert_compiled_is_the_same(model: FittedModel) -> None:
    """With an input linear in time, which both know exactly."""
    rumoca = pytest.importorskip("rumoca", reason="the Modelica compiler rumoca is not installed")
    t = model.Ts * np.arange(model.records[0].N)
    names = [n for n, u in model.model.inputs.items() if u.kind != "generated"]
    wanted = simulated(model, dict.fromkeys(names, 0.3 + 0.2 * t))
    text = modelica_text(model, "Plant")
    drive = "".join(f"  plant.{n} = 0.3 + 0.2*time;\n" for n in names)
    text += f"model Drive\n  Plant plant;\nequation\n{drive}end Drive;\n"
    assert rumoca.validate_source(text) == []
    compiled = rumoca.Session().loads(text, model="Drive")
    settings = rumoca.SimConfig(solver="rk-like", rtol=1e-12, atol=1e-14)
    table = compiled.simulate(t=(0.0, float(t[-1])), dt=model.Ts, config=settings).to_dataframe()
    states = table[[f"plant.{s}" for s in model.model.states]].to_numpy()
    assert_same(states, wanted.x[:-1])
    outputs = table[[f"plant.{y}" for y in model.model.outputs]].to_numpy()
    assert_same(outputs, wanted.y)


@pytest.mark.parametrize(
    ("fitted", "steps"),
    [(extended_pendulum, 8), (extended_roll_decay, 8), (extended_emps, 16)],
    ids=["pendulum", "roll decay", "EMPS"],
)
def test_the_compiled_model_simulates_to_the_same(fitted: FittedModel, steps: int) -> None:
    """With steps so fine that both agree."""
    assert_compiled_is_the_same(with_steps(fitted(), steps))  # type: ignore[operator]


def test_terms_with_a_negative_number_have_one_sign_in_front() -> None:
    """Modelica has no "- -(a)": radiation, written with its constant, was refused by a compiler."""
    m = casid.Model("hot body")
    T, P = m.state("T", "K"), m.input("P", "W", known=True)
    C, A = m.constant("C", 500.0, "J/K"), m.parameter("A", "m^2", start=0.3, lower=0.0)
    h = m.constant("h", 2.0, "W/K")
    gain = -(h * T - 0.5 * P)
    m.balance(T, "heat", inertia=C, terms=[P, -5.67e-8 * A * (T**4 - 293.0**4), gain, -(-3.0 * P)])
    m.output("T_out", T, "K")
    problem = casid.Problem("hot body", m)
    fitted = fitted_model(problem, [], {"A": 0.3}, x0=(300.0,), Ts=1.0, N=60, substeps=4)
    text = modelica_text(fitted, "Body")
    assert "    - 5.67e-08 * A * (T^4 - 7370050801)" in text
    assert not re.search(r"[-+] *[-+]", text)
    assert_compiled_is_the_same(fitted)


def test_the_text_reads_as_the_physics(tmp_path: Path) -> None:
    path = extended_pendulum().to_modelica(tmp_path / "Pendulum.mo")
    lines = [line.strip() for line in path.read_text().splitlines()]
    for line in (
        'parameter Real d_2(unit="N.m.s2/rad2") = 0.2 "estimated, standard error 0.001";',
        'Real phi(unit="rad", start=0.01, fixed=true);',
        'input Real accel(unit="m/s2");',
        "accel = z_s * der(p) + g * phi - a_y;",
        "- d_2 * abs(p) * p;  // quadratic damping in the torque balance",
    ):
        assert line in lines


@pytest.mark.parametrize(
    ("unit", "modelica"),
    [
        ("N m s^2/rad^2", "N.m.s2/rad2"),
        ("kg/(m s)", "kg/(m.s)"),
        ("1/s", "1/s"),
        ("1", "1"),
        ("m^2.5/s", None),
    ],
)
def test_units_are_those_of_modelica(unit: str, modelica: str | None) -> None:
    assert modelica_unit(unit) == modelica
