"""The systems of the coverage study move as their models say, and their noise is as declared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analysis.coverage.bounds import bounds
from analysis.coverage.study import CONDITIONS, Cell, Drawn, cells, efficient
from analysis.coverage.systems import SYSTEMS, System
from casid.campaigns.accuracy import accuracy_of
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

    system = next(s for s in SYSTEMS if s.name == "roll decay")
    roll, of = system.push, system.plant.matrices(system.truth)
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[:2, 2], whole[2, 2] = of.a, of.e, -roll.corner
    white = np.diag([0.0, 0.0, 2 * roll.corner * roll.size**2])
    variance = solve_continuous_lyapunov(whole, -white)[0, 0]
    ends = [roll.response(of, 3000, 0.05, np.random.default_rng(s))[-1, 0] for s in range(40)]
    # 150 s are nine time constants of the damping; 40 squares have a spread of sqrt(2 / 40).
    assert np.mean(np.square(ends)) == pytest.approx(variance, rel=3.5 * np.sqrt(2 / 40))


def _bounds(name: str, condition: str, *, gaps: bool = False) -> dict[str, float]:
    system = next(s for s in SYSTEMS if s.name == name)
    ny, N = len(system.noise), len(system.plant.u)
    absent = gaps & (np.arange(N * ny).reshape(N, ny) % 5 == 0)
    return bounds(system, condition, absent)


def test_the_bound_of_a_slow_decay_in_white_noise_is_that_of_its_frequency_and_damping() -> None:
    """A sinusoid a e^(-z t) cos(w t + p) with z T of order one, by its own four derivatives.

    y'' = -B y' - C y has z = B/2 and w^2 = C - z^2; amplitude and phase are the initial state.
    """
    B, C = 0.06, 6.06
    z = B / 2
    t, w = 0.05 * np.arange(1200), np.sqrt(C - z**2)
    a, p = 0.15 * np.hypot(1.0, z / w), -np.arctan(z / w)
    envelope, angle = a * np.exp(-z * t), w * t + p
    by_z, by_w = -t * envelope * np.cos(angle), -t * envelope * np.sin(angle)
    columns = [
        0.5 * by_z - z / (2 * w) * by_w,  # B moves z and w
        by_w / (2 * w),  # C
        envelope * np.cos(angle),
        envelope * np.sin(angle),
    ]
    T = np.column_stack(columns) / 0.005
    least = np.sqrt(np.diag(np.linalg.inv(T.T @ T)))
    assert list(_bounds("roll decay", "white").values()) == pytest.approx(least[:2], rel=1e-4)


def test_a_fifth_of_the_samples_missing_costs_a_tenth_of_the_certainty() -> None:
    whole, gaps = (_bounds("motor", "white", gaps=gaps) for gaps in (False, True))
    for name, least in whole.items():
        assert gaps[name] == pytest.approx(least / np.sqrt(0.8), rel=0.02)


def test_slow_noise_costs_what_its_spectrum_says() -> None:
    """Noise of unit variance with a pole of 0.9 has (1 + a)/(1 - a) = 19 times the power at zero.

    Steps that last 80 samples are slow, but their ramps are not: the bound is a little lower.
    """
    white, slow = (_bounds("motor", condition) for condition in ("white", "coloured"))
    for name, least in white.items():
        assert 0.8 * np.sqrt(19) < slow[name] / least < np.sqrt(19)


@pytest.mark.slow
def test_a_force_of_no_size_costs_nothing() -> None:
    system = next(s for s in SYSTEMS if s.name == "motor")
    without = replace(system, push=replace(system.push, size=1e-6 * system.push.size))
    here = np.zeros((4000, 1), dtype=bool)
    found = [bounds(s, c, here) for s, c in ((without, "disturbance"), (system, "white"))]
    assert list(found[0].values()) == pytest.approx(list(found[1].values()), rel=1e-3)
    assert all(bounds(system, "disturbance", here)[n] > 2 * found[1][n] for n in found[1])


def test_the_error_of_a_fit_that_is_no_worse_than_the_bound_meets_the_target() -> None:
    rng = np.random.default_rng(4)
    values = 2.0 + 0.1 * rng.standard_normal(400)
    found = accuracy_of("k", "", 2.0, values, np.full(400, 0.1), (values - 0.2, values + 0.2))
    drawn = Drawn([found], 0.0, 0)
    assert efficient("cell", drawn, {"k": 0.1}).is_met
    assert not efficient("cell", drawn, {"k": 0.07}).is_met
