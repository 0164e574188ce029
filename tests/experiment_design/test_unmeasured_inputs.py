"""Designs for models in which an unknown input was eliminated with a sensor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

import casid
from casid import Aim
from problems.pendulum import TABLE_7_2, indirect_model

SMALL: dict[str, Any] = {"Ts": 0.05, "intervals": 24, "candidates": 5, "starts": 1}
LIMITS = {"a_y": (-1, 1), "phi": (-0.15, 0.15)}


def pendulum(**noise: float) -> casid.Problem:
    """The pendulum on a cart whose acceleration is eliminated with the accelerometer."""
    return casid.Problem("pendulum", indirect_model(), noise=noise or {"gyro": 0.01})


@pytest.fixture(scope="module")
def designed() -> casid.DesignedExperiment:
    return casid.design_experiment(pendulum(), Aim.estimate(), LIMITS, 6.0, **SMALL)


def gyro(t: np.ndarray, accel: np.ndarray, k: float, d: float, I_x: float, *x0: float) -> Any:
    """phi' of I_2 phi'' = -k phi - d phi' - S a_s (7.24), by SciPy."""
    S = TABLE_7_2["M"] * TABLE_7_2["z_g"]
    inertia = I_x + TABLE_7_2["M"] * TABLE_7_2["z_g"] ** 2 - TABLE_7_2["z_s"] * S
    A = np.array([[0.0, 1.0], [-k / inertia, -d / inertia]])
    system = StateSpace(A, np.array([[0.0], [-S / inertia]]), np.array([[0.0, 1.0]]), 0.0)
    return lsim(system, accel, t, np.array(x0))[1]


@pytest.mark.slow
def test_what_the_cart_is_made_to_do_gives_what_the_indirect_model_can_learn(
    designed: casid.DesignedExperiment,
) -> None:
    """Standard errors are those of (7.24) with the accelerometer that the record would have.

    Not those of the pendulum under a known acceleration of the cart, which the record does not say.
    """
    record = designed.record
    at = np.array([8.0, 0.1, 0.15, 0.0, 0.0])
    columns = []
    for i, step in enumerate((1e-3, 1e-4, 1e-5, 1e-5, 1e-5)):
        up, down = (
            gyro(record.t, record["accel"], *(at + s * step * np.eye(5)[i])) for s in (1, -1)
        )
        columns.append((up - down) / (2 * step) / 0.01)
    information = np.array(columns) @ np.array(columns).T
    wanted = np.sqrt(np.diag(np.linalg.inv(information)))[:3]
    found = [p.std_error for p in designed.parameters]
    assert found == pytest.approx(wanted, rel=0.01)


@pytest.mark.slow
def test_the_sensor_shows_what_the_direct_model_makes_of_the_input(
    designed: casid.DesignedExperiment,
) -> None:
    """a_s = z_s phi'' + g phi - a_y (7.15), phi from the gyro of the same record."""
    record = designed.record
    assert designed.inputs == ("a_y",)
    assert set(record) == {"a_y", "gyro", "accel"}
    p = record["gyro"]
    phi = 0.05 * (np.cumsum(p) - 0.5 * p - 0.5 * p[0])
    rate = np.gradient(p, 0.05)
    a_s = TABLE_7_2["z_s"] * rate + 9.81 * phi - record["a_y"]
    inner = slice(2, -2)
    spread = np.std(record["accel"])
    assert np.sqrt(np.mean((a_s - record["accel"])[inner] ** 2)) < 0.1 * spread


def test_an_unmeasured_input_that_is_not_designed_is_taken_as_zero_and_said_to_be() -> None:
    """A driven pendulum on a cart that stands still: the torque is what is chosen."""
    m = casid.Model("driven pendulum")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    u, a = m.input("u", "N m"), m.unknown_input("a", "m/s^2")
    k = m.parameter("k", "N m/rad", start=10.0, lower=0.0)
    d = m.parameter("d", "N m s/rad", start=0.5, lower=0.0)
    J, S = m.constant("J", 0.2, "kg m^2"), m.constant("S", -0.4, "kg m")
    m.derivative(phi, p)
    m.balance(p, "torque", inertia=J, terms=[-k * phi, -d * p, S * a, u])
    m.output("gyro", p, "rad/s")
    m.output("accel", 9.81 * phi * m.constant("one", 1.0, "m/s^2") - a, "m/s^2")
    problem = casid.Problem("driven", m.eliminate("a", using="accel"), noise={"gyro": 0.01})
    found = casid.design_experiment(problem, Aim.estimate(), {"u": (-1, 1)}, 6.0, **SMALL)
    assert found.gain >= 1.0
    assert any(
        note.startswith("a, which is not measured, is assumed to be 0") for note in found.notes
    )


def test_an_input_that_would_make_the_sensor_jump_is_refused() -> None:
    with pytest.raises(casid.DataError, match="piecewise constant a_y jumps"):
        casid.design_experiment(pendulum(), Aim.estimate(), LIMITS, 6.0, shape="constant", **SMALL)


@pytest.mark.slow
def test_two_causes_are_separated_through_the_indirect_model() -> None:
    runs = 20
    found = casid.design_experiment(
        pendulum(gyro=0.02),
        Aim.separate("quadratic_damping", "coulomb_friction"),
        LIMITS,
        6.0,
        sizes={"quadratic_damping": 0.2},
        verify=runs,
        verify_by="fits",
        **SMALL,
    )
    for o in found.outcomes:
        spread = np.sqrt(o.power * (1 - o.power) / runs)
        assert abs(o.right / runs - o.power) <= 4 * spread + 0.5 / runs
