"""Black boxes in place of a measured input: what they are made of, and what they may get wrong."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from analysis.ship_algorithm.records import NONE, linear_experiments, low_passed
from casid.errors import DataError, ModelError
from casid.estimation.moments.instruments.black_box_reference import (
    black_box_instruments,
    black_box_references,
)
from casid.estimation.moments.instruments.instruments import Instruments, Loop, from_channels
from casid.estimation.moments.instruments.reference_filter import ReferenceFilter, SampledFilter
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.identification.moment_estimators import instrumental_variables
from problems.ship import TABLE_8_2, indirect_model, problem

V = TABLE_8_2
CHANNELS = ("gyro", "accel", "r")
TS = 0.02


def at_bilinear(w):
    """s of the bilinear transform at frequencies w."""
    z = np.exp(1j * w * TS)
    return 2 / TS * (z - 1) / (z + 1), z


@pytest.mark.parametrize("m", [0.0, 0.4])
def test_the_simulated_loop_is_the_corrected_8_85_and_8_86(m):
    """Ghat_dy = G0 [(F_r - U) G_dr + F_d], Ghat_das with F_y in its first term and + U G_dr.

    The discretised direct model, driven by r_hat and delta with v' = 0, against the formulas of
    the indirect loop at the image of every frequency; as printed, (8.86) is another function.
    """
    values = {**V, "m": m}
    S = V["M"] * (V["zbar_g"] + V["z_f"]) + m * (V["zbar_m"] + V["z_f"])
    z_s, z_g, z_m = (V[n] + V["z_f"] for n in ("zbar_s", "zbar_g", "zbar_m"))
    A_2 = V["A_x"] + V["M"] * z_g * (z_g - z_s) + m * z_m * (z_m - z_s) - V["K_vdot"] * z_s
    alpha1, alpha2 = V["d"] / A_2, (V["k"] - V["K_vdot"] * V["g"]) / A_2
    beta1, kappa1 = -(V["K_vdot"] + S) / A_2, V["K_r"] / A_2
    gamma1 = V["K_delta"] / A_2
    s, z = at_bilinear(np.linspace(0.2, 100.0, 80))
    G = beta1 * s / (s**2 + alpha1 * s + alpha2)
    F_y, F_r, F_d = (z_s * s**2 + V["g"]) / s, kappa1 / beta1, gamma1 / beta1
    G_dr = 0.3 / (1.0 - 0.97 / z)  # any black box
    wanted = {
        "gyro": G / (1 - F_y * G) * ((F_r - V["U"]) * G_dr + F_d),
        "accel": (F_y * G * (F_d + F_r * G_dr) - V["U"] * G_dr) / (1 - F_y * G),
    }
    den, num = Loop(indirect_model(), TS).coefficients(values)
    powers = z[:, None] ** -np.arange(len(den))
    for channel, expected in wanted.items():
        of_r, of_delta = (powers @ num[channel][u] / (powers @ den) for u in ("r", "delta"))
        np.testing.assert_allclose(of_r * G_dr + of_delta, expected, rtol=1e-7)
    printed = (G * (F_d + F_r * G_dr) - V["U"] * G_dr) / (1 - F_y * G)
    assert np.max(np.abs(printed / wanted["accel"] - 1)) > 0.1


@pytest.mark.parametrize("structure", ["arx", "oe"])
def test_a_black_box_of_the_true_orders_is_the_true_transfer_function(structure):
    """y = B/A u + a bias, with hardly any noise: the coefficients, and no trace of the bias."""
    rng = np.random.default_rng(2)
    u, y = np.sign(rng.normal(size=3000)) + 0.3, np.zeros(3000)
    for t in range(2, 3000):
        y[t] = 1.5 * y[t - 1] - 0.7 * y[t - 2] + 0.5 * u[t] + 0.2 * u[t - 1]
    measured = y + 4.0 + 1e-6 * rng.normal(size=3000)
    record = casid.Record({"u": u, "y": measured}, {"u": "rad", "y": "m"}, Ts=0.1, name="bench")
    e = casid.Experiment(record, {}, "bench")
    found = black_box_references(e, "u", ["y"], structure=structure, na=2, nb=2)
    own = found.filters["bench"]["y"]
    np.testing.assert_allclose(own.a, [1.0, -1.5, 0.7], atol=1e-4)
    np.testing.assert_allclose(own.b, [0.5, 0.2], atol=1e-4)
    assert own.fit > 95.0  # from rest, which the record was not at
    assert found.experiments[0].record.units["y from u"] == "m"


def test_fewer_poles_are_fitted_where_the_record_tells_no_more():
    """Without noise the regressors of 4 poles are dependent for the ship, nearly or exactly."""
    experiments = linear_experiments(1, duration=60.0, disturbance=NONE)
    found = black_box_references(experiments, "delta", ["r"])
    assert all("were fitted" in note for note in found.notes)
    assert all(len(own["r"].a) < 5 for own in found.filters.values())
    assert all(np.all(np.abs(np.roots(own["r"].a)) < 1) for own in found.filters.values())


def test_what_a_black_box_makes_of_the_reference_holds_none_of_the_noise():
    """The same rudder, other noise: channels from delta differ by their coefficients alone."""
    e = linear_experiments(1, duration=60.0)[0]
    found = black_box_references(e, "delta", ["r"])
    own = found.filters["nominal"]["r"]
    delta = e.record["delta"] - e.record["delta"].mean()
    np.testing.assert_array_equal(
        found.experiments[0].record["r from delta"], own.apply(delta, e.record.Ts)
    )
    assert np.all(np.abs(np.roots(own.a)) < 1.0)


def estimates(instruments_of, seeds):
    model = problem.model
    settings = MomentSettings(iterations=2)
    out = []
    for seed in seeds:
        experiments = low_passed(linear_experiments(seed))
        found = black_box_references(experiments, "delta", CHANNELS)
        instruments = black_box_instruments(model, found, n_y=2, n_u=2)
        e = instrumental_variables(
            model, found.experiments, instruments_of(instruments), settings=settings
        )
        out.append([[e[n], e.std_error(n)] for n in ("m", "zbar_m", "k", "d")])
    return np.array(out)


@pytest.mark.slow
def test_a_wrong_black_box_costs_variance_and_not_consistency():
    """r_hat = a lag of the rudder that has nothing to do with the ship, 4 draws.

    Linder (2017), section 5.1. The standard errors grow, and estimates stay within 3.5 of them of
    the truth: 16 normal numbers leave that once in 130 times.
    """

    def wrong(right):
        filters = {**right.F_delta, "r": ReferenceFilter.lag(3.0, gain=-0.2)}
        return Instruments(
            {**right.reference, "r": "delta"},
            filters,
            n_delta=right.n_delta,
            n_y=right.n_y,
            n_u=right.n_u,
        )

    seeds = range(20, 24)
    truth = np.array([V[n] for n in ("m", "zbar_m", "k", "d")])
    right, other = estimates(lambda i: i, seeds), estimates(wrong, seeds)
    assert np.max(np.abs(right[..., 0] - truth) / right[..., 1]) < 3.5
    assert np.max(np.abs(other[..., 0] - truth) / other[..., 1]) < 3.5
    assert np.median(other[..., 1] / right[..., 1]) > 1.0


def test_an_input_that_nothing_drives_gives_no_instruments():
    """F_delta = 0 for v': no column of it, and none that repeats the others."""
    loop = Loop(indirect_model(), TS)
    rng = np.random.default_rng(3)
    drives = {"vdot": np.zeros(4000), "r": rng.normal(size=4000), "delta": rng.normal(size=4000)}
    values = {**V, "m": 0.0}
    made = loop.instruments(drives, values, Instruments("delta"), ["gyro"])
    assert set(made.signals) == {"w[r]", "w[delta]"}
    assert all("w[vdot]" not in {c for c, _, _ in column.taps} for column in made.columns)
    silent = ReferenceFilter.nothing().apply(drives["delta"], TS)
    np.testing.assert_array_equal(silent, 0.0)


def test_an_unstable_black_box_is_reflected_and_said():
    """A channel that grows by itself: poles outside the circle make no instrument."""
    rng = np.random.default_rng(5)
    u, y = rng.normal(size=400), np.zeros(400)
    for t in range(1, 400):
        y[t] = 1.01 * y[t - 1] + u[t - 1] + 0.1 * rng.normal()
    units = {"u": "rad", "y": "rad"}
    record = casid.Record({"u": u, "y": y}, units, Ts=0.1, name="growing")
    found = black_box_references(casid.Experiment(record, {}, "growing"), "u", ["y"], na=1, nb=1)
    own = found.filters["growing"]["y"]
    assert isinstance(own, SampledFilter)
    assert abs(own.a[1]) < 1.0
    assert "reflected" in found.notes[0]


def test_what_is_missing_is_refused_with_the_mend():
    e = linear_experiments(1, duration=20.0)[0]
    with pytest.raises(DataError, match="no channel 'rudder'"):
        black_box_references(e, "rudder", ["r"])
    with pytest.raises(ModelError, match="name the channels"):
        black_box_references(e, "delta", ["delta"])
    resting = casid.Experiment(
        e.record.with_channel("still", np.zeros(e.record.N), "rad"), e.known, e.name
    )
    with pytest.raises(DataError, match="never moves"):
        black_box_references(resting, "still", ["r"])
    found = black_box_references(e, "delta", ["gyro"])
    with pytest.raises(ModelError, match=r"black_box_references\(channels=\['r'"):
        black_box_instruments(indirect_model(), found)
    with pytest.raises(ModelError, match="give both"):
        Instruments("delta", initial="channels")
    with pytest.raises(DataError, match="Simulate it from the reference"):
        from_channels({"delta": np.zeros(3)}, {"r from delta": 4}, "nominal")
