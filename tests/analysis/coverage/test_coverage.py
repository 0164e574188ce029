"""The systems of the coverage study move as their models say, and their noise is as declared."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.coverage.study import CONDITIONS, Cell, cells
from analysis.coverage.systems import SYSTEMS, System
from casid.estimation.simulation.known_simulation import KnownSimulation


@pytest.mark.parametrize("system", SYSTEMS, ids=lambda s: s.name)
def test_the_model_with_the_true_values_moves_as_the_simulator(system: System) -> None:
    """To a hundredth of the noise of each output: what coverage measures is noise alone."""
    model, motion = system.model(), system.motion()
    values = model.nominal_values
    values |= dict(system.truth)
    u = np.column_stack([*motion.inputs.values(), np.zeros((len(_any(motion.outputs)), 0))])
    first = {"phi": 0.15} if system.name == "roll decay" else {}
    nodes = np.array([[first.get(n, 0.0) for n in model.states]])
    y, _ = KnownSimulation(model, motion.Ts, substeps=8).run(u, values, nodes)
    for i, (name, true) in enumerate(motion.outputs.items()):
        assert np.std(y[:, i] - true) < 0.01 * system.noise[name]


def _any(columns):
    return next(iter(columns.values()))


@pytest.mark.parametrize("condition", CONDITIONS)
def test_a_draw_has_the_noise_of_its_cell(condition: str) -> None:
    motor = next(s for s in SYSTEMS if s.name == "motor")
    record, motion = Cell(motor, condition).record(1), motor.motion()
    noise = record["w"] - motion.outputs["w"]
    if condition == "disturbance":
        # J w' = -d w + f: variance s^2 / (J^2 g (g + c)) with g = d/J and c the corner of f.
        g, push = 0.02 / 0.004, motor.push
        spread = np.hypot(0.2, push.size / 0.004 / np.sqrt(g * (g + push.corner)))
        # 40 s of a correlation time of about 1/3 + 1/5 s: 2 T / tau independent squares or so.
        assert np.std(noise) == pytest.approx(spread, rel=4 * np.sqrt(0.53 / 2 / 40))
        return
    # 4000 samples; those of the first-order noise count as 4000 (1 - 0.81) / (1 + 0.81).
    assert np.std(noise) == pytest.approx(0.2, rel=0.15)
    added = np.std(record["i"] - motion.inputs["i"])
    levels = dict(zip(CONDITIONS[2:5], motor.levels["i"], strict=True))
    assert added == pytest.approx(levels.get(condition, 0.0), rel=0.05)
    missing = np.mean(record.missing.get("w", np.zeros(1)))
    absent = {"gaps": 0.2, "two rates": 0.75}.get(condition, 0.0)
    assert missing == pytest.approx(absent, abs=0.03)


def test_what_has_no_input_has_no_cell_with_a_noisy_one() -> None:
    names = [cell.name for cell in cells("")]
    assert len(names) == 38
    assert not [n for n in names if "roll decay: input" in n]


def test_what_a_force_does_has_the_variance_of_its_lyapunov_equation() -> None:
    """The roll: f of first order drives an oscillator, from rest; over 40 draws at the end."""
    from scipy.linalg import solve_continuous_lyapunov

    roll = next(s for s in SYSTEMS if s.name == "roll decay").push
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[:2, 2], whole[2, 2] = roll.a, roll.e, -roll.corner
    white = np.diag([0.0, 0.0, 2 * roll.corner * roll.size**2])
    variance = solve_continuous_lyapunov(whole, -white)[0, 0]
    ends = [roll.response(3000, 0.05, np.random.default_rng(s))[-1, 0] for s in range(40)]
    # 150 s are nine time constants of the damping; 40 squares have a spread of sqrt(2 / 40).
    assert np.mean(np.square(ends)) == pytest.approx(variance, rel=3.5 * np.sqrt(2 / 40))
