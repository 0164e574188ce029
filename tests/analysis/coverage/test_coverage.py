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
    # 4000 samples; those of the first-order noise count as 4000 (1 - 0.81) / (1 + 0.81).
    assert np.std(noise) == pytest.approx(0.2, rel=0.15)
    added = np.std(record["i"] - motion.inputs["i"])
    levels = dict(zip(CONDITIONS[2:5], motor.levels["i"], strict=True))
    assert added == pytest.approx(levels.get(condition, 0.0), rel=0.05)
    missing = np.mean(record.missing.get("w", np.zeros(1)))
    assert missing == pytest.approx(0.2 if condition == "gaps" else 0.0, abs=0.03)


def test_what_has_no_input_has_no_cell_with_a_noisy_one() -> None:
    names = [cell.name for cell in cells("")]
    assert len(names) == 27
    assert not [n for n in names if "roll decay: input" in n]
