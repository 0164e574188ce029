"""The model linearised, as a state space of python-control."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path

import casadi as ca
import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

import casid
from casid.arrays import Array
from casid.errors import ModelError
from casid.estimation.fitted.fitted_model import FittedModel
from casid.export.control_system import write_control
from casid.model.effects.balances.balance_effects import coulomb_friction
from tests.support.fitted_models import (
    Simulated,
    assert_same,
    driven_mass,
    extended_emps,
    extended_pendulum,
    fitted_model,
    simulated,
    with_steps,
)


def test_the_state_space_is_the_model_linearised(run: Simulated) -> None:
    """Against central differences of the equations, at a point where nothing is singular."""
    fitted = run.fitted
    e = fitted.model.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f, e.h])
    at = {name: 0.3 + 0.1 * i for i, name in enumerate((*e.states, *e.inputs))}
    system = fitted.to_control(at)
    assert isinstance(system, control.StateSpace)
    assert (tuple(system.state_labels), system.input_labels) == (e.states, [*e.inputs] or ["none"])
    assert tuple(system.output_labels) == e.outputs
    point, nx = np.array(list(at.values())), len(e.states)
    p = [fitted.si_values[n] for n in e.parameters]

    def value(z: Array) -> Array:
        return np.vstack([np.array(v) for v in f(z[:nx], z[nx:], p)]).ravel()

    h = 1e-5
    slopes = np.array(
        [(value(point + s) - value(point - s)) / (2 * h) for s in h * np.eye(len(at))]
    )
    found = np.block([[system.A, system.B], [system.C, system.D]])[:, : len(at)]
    assert_allclose(found, slopes.T, rtol=1e-6, atol=1e-7 * np.abs(slopes).max())


def test_small_motions_are_those_of_the_state_space() -> None:
    """So small that drag is 1e-10 of damping; 16 steps a sample leave nothing of Runge-Kutta."""
    fitted = with_steps(extended_pendulum(), 16, x0=(0.0, 0.0))
    t = fitted.Ts * np.arange(400)
    small = 1e-9 * np.cumsum(np.random.default_rng(5).standard_normal(400))
    wanted = simulated(fitted, {"accel": small})
    response = control.forced_response(fitted.to_control(), t, small)
    assert_same(np.atleast_2d(response.outputs).T, wanted.y)


def test_drag_bends_the_state_space_away_from_rest() -> None:
    fitted, p = extended_pendulum(), 0.5
    at_rest, moving = fitted.to_control(), fitted.to_control({"p": p})
    I_2 = -10.37 / at_rest.A[1, 0]
    assert moving.A[1, 1] - at_rest.A[1, 1] == pytest.approx(-2 * 0.2 * p / I_2, rel=1e-12)


def test_the_written_state_space_is_the_same(tmp_path: Path) -> None:
    fitted = extended_emps()
    path = write_control(fitted, tmp_path / "rail.py", {"v": 0.1})
    spec = importlib.util.spec_from_file_location("rail", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    system = fitted.to_control({"v": 0.1})
    for name in "ABCD":
        assert np.array_equal(getattr(module.system, name), getattr(system, name))
    assert module.system.state_labels == system.state_labels


def test_any_name_of_a_model_is_text_in_the_written_file(tmp_path: Path) -> None:
    """Quotes, a backslash and a line break end neither the docstring nor a string of the file."""
    fitted = replace(extended_emps(), name='a "rail"\nof a\\b """')
    path = write_control(fitted, tmp_path / "rail.py")
    spec = importlib.util.spec_from_file_location("rail", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.system.name == fitted.to_control().name


def test_a_point_that_is_no_state_or_input_is_refused() -> None:
    with pytest.raises(ModelError, match=r"no state or input 'psi'.*phi, p, accel"):
        extended_pendulum().to_control({"psi": 1.0})


def sliding_mass() -> FittedModel:
    """A mass on a spring with dry friction that is smoothed below 1 mm/s, as a diagnosis has it."""
    problem = casid.Problem("mass", driven_mass())
    fitted = fitted_model(
        problem,
        [lambda m: coulomb_friction(m, "force", speed=1e-3)],
        {"d": 1.5, "k": 50.0, "F_c": 3.0},
        x0=(0.0, 0.0),
        Ts=0.01,
        N=40,
    )
    causes = tuple(replace(c, constants={"speed": 1e-3}) for c in fitted.causes)
    return replace(fitted, causes=causes)


def test_a_state_space_at_rest_says_that_its_slopes_are_those_of_a_smoothed_friction(
    tmp_path: Path,
) -> None:
    """3 N over 1 mm/s are 3000 N s/m: the pole of the axis would be at -1500 1/s."""
    said: list[str] = []
    path = write_control(sliding_mass(), tmp_path / "mass.py", say=said.append)
    (note,) = said
    assert "Dry friction in the force balance is smoothed about rest" in note
    assert "--at v=VALUE" in note
    text = path.read_text()
    assert '(--at v=VALUE).\n"""' in text
    compile(text, str(path), "exec")
    with pytest.warns(UserWarning, match="slopes are those of the smoothing"):
        assert sliding_mass().to_control().poles().real.min() == pytest.approx(-1500.7, rel=1e-3)


def test_where_it_slides_nothing_is_said_of_its_friction(tmp_path: Path) -> None:
    said: list[str] = []
    path = write_control(sliding_mass(), tmp_path / "mass.py", {"v": 0.1}, say=said.append)
    assert said == []
    assert "smoothed" not in path.read_text()
