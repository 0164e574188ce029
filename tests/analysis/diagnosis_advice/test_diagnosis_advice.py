"""The study of the advice: its simulator is right, and its two numbers are of one thing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim

from analysis.diagnosis_advice import records as diagnosis_advice_records
from analysis.diagnosis_advice import study as diagnosis_advice
from analysis.diagnosis_advice.records import CONSTANTS, Cause


def test_the_simulator_gives_the_linear_pendulum_s_response():
    """(7.10) and (7.13)-(7.14), against the exact response to straight lines between half steps."""
    drive = diagnosis_advice_records.multisine(4.0, 1, [(0.2, 2.0)], rms=1.0)
    (made,) = diagnosis_advice_records.simulate(
        drive, [Cause("none", "", 0.0)], jump_at=2.0, width=0.02
    )
    S = CONSTANTS["M"] * CONSTANTS["z_g"]
    inertia = diagnosis_advice_records.I_X + CONSTANTS["M"] * CONSTANTS["z_g"] ** 2
    k = diagnosis_advice_records.K + S * CONSTANTS["g"]
    A = np.array([[0.0, 1.0], [-k / inertia, -diagnosis_advice_records.D / inertia]])
    B = np.array([[0.0], [S / inertia]])
    t = drive.t - drive.t[0]
    _, _, x = lsim((A, B, np.eye(2), np.zeros((2, 1))), drive.a_y, t)
    phi, p = x[drive.samples].T
    p_dot = A[1, 0] * phi + A[1, 1] * p + B[1, 0] * made["a_y"]
    accel = CONSTANTS["z_s"] * p_dot + CONSTANTS["g"] * phi - made["a_y"]
    # Lines between half steps of 2.5 ms: (w h)^2 / 12 = 8e-5 at 2 Hz.
    np.testing.assert_allclose(made["gyro"], p, atol=1e-4 * np.std(p) * 10)
    np.testing.assert_allclose(made["accel"], accel, atol=1e-3 * np.std(accel))


@pytest.mark.slow
def test_the_right_cause_wins_well_above_the_predicted_energy_and_not_well_below():
    """With x^2 = (1 - c^2) lambda, D has mean x^2 and sd 2 x, and must exceed 6.

    At a fifth of the energy needed x = 2.05: D exceeds 6 in one of four records. At five times
    it x = 10.3, and six standard deviations are between D and the margin.
    """
    setting = diagnosis_advice.setting_of(diagnosis_advice_records.telegraph(15.0, 1))
    a, b = diagnosis_advice.QUADRATIC, diagnosis_advice.CUBIC
    sizes = np.sqrt(np.array([0.2, 5.0]) * setting.predicted(a, b) / setting.energy(a))
    few, many = diagnosis_advice_records.simulate(
        setting.drive, [Cause(*a, s) for s in sizes], jump_at=7.0, width=0.02
    )
    rng = np.random.default_rng(2)
    won = []
    for clean, size in ((few, sizes[0]), (many, sizes[1])):
        duel = diagnosis_advice.Duel(setting, a, b, float(size))
        noisy = [diagnosis_advice_records.with_noise(clean, rng) for _ in range(4)]
        won.append([duel.difference(n) > setting.margin(a, b) for n in noisy])
    assert sum(won[0]) < 4  # all four win in 0.4 % of draws
    assert all(won[1])


def test_a_delayed_gyro_is_its_past():
    drive = diagnosis_advice_records.multisine(4.0, 1, [(0.2, 2.0)], rms=1.0)
    plain, late = diagnosis_advice_records.simulate(
        drive, [Cause("time_delay", "gyro", 0.0), Cause("time_delay", "gyro", 0.02)],
        jump_at=2.0, width=0.02,
    )  # fmt: skip
    np.testing.assert_allclose(late["gyro"][1:], plain["gyro"][:-1], atol=1e-9)
