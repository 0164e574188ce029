"""The model as a CasADi function: the equations, and the very steps of the fit."""

from __future__ import annotations

import json
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from casid.errors import ModelError
from casid.estimation.fitted.fitted_model import FittedModel
from casid.export.casadi_function import write_casadi
from tests.support.fitted_models import (
    Simulated,
    assert_same,
    delayed_pendulum,
    extended_pendulum,
)


def test_the_function_goes_the_steps_of_the_fit(run: Simulated) -> None:
    function = run.fitted.to_casadi()
    assert [function.name_in(i) for i in range(5)] == ["x", "u", "u_next", "t", "p"]
    states, outputs = [run.x[0]], []
    after = np.vstack([run.u[1:], run.u[-1:]])
    for u, u_next, t in zip(run.u, after, run.t, strict=True):
        step = function(x=states[-1], u=u, u_next=u_next, t=t)
        outputs.append(np.array(step["y"]).ravel())
        states.append(np.array(step["x_next"]).ravel())
    assert_same(np.array(outputs), run.y)
    assert_same(np.array(states), run.x)


def test_chosen_parameters_stay_free() -> None:
    fitted = extended_pendulum()
    function = fitted.to_casadi(["k", "d_2"])
    e = fitted.model.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    values = fitted.si_values | {"k": 11.0, "d_2": 0.4}
    wanted = f([0.1, -0.3], [0.2], [values[n] for n in e.parameters])
    assert_allclose(function(x=[0.1, -0.3], u=0.2, p=[11.0, 0.4])["dx"], wanted, rtol=1e-14)


def test_a_name_that_is_no_parameter_is_refused() -> None:
    with pytest.raises(ModelError, match="no parameter 'K'; did you mean 'k'"):
        extended_pendulum().to_casadi(["K"])


def test_the_function_is_kept_in_a_file(tmp_path: Path) -> None:
    fitted = extended_pendulum()
    loaded = ca.Function.load(str(write_casadi(fitted, tmp_path / "pendulum.casadi")))
    wanted = fitted.to_casadi()
    assert_allclose(loaded(x=[0.1, 0.2], u=0.3)["dx"], wanted(x=[0.1, 0.2], u=0.3)["dx"], rtol=0)


@pytest.mark.parametrize(
    "fitted", [extended_pendulum(), delayed_pendulum(2.3)], ids=["at once", "delayed"]
)
def test_the_files_alone_simulate_as_the_fitted_model(fitted: FittedModel, tmp_path: Path) -> None:
    """What stands beside the function says where it begins, and what goes in and comes out."""
    path = write_casadi(fitted, tmp_path / "pendulum")
    function, beside = ca.Function.load(str(path)), json.loads(Path(f"{path}.json").read_text())
    u = 0.1 * np.cumsum(np.random.default_rng(3).standard_normal(200))
    x, past = [each["initial"] for each in beside["x"]], np.zeros(beside["past"])
    outputs = []
    for k, (now, later) in enumerate(zip(u, [*u[1:], u[-1]], strict=True)):
        memory = {"past": past} if beside["past"] else {}
        step = function(x=x, u=now, u_next=later, t=beside["t0"] + k * beside["Ts"], **memory)
        outputs.append(float(step["y"]))
        x, past = step["x_next"], step.get("past_next")
    wanted = fitted.simulate({"accel": u}, Ts=beside["Ts"])
    assert_allclose(outputs, wanted["gyro"], rtol=0, atol=1e-12)
    assert [(each["name"], each["unit"]) for each in beside["u"]] == [("accel", "m/s^2")]
    assert [(each["name"], each["unit"]) for each in beside["y"]] == [("gyro", "rad/s")]
    values = {each["name"]: each["value"] for each in beside["parameters"]}
    assert values["k"] == fitted.si_values["k"]
