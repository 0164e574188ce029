"""The bias that a discretisation gives to parameters, in the limit of infinitely many samples."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from casid.errors import IdentifiabilityError, ModelError
from casid.linear.linear_model import linearise
from casid.linear.sampled.difference_equation import difference_equation
from casid.linear.sampled.discretisation import discretise
from casid.linear.sampled.discretisation_bias import bias_table
from casid.linear.sampled.inverse_map import invert
from tests.support.linear_models import NOMINAL, Z_G, Z_S, M, indirect, spring_chain

FREE = ("I_x", "k", "d")
I_2 = 0.1385 + M * Z_G * (Z_G - Z_S)


def column(table, name):
    return {(row.method, row.Ts): row.bias[name] for row in table.rows}


@pytest.mark.parametrize("truth", ["zoh", "foh"])
def test_the_exact_hold_of_the_truth_has_no_bias(truth):
    table = bias_table(indirect(), [0.04, 0.01], FREE, NOMINAL, truth=truth, methods=[truth])
    for row in table.rows:
        assert max(abs(b) for b in row.bias.values()) < 1e-10


def test_the_bilinear_bias_falls_with_the_square_of_the_sample_time():
    """Between straight-line inputs; each halving of Ts divides it by 4, up to O(Ts^2)."""
    table = bias_table(indirect(), [0.02, 0.01, 0.005], FREE, NOMINAL, methods=["bilinear"])
    for name in ("I_x", "d"):
        b = column(table, name)
        assert b["bilinear", 0.02] / b["bilinear", 0.01] == pytest.approx(4.0, rel=0.02)
        assert b["bilinear", 0.01] / b["bilinear", 0.005] == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize("method", ["forward", "backward"])
def test_the_euler_bias_falls_with_the_sample_time(method):
    """First order in the damping, and forward and backward with opposite signs."""
    table = bias_table(indirect(), [0.005, 0.0025], FREE, NOMINAL, methods=[method])
    b = column(table, "d")
    assert b[method, 0.005] / b[method, 0.0025] == pytest.approx(2.0, rel=0.02)
    assert np.sign(b[method, 0.005]) == (1 if method == "forward" else -1)


@pytest.mark.parametrize("T", [0.02, 0.01, 0.005])
def test_the_bilinear_frequency_is_too_high_by_one_twelfth_of_wt_squared(T):
    """Trap T-6. The pole s goes to (2/T) tanh(s T/2) = s (1 - (s T)^2/12 + ...), s = j w.

    Relative error of the natural frequency (w T)^2/12, w^2 = k/I_2; next term (w T)^4/120.
    """
    (row,) = bias_table(indirect(), [T], FREE, NOMINAL, methods=["bilinear"]).rows
    k = 10.39 * (1 + row.bias["k"])
    inertia = I_2 + 0.1385 * row.bias["I_x"]
    w = np.sqrt(10.39 / I_2)
    stretch = np.sqrt(k / inertia) / w - 1
    assert row.scale == pytest.approx((w * T) ** 2 / 12)
    # The damped pole differs from j w by zeta = 0.07, zeta^2 = 0.5 % of the effect.
    assert stretch == pytest.approx(row.scale, rel=0.02 + (w * T) ** 2)
    # It all goes into the inertia: k is the static gain, which the bilinear transform keeps.
    assert abs(row.bias["k"]) < 1e-7
    assert 0.1385 * row.bias["I_x"] == pytest.approx(-10.39 * T**2 / 6, rel=0.02)


def test_the_limit_is_what_many_samples_give():
    """A million noise-free samples of the held system, white input: the same estimate.

    Statistical error of moments 1e-3 of the bias itself (the fit is exact for zero bias).
    """
    T, N = 0.04, 1_000_000
    model = linearise(indirect())
    a, b = discretise(model, T, "foh").evaluate(NOMINAL)
    u = np.random.default_rng(6).standard_normal(N)
    y = scipy.signal.lfilter(b[0][0], a, u)
    e = difference_equation(model, "gyro", T)
    signals = {"gyro": y[1000:], "accel": u[1000:]}
    Phi = np.stack([c.samples(signals, e.order) for c in e.columns], axis=1)
    theta, *_ = np.linalg.lstsq(Phi, e.left.samples(signals, e.order), rcond=None)
    sampled, _ = invert(e, theta, NOMINAL, FREE)
    table = bias_table(
        indirect(), [T], FREE, NOMINAL, methods=["bilinear"], spectrum=lambda w: np.ones_like(w)
    )
    true = np.array([NOMINAL[n] for n in FREE])
    limit = [table.rows[0].bias[n] for n in FREE]
    np.testing.assert_allclose(sampled / true - 1, limit, rtol=0.05, atol=2e-3)


def test_a_spectrum_weights_the_frequencies():
    """Excited below 2 rad/s only, the stiffness is right to (2 T)^2 while all-band fits are not."""

    def low(w):
        return (w < 2.0).astype(float)

    narrow = bias_table(
        indirect(), [0.01], FREE, NOMINAL, methods=["backward"], spectrum=low, points=20_000
    )
    wide = bias_table(indirect(), [0.01], FREE, NOMINAL, methods=["backward"])
    assert abs(narrow.rows[0].bias["k"]) < 0.01 * abs(wide.rows[0].bias["k"])


def test_two_outputs_must_be_told_apart():
    with pytest.raises(ModelError, match="has outputs q, v; choose one"):
        bias_table(spring_chain(1), [0.1], ("k0",), {"k0": 1.0, "d0": 0.1, "m0": 1.0})


def test_an_unknown_truth_is_refused_with_the_nearest():
    with pytest.raises(ModelError, match="did you mean 'foh'"):
        bias_table(indirect(), [0.1], FREE, NOMINAL, truth="fo")


def test_a_single_line_determines_too_little():
    """One frequency gives two equations for three coefficients."""

    def line(w):
        return (np.abs(w - 5.0) == np.abs(w - 5.0).min()).astype(float)

    with pytest.raises(IdentifiabilityError, match="does not determine a1, a2, b0"):
        bias_table(indirect(), [0.01], FREE, NOMINAL, methods=["bilinear"], spectrum=line)


def test_the_table_is_printed_with_a_line_for_each_case():
    table = bias_table(indirect(), [0.02, 0.01], FREE, NOMINAL)
    lines = str(table).splitlines()
    assert len(lines) == 2 + 2 * 5
    assert "(w T)^2/12" in lines[1]
    assert "bilinear" in lines[2]


def test_single_values_need_no_lists():
    one = bias_table(indirect(), 0.01, "d", NOMINAL, methods="bilinear")
    listed = bias_table(indirect(), [0.01], ["d"], NOMINAL, methods=["bilinear"])
    assert [row.bias for row in one.rows] == [row.bias for row in listed.rows]
    assert str(one) == str(listed)


@pytest.mark.parametrize("Ts", ["0.01", ["0.01"], None, -0.01])
def test_a_sample_time_is_a_positive_number(Ts):
    with pytest.raises(ModelError, match="the sample time is .*give a positive number of seconds"):
        bias_table(indirect(), Ts, FREE, NOMINAL)
    if not isinstance(Ts, list):
        with pytest.raises(ModelError, match="the sample time is .*, as 0.01"):
            difference_equation(indirect(), "gyro", Ts)
    assert difference_equation(indirect(), "gyro", np.float64(0.01)).Ts == 0.01
