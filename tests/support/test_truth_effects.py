"""Effects that no catalogue has, and effects of the accelerometer, checked against their laws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from tests.support.truth import Z_G, M, TruthRecord, cart_pendulum
from tests.support.truth_effects import MODE_DAMPING, STRANGE, YIELD_ANGLE


def left_over(record: TruthRecord) -> np.ndarray:
    """Torque that the indirect model (7.24) does not explain, (N,)."""
    c, p = record.clean, record.truth
    S = M * Z_G
    I_2 = p["I_x"] + M * Z_G**2 - p["z_s"] * S
    return I_2 * c["phidd"] + p["k"] * c["phi"] + p["d"] * c["phid"] + S * c["accel"]


@pytest.mark.parametrize("kind", sorted(STRANGE | {"missing_mode", "cross_axis"}))
def test_the_strength_asked_for_is_the_strength_measured(kind: str) -> None:
    """The search stops at 1 %, its coarser steps add some tenths of a percent."""
    record = cart_pendulum(kind, 0.7, seed=5, duration=20.0)
    assert record.strength == pytest.approx(0.7, rel=0.02)


@pytest.mark.parametrize(
    ("kind", "where"),
    [("sensor_bias", "accel"), ("sensor_scale", "accel"), ("sensor_scale", None), ("offset", None)],
)
def test_a_gain_an_input_bias_and_a_torque_offset_leave_nothing(
    kind: str, where: str | None
) -> None:
    """Absorbed by s/I and the initial angle: what is left is the refit's own interpolation."""
    assert cart_pendulum(kind, size=0.1, seed=5, duration=20.0, where=where).strength < 1e-3


@pytest.mark.slow
def test_a_part_that_swings_along_follows_its_own_equation() -> None:
    """q'' = -2 zeta w q' - w^2 q - phi'', and J (w^2 q + 2 zeta w q') is what is left over."""
    record = cart_pendulum("missing_mode", size=0.005, seed=4, duration=60.0)
    t, p = record.columns["t"], record.truth
    w, J = 2 * np.pi * p["frequency"], p["size"]
    a = CubicSpline(t, record.clean["phidd"])

    def slope(s: float, z: np.ndarray) -> list[float]:
        return [z[1], -2 * MODE_DAMPING * w * z[1] - w * w * z[0] - float(a(s))]

    z = solve_ivp(slope, (0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=0.01).y
    torque = J * (w * w * z[0] + 2 * MODE_DAMPING * w * z[1])
    # The free motion of a start that is not at rest has decayed to exp(-5) < 0.01.
    settled = t > 5.0 / (MODE_DAMPING * w)
    assert settled.sum() > 1000
    error = left_over(record)[settled] - torque[settled]
    assert np.std(error) < 0.02 * np.std(torque[settled])


def test_hysteresis_follows_boucs_and_wens_law() -> None:
    """z' = (v - |v| z) / x_y from the motion itself; |z| stays below one."""
    record = cart_pendulum("hysteresis", size=0.05, seed=4, duration=20.0)
    z = -left_over(record) / record.truth["size"]
    v = record.clean["phid"]
    rate = (v - np.abs(v) * z) / YIELD_ANGLE
    steps = np.diff(z) - 0.5 * np.diff(record.columns["t"]) * (rate[1:] + rate[:-1])
    assert np.abs(z).max() < 1.0
    assert np.std(steps) < 0.02 * np.std(np.diff(z))  # of the trapezoidal rule, h v / x_y near 0.2


def test_a_knock_is_one_half_sine() -> None:
    record = cart_pendulum("knock", size=0.3, seed=2, duration=20.0)
    t, left = record.columns["t"], left_over(record)
    inside = (t > record.truth["t_jump"] + 0.01) & (t < record.truth["t_jump"] + 0.19)
    expected = 0.3 * np.sin(np.pi * (t[inside] - record.truth["t_jump"]) / 0.2)
    sign = np.sign(left[inside].sum())
    np.testing.assert_allclose(left[inside], sign * expected, atol=1e-9)
    outside = (t < record.truth["t_jump"] - 0.01) | (t > record.truth["t_jump"] + 0.21)
    np.testing.assert_allclose(left[outside], 0.0, atol=1e-9)


def test_the_accelerometer_may_be_late_and_slow() -> None:
    true = cart_pendulum("none", seed=3, duration=20.0)
    late = cart_pendulum("time_delay", size=0.03, seed=3, duration=20.0, where="accel")
    np.testing.assert_allclose(late.quiet["accel"][3:], true.quiet["accel"][:-3], atol=1e-9)
    slow = cart_pendulum("sensor_lag", size=0.05, seed=3, duration=20.0, where="accel")
    e = np.exp(-0.01 / 0.05)
    slope = 1 - 0.05 / 0.01 * (1 - e)
    filtered = lfilter([slope, 1 - e - slope], [1, -e], true.quiet["accel"])
    # Straight lines over 10 ms in place of 2 ms: a few thousandths of the signal.
    scale = np.std(true.quiet["accel"])
    np.testing.assert_allclose(slow.quiet["accel"][50:], filtered[50:], atol=0.02 * scale)
    np.testing.assert_array_equal(late.quiet["gyro"], true.quiet["gyro"])


def test_what_is_measured_without_noise_is_what_is_measured_less_noise() -> None:
    """Both channels of one seed differ from their quiet ones by the same noise, whatever acts."""
    none = cart_pendulum("none", seed=8, duration=10.0)
    both = cart_pendulum("sensor_bias", 0.5, seed=8, duration=10.0, second=("knock", 0.5))
    for name in ("gyro", "accel"):
        np.testing.assert_allclose(
            both.columns[name] - both.quiet[name], none.columns[name] - none.quiet[name], atol=1e-12
        )
    first, other = both.alone
    shift = first["gyro"] - none.quiet["gyro"]
    np.testing.assert_allclose(shift, both.truth["size"], atol=1e-12)
    np.testing.assert_array_equal(first["accel"], none.quiet["accel"])
    np.testing.assert_allclose(both.quiet["gyro"] - other["gyro"], both.truth["size"], atol=1e-12)


def test_an_effect_that_the_accelerometer_cannot_have_is_refused() -> None:
    with pytest.raises(ValueError, match="only sensor_bias, time_delay, sensor_lag, sensor_scale"):
        cart_pendulum("outliers", 1.0, where="accel")
