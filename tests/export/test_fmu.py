"""The model as a functional mock-up unit, read and simulated by FMPy."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from casid.compiler import compiler
from casid.errors import DataError
from tests.support.fitted_models import Simulated, assert_same, extended_emps, extended_pendulum

fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler is found here")


@contextmanager
def unit(path: Path, kind: str) -> Iterator[tuple[Any, dict[str, int]]]:
    """An instance of a unit ("CoSimulation" or "ModelExchange"), and its variables by name."""
    from fmpy.fmi2 import FMU2Model, FMU2Slave

    description = fmpy.read_model_description(str(path))
    folder = fmpy.extract(str(path))
    is_slave = kind == "CoSimulation"
    made = description.coSimulation if is_slave else description.modelExchange
    instance = (FMU2Slave if is_slave else FMU2Model)(
        guid=description.guid,
        unzipDirectory=folder,
        modelIdentifier=made.modelIdentifier,
        instanceName="test",
    )
    instance.instantiate()
    try:
        yield instance, {v.name: v.valueReference for v in description.modelVariables}
    finally:
        instance.freeInstance()
        shutil.rmtree(folder)


@pytest.fixture(scope="module")
def pendulum_unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The extended pendulum as a unit."""
    if compiler() is None:
        pytest.skip("no C compiler is found here")
    return extended_pendulum().to_fmu(tmp_path_factory.mktemp("fmu") / "pendulum.fmu")


@needs_compiler
def test_co_simulation_goes_the_steps_of_the_fit(run: Simulated, tmp_path: Path) -> None:
    from fmpy.validation import validate_fmu

    path = run.fitted.to_fmu(tmp_path / "model.fmu")
    assert validate_fmu(str(path)) == []
    Ts, outputs = run.fitted.Ts, []
    with unit(path, "CoSimulation") as (fmu, places):
        inputs = [places[n] for n in run.inputs]
        fmu.setupExperiment(startTime=run.t[0])
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        for k, t in enumerate(run.t):
            if inputs:
                fmu.setReal(inputs, run.u[k].tolist())
            outputs.append(fmu.getReal([places[n] for n in run.fitted.model.outputs]))
            if k + 1 == len(run.t):
                break
            if inputs:
                slopes = (run.u[k + 1] - run.u[k]) / Ts
                fmu.setRealInputDerivatives(inputs, [1] * len(inputs), slopes.tolist())
            fmu.doStep(currentCommunicationPoint=t, communicationStepSize=Ts)
    assert_same(np.array(outputs), run.y)


@needs_compiler
def test_steps_of_other_lengths_agree_where_the_steps_are_fine(tmp_path: Path) -> None:
    """2.5 samples a step: two steps of the fit and half a sample, which Runge-Kutta fills."""
    fitted = extended_emps()
    path = fitted.to_fmu(tmp_path / "rail.fmu")
    found = []
    for samples in (1.0, 2.5):
        with unit(path, "CoSimulation") as (fmu, places):
            fmu.setupExperiment(startTime=0.0)
            fmu.enterInitializationMode()
            fmu.exitInitializationMode()
            fmu.setReal([places["force"]], [60.0])
            for k in range(round(20 / samples)):
                fmu.doStep(k * samples * fitted.Ts, samples * fitted.Ts)
            found.append(fmu.getReal([places["q"], places["v"]]))
    assert_allclose(found[1], found[0], rtol=1e-6)
    assert found[0][0] > 0.0


def test_model_exchange_has_the_equations(pendulum_unit: Path) -> None:
    fitted = extended_pendulum()
    e = fitted.model.explicit()
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    values = fitted.si_values | {"d_2": 0.7}
    wanted = np.array(f([0.3, -0.4], [0.5], [values[n] for n in e.parameters])).ravel()
    with unit(pendulum_unit, "ModelExchange") as (fmu, places):
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.setReal([places["d_2"]], [0.7])
        fmu.exitInitializationMode()
        fmu.enterContinuousTimeMode()
        fmu.setReal([places["accel"], places["phi"], places["p"]], [0.5, 0.3, -0.4])
        found = fmu.getReal([places["der(phi)"], places["der(p)"]])
    assert_allclose(found, wanted, rtol=1e-14)


def test_the_description_has_units_and_starts(pendulum_unit: Path) -> None:
    description = fmpy.read_model_description(str(pendulum_unit))
    variables = {v.name: v for v in description.modelVariables}
    assert (variables["d_2"].unit, float(variables["d_2"].start)) == ("N m s^2/rad^2", 0.2)
    assert (variables["phi"].unit, float(variables["phi"].start)) == ("rad", 0.01)
    assert (variables["accel"].causality, variables["gyro"].causality) == ("input", "output")


def test_without_a_compiler_the_reason_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(DataError, match="no C compiler is found here; install gcc"):
        extended_pendulum().to_fmu(tmp_path / "pendulum.fmu")
