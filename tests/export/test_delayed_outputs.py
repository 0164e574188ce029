"""Exports of a model whose sensor is late: the very samples of casid's simulation.

A delay shorter than a sample is centred on the next sample, which a record does not have at its
end: there the fit goes on along a straight line, and an export with its step, so the last sample
of such a delay is left out.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from numpy.testing import assert_allclose

from casid.arrays import Array
from casid.errors import ModelError
from tests.export.test_c_code import compiled, needs_compiler, pointer
from tests.export.test_fmu import unit
from tests.support.fitted_models import assert_same, delayed_pendulum

DELAYS = (0.3, 1.0, 2.3, 17.75)  # samples


def driven(samples: float) -> tuple[Array, Array]:
    """The input (N,), and what casid simulates of the late gyro (N, 1)."""
    fitted = delayed_pendulum(samples)
    accel = 0.1 * np.cumsum(np.random.default_rng(3).standard_normal(fitted.records[0].N))
    return accel, fitted.simulate({"accel": accel})["gyro"][:, None]


def test_the_delay_is_in_what_is_compared() -> None:
    late, prompt = driven(2.3)[1], driven(0.0)[1]
    assert np.abs(late - prompt).max() > 1e-2 * np.abs(prompt).max()


@pytest.mark.parametrize("samples", DELAYS)
def test_the_casadi_function_has_a_memory(samples: float) -> None:
    accel, wanted = driven(samples)
    function = delayed_pendulum(samples).to_casadi()
    x, past, y = [0.01, -0.02], np.zeros(function.numel_in("past")), []
    for u, u_next in zip(accel, [*accel[1:], accel[-1]], strict=True):
        step = function(x=x, u=u, u_next=u_next, past=past)
        x, past = step["x_next"], step["past_next"]
        y.append(np.array(step["y"]).ravel())
    assert_same(np.array(y)[:-1], wanted[:-1])
    if samples >= 1:
        assert_same(np.array(y), wanted)


def stepped_in_c(
    library: Any, header: str, kept: int, command: np.ndarray, outputs: int
) -> np.ndarray:
    """(N - 1, outputs) what the C step gives, sample by sample, with `kept` past values."""
    n_p = int(header.partition("#define MODEL_NP ")[2].split()[0])
    p = np.array((ctypes.c_double * n_p).in_dll(library, "model_p"))
    x = np.array((ctypes.c_double * 2).in_dll(library, "model_x0"))
    past, y = np.zeros(kept), []
    for k in range(len(command) - 1):
        u, u_next, given = (
            command[k : k + 1].copy(),
            command[k + 1 : k + 2].copy(),
            np.zeros(outputs),
        )
        x_next, past_next = np.zeros(2), np.zeros(kept)
        before = [pointer(x), pointer(u), pointer(u_next), ctypes.c_double(0.0), pointer(p)]
        after = [pointer(x_next), pointer(given), pointer(past_next)]
        library.model_step(*before, pointer(past), *after)
        x, past = x_next, past_next
        y.append(given)
    return np.array(y)


@needs_compiler
@pytest.mark.parametrize("samples", DELAYS)
def test_the_c_step_has_a_memory(samples: float, tmp_path: Path) -> None:
    accel, wanted = driven(samples)
    fitted = delayed_pendulum(samples)
    library = compiled(fitted.to_c(tmp_path / "model"))
    kept = int(samples) + 3  # past samples, and whether there was one
    text = (tmp_path / "model.h").read_text()
    assert f"#define MODEL_NPAST {kept}\n" in text
    assert_same(stepped_in_c(library, text, kept, accel, 1), wanted[:-1])


@needs_compiler
@pytest.mark.parametrize("samples", DELAYS)
def test_co_simulation_has_a_memory(samples: float, tmp_path: Path) -> None:
    """Inputs get their derivative before the output is read, as a delay of 0.3 samples needs."""
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    from fmpy.validation import validate_fmu

    accel, wanted = driven(samples)
    fitted = delayed_pendulum(samples)
    path = fitted.to_fmu(tmp_path / "model.fmu")
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    assert description.modelExchange is None
    Ts, y = fitted.Ts, []
    with unit(path, "CoSimulation") as (fmu, places):
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        for k, slope in enumerate(np.diff(accel) / Ts):
            fmu.setReal([places["accel"]], [accel[k]])
            fmu.setRealInputDerivatives([places["accel"]], [1], [slope])
            y.append(fmu.getReal([places["gyro"]]))
            fmu.doStep(currentCommunicationPoint=k * Ts, communicationStepSize=Ts)
        with pytest.raises(Exception, match="fmi2DoStep failed"):
            fmu.doStep(currentCommunicationPoint=(k + 1) * Ts, communicationStepSize=0.4 * Ts)
    assert_same(np.array(y), wanted[:-1])


def test_the_state_space_has_a_pade_approximation_of_the_delay() -> None:
    """Its relative error is the first term that the approximation leaves out.

    Of order n it is (s T)^(2n+1) n!^2 / ((2n)! (2n+1)!): for n = 3, 36 / (720 * 5040).
    """
    fitted = delayed_pendulum(2.3)
    T = 0.023
    prompt = fitted.to_control(without_delays=True)
    late = fitted.to_control(pade=3)
    assert late.nstates == prompt.nstates + 3
    for wT in (0.1, 0.5, 1.0):
        s = 1j * wT / T
        left_out = wT**7 * 36 / (720 * 5040)
        assert_allclose(late(s), prompt(s) * np.exp(-s * T), rtol=1.1 * left_out + 1e-12)
    assert isinstance(late, control.StateSpace)


def test_a_state_space_of_a_late_sensor_asks_how() -> None:
    fitted = delayed_pendulum(2.3)
    with pytest.raises(ModelError, match="gyro by 0.023 s.*pade=3"):
        fitted.to_control()
    with pytest.raises(ModelError, match="an order from 1 to 10"):
        fitted.to_control(pade=0)


def test_a_delay_cannot_stay_free() -> None:
    with pytest.raises(ModelError, match="delay_gyro is in none of the equations"):
        delayed_pendulum(2.3).to_casadi(["delay_gyro"])


def test_without_delays_the_step_is_that_of_the_equations() -> None:
    function = delayed_pendulum(2.3).to_casadi(without_delays=True)
    assert function.name_in() == ["x", "u", "u_next", "t", "p"]
    assert function.n_out() == 3
