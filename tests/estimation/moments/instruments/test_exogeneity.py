"""Whether a reference depends on outputs: the size under the null, the power in a closed loop."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.errors import DataError
from casid.estimation.moments.instruments.exogeneity import reference_depends_on
from casid.estimation.moments.instruments.relay_reversals import reversals, switching_p_value
from problems import kvlcc2_zigzag


def record(**channels):
    return casid.Record(channels, {n: "1" for n in channels}, 1.0)


def plant(rng, *, feedback=0.0, kind="autoregression", N=300):
    """y = 0.5 q^-1/(1 - 1.5 q^-1 + 0.7 q^-2) d + noise of the same poles; d of its own, or fed."""
    d, y = np.zeros(N), np.zeros(N)
    w, e = rng.standard_normal((2, N))
    for k in range(2, N):
        y[k] = 1.5 * y[k - 1] - 0.7 * y[k - 2] + 0.5 * d[k - 1] + w[k]
        if kind == "autoregression":
            d[k] = 0.8 * d[k - 1] + e[k] - feedback * y[k - 1]
        elif kind == "steps":  # few and large: it holds for 25 samples in the mean
            d[k] = 5 * e[k] if rng.random() < 0.04 else d[k - 1]
    return record(d=d, y=y)


def share_below(level, runs, draw, **options):
    rng = np.random.default_rng(11)
    p = [reference_depends_on(draw(rng), "d", ["y"], **options).p_value for _ in range(runs)]
    return float(np.mean(np.array(p) <= level))


def binomial(level, runs):
    """Four standard deviations of a share."""
    return 4 * np.sqrt(level * (1 - level) / runs)


# -- regression ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["autoregression", "steps"])
@pytest.mark.parametrize("level", [0.05, pytest.param(0.3, marks=pytest.mark.slow)])
def test_an_external_reference_is_accused_as_often_as_the_level_says(kind, level):
    """The p-value is uniform under the null, although the outputs follow the reference.

    Steps have innovations of kurtosis 75: their F statistic is far from Fisher's. With 99 draws
    the p-value is a multiple of 1/100, so that P(p <= level) is the level.
    """
    runs = 200
    found = share_below(
        level, runs, lambda rng: plant(rng, kind=kind), method="regression", draws=99
    )
    assert abs(found - level) < binomial(level, runs)


def test_feedback_is_found():
    """d = 0.8 d + e - 0.1 y: the share of var(e) that y explains is 0.01 var(y), about a tenth."""
    found = share_below(0.05, 40, lambda rng: plant(rng, feedback=0.1), draws=99)
    assert found > 0.9


def test_the_output_that_is_fed_back_is_named_and_another_is_not():
    rng = np.random.default_rng(2)
    fed = plant(rng, feedback=0.1, N=800)
    r = record(d=fed["d"], y=fed["y"], other=rng.standard_normal(800))
    found = reference_depends_on(r, "d", ["other", "y"])
    assert found.depends
    assert found.culprits == ("y",)
    assert "fed back from y" in found.claim
    assert "Consistency is not to be claimed" in str(found)


def test_units_of_the_channels_do_not_matter():
    r = plant(np.random.default_rng(3), feedback=0.05)
    scaled = record(d=1e6 * r["d"] + 3.0, y=1e-9 * r["y"] - 5e-9)
    first, second = (reference_depends_on(x, "d", ["y"], draws=199) for x in (r, scaled))
    assert second.p_value == pytest.approx(first.p_value, abs=0.01)
    assert second.lags == first.lags


def test_a_reference_that_its_own_past_tells_leaves_nothing_to_test():
    """A sine obeys d(k) = 2 cos(w) d(k-1) - d(k-2)."""
    k = np.arange(300)
    r = record(d=np.sin(0.3 * k), y=np.cos(0.3 * k) + np.random.default_rng(0).standard_normal(300))
    found = reference_depends_on(r, "d", ["y"], method="regression")
    assert found.p_value == 1.0
    assert not found.depends
    assert "nothing to test" in found.note


# -- switching -------------------------------------------------------------------------------------


def test_reversals_of_a_square_wave_are_where_they_are():
    """Levels held for 40, 30 and 50 samples; the first, without a known beginning, is left out."""
    d = np.repeat([1.0, -1.0, 1.0, -1.0, 1.0], [40, 30, 50, 20, 60])
    found = reversals(d)
    np.testing.assert_array_equal(found.start, [69, 119, 139])
    np.testing.assert_array_equal(found.side, [-1.0, 1.0, -1.0])
    np.testing.assert_array_equal(found.hold, [29.0, 49.0, 19.0])
    assert found.standing == 1.0


def test_the_p_value_of_three_reversals_is_one_over_one_plus_f():
    """Fisher's F with 2 and 2 degrees has P(F > f) = 1/(1 + f)."""
    d = np.repeat([1.0, -1.0, 1.0, -1.0, 1.0], [40, 30, 50, 20, 60])
    found = reversals(d)
    y, c, slope = np.zeros(len(d)), 0.17, 0.02
    misses = np.array([-1.0, 3.0, 0.5])  # samples by which the threshold was passed
    for start, side, late in zip(found.start, found.side, misses, strict=True):
        k = np.arange(start - 5, start + 6)
        y[k] = side * (c + slope * (k - start + late))
    p, threshold = switching_p_value(found, y, span=3)
    assert threshold == pytest.approx(c + slope * misses.mean())
    f = (np.var(found.hold, ddof=1) + 1 / 12) / (np.var(misses, ddof=1) + 1 / 12)
    assert p == pytest.approx(1 / (1 + f), rel=1e-9)


def clocked(rng, hold, n=5):
    """A heading under a rudder that reverses by a clock: psi' = r, 20 r' = 0.05 d - r, gusts."""
    holds = np.maximum(np.rint([hold(rng) for _ in range(n + 2)]), 3).astype(int)
    d = np.concatenate([np.zeros(10), *[np.full(h, (-1.0) ** i) for i, h in enumerate(holds)]])
    r, psi, gust = 0.0, np.zeros(len(d)), 0.0
    for k in range(1, len(d)):
        gust = 0.98 * gust + 0.003 * rng.standard_normal()
        r += (0.05 * d[k - 1] - r) / 20 + gust / 20
        psi[k] = psi[k - 1] + r
    return record(d=d, y=psi)


HOLDS = {
    "normal": lambda rng: 80 + 15 * rng.standard_normal(),
    "uniform": lambda rng: rng.uniform(20, 140),
    "exponential": lambda rng: 5 + rng.exponential(60),
    "fixed": lambda rng: 80,
}


@pytest.mark.parametrize("kind", HOLDS)
def test_a_rudder_that_reverses_by_its_clock_is_not_accused(kind):
    """(1) of the module is conservative: a late reversal also passes every threshold late."""
    runs = 150
    found = share_below(0.05, runs, lambda rng: clocked(rng, HOLDS[kind]), method="switching")
    assert found < 0.05 + binomial(0.05, runs)


@pytest.mark.parametrize("amplitude", [10.0, 20.0])
def test_a_zigzag_is_steered_by_its_heading(amplitude):
    """The rudder leaves its level when psi has passed the amplitude; it is 0.9 s on its way, in
    which psi moves by at most 0.3 deg/s a 10 deg of rudder, before it counts as gone."""
    r = kvlcc2_zigzag.simulate(amplitude=amplitude, duration=420.0)
    found = reference_depends_on(r, "delta", ["psi", "phi"])
    assert found.method == "switching"
    assert found.reversals >= 2
    assert found.depends
    assert found.culprits[0] == "psi"
    assert found.thresholds is not None
    degrees = abs(np.rad2deg(found.thresholds["psi"]))
    assert amplitude < degrees < amplitude + 0.3 * amplitude / 10 * (0.9 * amplitude / 10 + 0.3)


def test_a_few_reversals_prove_nothing_to_a_regression():
    """Two or three large innovations have four or eight patterns of signs: no p below 0.05."""
    zigzag = kvlcc2_zigzag.simulate(duration=260.0).decimate(8)
    turns = len(reversals(zigzag["delta"]).start)
    assert turns <= 3
    found = reference_depends_on(zigzag, "delta", ["psi"], method="regression", lags=6)
    assert found.p_value > 0.05


# -- refusals --------------------------------------------------------------------------------------


def test_what_cannot_be_tested_is_refused_with_the_mend():
    r = plant(np.random.default_rng(1))
    with pytest.raises(DataError, match=r"as a list: \['psi'\]"):
        reference_depends_on(r, "d", "y")
    with pytest.raises(DataError, match="at least one channel other than the reference"):
        reference_depends_on(r, "d", ["d"])
    with pytest.raises(DataError, match="no channel 'z'"):
        reference_depends_on(r, "d", ["z"])
    with pytest.raises(DataError, match="take a stretch in which it moves"):
        reference_depends_on(r.with_channel("z", np.ones(300), "1"), "d", ["z"])
    with pytest.raises(DataError, match=r"cut the record there \(record.between\)"):
        reference_depends_on(r.mark_missing("y", np.arange(300) == 4), "d", ["y"])
    with pytest.raises(DataError, match="fewer lags"):
        reference_depends_on(r, "d", ["y"], lags=40)
    with pytest.raises(DataError, match="between 0 and 1"):
        reference_depends_on(r, "d", ["y"], level=5.0)
    with pytest.raises(DataError, match="'regression' or 'switching'"):
        reference_depends_on(r, "d", ["y"], method="granger")


def test_a_switching_test_without_reversals_says_so():
    found = reference_depends_on(plant(np.random.default_rng(1)), "d", ["y"], method="switching")
    rising = record(d=np.linspace(0.0, 1.0, 300), y=np.random.default_rng(1).standard_normal(300))
    none = reference_depends_on(rising, "d", ["y"], method="switching")
    assert none.p_value == 1.0
    assert "fewer than two reversals" in none.note
    assert 0 <= found.p_value <= 1
