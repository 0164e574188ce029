"""The ship in four degrees of freedom as a problem: its model is the simulator's, and is found."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import asdict, fields, replace

import casadi as ca
import numpy as np
import pytest
from scipy.stats import chi2

import casid
from problems.ship_4dof import (
    LOAD_CASES,
    SOUGHT,
    Coefficients,
    Load,
    PolynomialArm,
    Ship,
    Start,
    dynamics,
    experiments,
    problem,
    problem_of,
    random_steps,
    simulate,
    true_values,
)
from problems.ship_simulator.manoeuvring import BODY, COEFFICIENTS, manoeuvring_model
from problems.ship_simulator.sensors import InertialUnit, measure
from tests.support.shared import ROOT


def general_ship(rng: np.random.Generator) -> tuple[Ship, Load]:
    """No coefficient, distance or weight of it is zero, or one of its defaults."""

    def shifted(value: float) -> float:
        return value + float(rng.uniform(0.1, 0.5))

    c = Coefficients(
        **{f.name: shifted(getattr(Coefficients(), f.name)) for f in fields(Coefficients)}
    )
    body = Ship(
        M=shifted(22.0),
        zbar_g=0.1 * shifted(0.0),
        x_g=0.1 * shifted(0.0),
        y_g=0.1 * shifted(0.0),
        z_f=-0.1 * shifted(0.0),
        A_x=shifted(0.2),
        A_z=shifted(0.6),
        coefficients=c,
        arm=PolynomialArm(tuple(rng.uniform(0.05, 0.1, 3).tolist())),
    )
    return body, Load(shifted(0.0), -shifted(0.0), 0.1 * shifted(0.0))


def values_of(body: Ship, load: Load) -> dict[str, float]:
    """By the names of the model."""
    assert isinstance(body.arm, PolynomialArm)
    names = ("M", "zbar_g", "x_g", "y_g", "z_f", "A_x", "A_z", "g")
    torque = (body.M * body.g * c for c in body.arm.odd)
    return (
        asdict(body.coefficients)
        | {name: getattr(body, name) for name in names}
        | dict(zip(("k", "k_3", "k_5"), torque, strict=True))
        | asdict(load)
        | {"zbar_s": -0.2}
    )


# -- the model and the simulator, written apart ----------------------------------------------------


def test_the_model_has_the_right_hand_side_of_the_simulator():
    """u', v', p', r' and phi' at random points, with every term there: to rounding."""
    rng = np.random.default_rng(1)
    for _ in range(5):
        body, load = general_ship(rng)
        values = values_of(body, load)
        assert all(value != 0.0 for value in values.values())
        e = manoeuvring_model(values, {}).explicit()
        f = ca.Function("f", [e.x, e.u, e.p], [e.f])
        g, p = dynamics(body, load), [values[n] for n in e.parameters]
        assert e.states == ("u", "v", "p", "r", "phi")
        for _ in range(10):
            x = rng.standard_normal(5) * [1.0, 1.0, 1.0, 1.0, 0.4]
            u = rng.uniform([-0.5, 0.0], [0.5, 100.0])
            got = np.array(f(x, u, p)).ravel()
            all_states = [0.0, 0.0, x[4], 0.3, *x[:4]]
            rates = np.array(g(all_states, u, np.zeros(4), np.zeros(2))).ravel()
            expected = rates[[4, 5, 6, 7, 2]]
            size = np.abs(expected).max()  # what cancels in a sum is as large as that
            np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12 * size)


def test_the_model_reads_what_the_inertial_unit_reads():
    """A_s with its direct terms, and the yaw gyro whose axis points up."""
    body = replace(Ship(), x_g=0.01)
    load, Ts = LOAD_CASES["loaded"], 0.05
    steps = random_steps(5.0, angle=0.4, hold=0.7, seed=2, Ts=Ts)
    motion = simulate(steps, ship=body, load=load, start=Start(phi=0.2), Ts=Ts)
    record = measure(motion, InertialUnit().without_noise(), seed=1)
    values = values_of(body, load)
    model = manoeuvring_model(values, {})
    e = model.explicit()
    h = ca.Function("h", [e.x, e.u, e.p], [e.h])
    x = np.stack([motion[n] for n in e.states])
    u = np.stack([motion[n] for n in e.inputs])
    got = np.array(h(x, u, [values[n] for n in e.parameters]))
    for name, y in zip(e.outputs, got, strict=True):
        expected = motion["u"] if name == "speed" else record[name]
        np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12)


def test_every_name_has_a_unit_and_a_value():
    assert set(true_values()) == set(COEFFICIENTS) | set(BODY)
    assert set(COEFFICIENTS) == {f.name for f in fields(Coefficients)}
    unknown = {n for n, p in problem.model.parameters.items() if not p.is_known}
    assert unknown == set(SOUGHT) == set(problem.truth)
    for name, (start, lower, upper) in SOUGHT.items():
        assert lower < problem.truth[name] < upper
        assert abs(start - problem.truth[name]) > 0.2 * abs(problem.truth[name]), name


def test_the_files_beside_it_are_found_from_anywhere(tmp_path):
    """Loaded by its path, where the checkout is not on the path and `problems` no package."""
    (tmp_path / "casid").symlink_to(ROOT / "casid", target_is_directory=True)
    program = (
        "import sys, casid\n"
        "from pathlib import Path\n"
        f"p = casid.load_problem({str(ROOT / 'problems' / 'ship_4dof.py')!r})\n"
        "assert 'problems' not in sys.modules\n"
        "print(p.name, len(p.truth), len(p.examples()))"
    )
    run = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.stdout.split() == ["ship_4dof", "16", "3"], run.stderr


# -- the commands ----------------------------------------------------------------------------------


def test_the_example_is_the_same_every_time_and_has_every_channel():
    first, second = problem.examples(), problem.examples()
    for a, b in zip(first, second, strict=True):
        assert set(a.record.names) == {*problem.model.inputs, *problem.model.outputs}
        for channel in a.record.names:
            np.testing.assert_array_equal(a.record[channel], b.record[channel])
    other = problem.simulated(2)
    np.testing.assert_array_equal(other[0].record["delta"], first[0].record["delta"])
    assert np.any(other[0].record["gyro"] != first[0].record["gyro"])


@pytest.mark.slow
def test_the_example_leads_from_the_starts_to_the_truth():
    """All sixteen together: e' P^-1 e is chi-square of 16, over 39.3 once in a thousand.

    Residuals are the noise that was added: its rms value from 600 samples has a standard error of
    3 %, and 16 of 12 x 600 degrees of freedom went into the parameters.
    """
    estimate = casid.identify(problem, problem.examples())
    assert estimate.is_converged
    names = list(estimate.covariance_names)
    at = [names.index(name) for name in SOUGHT]
    P = np.asarray(estimate.covariance)[np.ix_(at, at)]
    e = np.array([estimate.parameter(n).value - problem.truth[n] for n in SOUGHT])
    assert e @ np.linalg.solve(P, e) < chi2.ppf(0.999, len(SOUGHT))
    for outputs in estimate.rmse.values():
        for output, rms in outputs.items():
            assert rms == pytest.approx(problem.noise[output], rel=0.12)


@pytest.mark.slow
def test_damping_in_yaw_that_was_left_out_is_found():
    """N_r|r| r|r| is the damping that grows with the rate squared: d_2 = -N_rr."""
    lacking = problem_of("N_ur", "A_z", N_rr=0.0)
    record = experiments(duration=12.0)[0].record
    found = casid.diagnose(
        lacking, [casid.Experiment(record, {}, "nominal")], starts=1, advise=False
    )
    assert found.verdict == "deficient"
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("quadratic_damping", "yaw")
    (d_2,) = cause.parameters
    assert d_2.std_error is not None
    assert abs(d_2.value + true_values()["N_rr"]) < 3.3 * d_2.std_error
