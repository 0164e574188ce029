"""Windows of a stream, changes of a mean, and parameters that are watched."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom

import casid
from casid.errors import DataError, IdentifiabilityError, ModelError
from casid.estimation.cross_moments.moments import Moments, moments
from casid.estimation.cross_moments.windowed_moments import (
    FadingSums,
    Simulated,
    SlidingSums,
    WindowedMoments,
    faded,
    on_simulated,
)
from casid.estimation.moments.change_detection import ChangeDetector
from casid.estimation.moments.stages.prior import Prior
from casid.identification.monitor_status import Derived, MonitorSettings
from casid.identification.parameter_monitor import Monitor
from casid.identification.window_estimator import MonitoredParameters
from casid.linear.sampled.difference_equation import difference_equation

# -- windows ---------------------------------------------------------------------------------------


def stream(n: int = 1000, seed: int = 1) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {"u": rng.standard_normal(n), "y": rng.standard_normal(n)}


@pytest.mark.parametrize("cut", [7, 100, 333, 1000])
def test_sums_over_windows_are_the_sums_over_their_union_wherever_the_stream_is_cut(
    cut: int,
) -> None:
    """Windows share no term and lose none; sums are exact to the rounding of N terms."""
    data = stream()
    made = WindowedMoments(["u", "y"], 3, 100)
    windows: list[Moments] = []
    for start in range(0, 1000, cut):
        windows += made.add({n: x[start : start + cut] for n, x in data.items()})
    assert len(windows) == 10
    assert [w.N for w in windows] == [97] + 9 * [100]
    whole = moments(data, 3)
    assert sum(windows).N == whole.N  # type: ignore[attr-defined]
    assert sum(windows).gram == pytest.approx(whole.gram, abs=1e-11)  # type: ignore[attr-defined]


def test_filters_of_a_stream_do_not_notice_its_windows() -> None:
    """A simulated channel and a prefilter are those of the whole record, states carried along."""
    data, b, a = stream(), np.array([0.2]), np.array([1.0, -0.8])
    made = WindowedMoments(
        ["y"],
        2,
        100,
        simulated={"y^": Simulated("u", b, a)},
        prefilter=([0.5, 0.5], [1.0, -0.3]),
        settle=200,
    )
    windows = [w for i in range(0, 1000, 50) for w in made.add(_cut(data, i, 50))]
    prefiltered = {"y": data["y"], "y^": lfilter(b, a, data["u"])}
    whole = {n: lfilter([0.5, 0.5], [1.0, -0.3], x)[200:] for n, x in prefiltered.items()}
    total = sum(windows)
    assert total.gram == pytest.approx(moments(whole, 2).gram, abs=1e-11)  # type: ignore[attr-defined]


def test_a_sliding_sum_is_the_sum_of_the_last_windows() -> None:
    windows = WindowedMoments(["u", "y"], 1, 100).add(stream())
    sums = SlidingSums(3)
    for w in windows:
        sums.add(w)
    assert sums.total.total == pytest.approx(sum(windows[-3:]).total, rel=1e-14)  # type: ignore[attr-defined]


def test_forgetting_weighs_windows_as_the_recursion_does() -> None:
    """M <- lambda M + M_c; what weighs less than 1e-6 is dropped, here nothing."""
    windows = WindowedMoments(["u", "y"], 1, 100).add(stream())
    sums, recursion = FadingSums(0.7), faded(windows[0], 0.0)
    for w in windows:
        sums.add(w)
        recursion = faded(recursion, 0.7) + w
    assert sums.total.total == pytest.approx(recursion.total, rel=1e-13)
    # effective number of equal windows, (sum w)^2 / sum w^2 -> (1 + lambda)/(1 - lambda)
    w_ = FadingSums(0.7)
    for w in 4 * windows:
        w_.add(w)
    assert w_.weights.sum() ** 2 / (w_.weights @ w_.weights) == pytest.approx(1.7 / 0.3, rel=1e-5)


def test_streams_that_cannot_be_summed_are_refused_with_a_mend() -> None:
    with pytest.raises(DataError, match="Take longer windows"):
        WindowedMoments(["y"], 10, 10)
    with pytest.raises(DataError, match="Reflect it"):
        Simulated("u", np.array([1.0]), np.array([1.0, -1.1]))
    with pytest.raises(DataError, match=r"the first k = 2\. Fill the gap"):
        WindowedMoments(["y"], 1, 10).add({"y": [0.0, 1.0, np.nan]})
    with pytest.raises(DataError, match="Rename"):
        WindowedMoments(["y"], 1, 10).add({"u": [0.0]})
    with pytest.raises(DataError, match=r"1 - 1/memory"):
        FadingSums(1.0)


def _cut(data: dict[str, np.ndarray], start: int, n: int) -> dict[str, np.ndarray]:
    return {name: x[start : start + n] for name, x in data.items()}


# -- changes ---------------------------------------------------------------------------------------


def test_one_comparison_of_gaussian_vectors_has_exactly_its_size() -> None:
    """Hotelling's T^2 with mean and covariance learnt from only 12 vectors: no asymptotics.

    1000 independent draws, level 5 %. Where correlation is estimated it is clipped at zero from
    below, so that half of the draws are judged with a larger variance: the size is at most nominal.
    """
    rng, alarms, n = np.random.default_rng(1), 0, 1000
    for _ in range(n):
        detector = ChangeDetector(0.05, widths=(3,), training=12)
        change = None
        for x in rng.standard_normal((15, 2)) @ np.array([[1.0, 0.9], [0.0, 0.1]]):
            change = detector.add(x)
        alarms += detector.is_alarm(change)
    assert alarms <= binom.ppf(0.999, n, 0.05)
    assert alarms >= binom.ppf(0.001, n, 0.025)  # and not much less


def test_false_alarms_are_no_more_frequent_than_stated() -> None:
    """Union bound: the expected number of alarms is at most rate x steps, widths overlapping.

    1500 steps at 1/50: at most 30 expected. Alarms come in bunches, each is followed by a restart
    and counted once; three standard deviations of Poisson's law above the bound.
    """
    rng = np.random.default_rng(2)
    for phi in (0.0, 0.3):  # with serial correlation as well
        e = lfilter([1.0], [1.0, -phi], rng.standard_normal((1500, 2)), axis=0)
        detector, alarms = ChangeDetector(1 / 50, training=60, memory=100), 0
        for x in e:
            if detector.is_alarm(detector.add(x)):
                alarms += 1
                detector.restart()
        assert alarms <= 30 + 3 * math.sqrt(30)


def test_without_its_serial_correlation_a_mean_would_seem_better_known_than_it_is() -> None:
    """Var of the mean of n terms of correlation rho^k is (1 + rho)/(1 - rho)/n for large n."""
    rng, rho, width = np.random.default_rng(3), 0.6, 40
    detector, change = ChangeDetector(0.01, widths=(width,), training=4000), None
    for x in lfilter([1.0], [1.0, -rho], rng.standard_normal(4000 + width + 100))[100:]:
        change = detector.add(x)  # compared once, at the end
    assert change is not None
    assert change.correlation == pytest.approx(rho, abs=0.04)  # 3 sqrt((1 - rho^2)/4000)
    expected = (1 / width) * (1 + rho) / (1 - rho) / (1 - rho**2)
    # a mean of 40 is 5 % below its limit, rho is known to 0.04
    assert change.covariance[0, 0] == pytest.approx(expected, rel=0.2)


def test_a_change_is_found_after_the_delay_that_its_size_explains() -> None:
    """A shift of delta standard deviations is seen when w delta^2 exceeds the threshold.

    Long training: T^2 is chi squared with 1 degree. rate 1e-3 over 7 widths: threshold 14.5, so a
    shift of 2 needs about 3.6 steps, and one of 6 a single one.
    """
    rng, delays = np.random.default_rng(4), {}
    for shift in (2.0, 6.0):
        found = []
        for _ in range(15):
            detector, x = ChangeDetector(1e-3, training=200), rng.standard_normal(240)
            x[220:] += shift
            steps = [i for i in range(240) if detector.is_alarm(detector.add(x[i]))]
            late = [i for i in steps if i >= 220]
            found.append(late[0] - 219)
        delays[shift] = float(np.median(found))
    assert delays[6.0] == 1.0
    assert 2.0 <= delays[2.0] <= 6.0


def test_a_change_is_dated_by_the_width_that_tells_most() -> None:
    rng, detector = np.random.default_rng(5), ChangeDetector(1e-9, training=100)
    change = None
    for x in np.concatenate([rng.standard_normal(200), 5.0 + rng.standard_normal(6)]):
        change = detector.add(x)
    assert change is not None
    assert change.width == 6
    assert change.after - change.before == pytest.approx(5.0, abs=1.3)  # 3/sqrt(6)


def test_a_rougher_time_is_no_change_where_its_variance_is_told() -> None:
    """Vectors of four times the variance, with and without saying so: 20 runs of 20 steps."""
    rng, alarms = np.random.default_rng(6), {1.0: 0, 4.0: 0}
    for _ in range(20):
        x = rng.standard_normal((120, 2))
        x[100:] *= 2.0
        for told in alarms:
            detector = ChangeDetector(1 / 2000, training=60)
            steps = [detector.add(v, told if i >= 100 else 1.0) for i, v in enumerate(x)]
            alarms[told] += any(detector.is_alarm(c) for c in steps)
    assert alarms[4.0] <= 3  # 20 x 60 steps / 2000 = 0.6 expected at most
    assert alarms[1.0] > 5


def test_detectors_that_cannot_work_are_refused_with_a_mend() -> None:
    with pytest.raises(DataError, match="between 0 and 1"):
        ChangeDetector(0.0)
    with pytest.raises(DataError, match="20 or more"):
        ChangeDetector(0.1, training=3)
    with pytest.raises(DataError, match="Keep at least 45"):
        ChangeDetector(0.1, memory=30)
    with pytest.raises(DataError, match="Leave out windows"):
        ChangeDetector(0.1).add([np.nan])


# -- a watched system ------------------------------------------------------------------------------
#
# m y'' = -k y - d y' + u with u applied as commanded, y' measured with noise, and a disturbance:
# k and d calibrated, the mass m is watched.

TS, SIZE = 0.05, 400
K, D = 4.0, 0.8


def cart() -> casid.Model:
    model = casid.Model("cart on a spring")
    x, v = model.state("x", "m"), model.state("v", "m/s")
    u = model.input("u", "N", known=True)
    m = model.parameter("m", "kg", start=1.0, lower=0.1, upper=10.0)
    k = model.parameter("k", "N/m", start=3.0, lower=0.0, upper=50.0)
    d = model.parameter("d", "N s/m", start=1.0, lower=0.0, upper=10.0)
    model.derivative(x, v)
    model.derivative(v, (u - k * x - d * v) / m)
    model.output("speed", v, "m/s")
    return model


MODEL = cart()
EQUATION = difference_equation(MODEL, "speed", TS)


def response(m: float, u: np.ndarray) -> np.ndarray:
    """The bilinear image, so that the difference equation is exact."""
    from scipy.signal import bilinear

    b, a = bilinear([1.0, 0.0], [m, D, K], 1 / TS)
    return np.asarray(lfilter(b, a, u))


def windows_of(masses: list[tuple[float, int]], seed: int, noise: float = 0.05) -> list[Moments]:
    """Windows with one mass after the other; the reference is a square wave."""
    rng = np.random.default_rng(seed)
    from scipy.signal import bilinear

    b, a = bilinear([1.0, 0.0], [1.0, D, K], 1 / TS)
    made = WindowedMoments(["speed", "u"], 2, SIZE, simulated={"speed^": Simulated("u", b, a)})
    found: list[Moments] = []
    for m, n in masses:
        t = np.arange(n * SIZE)
        u = np.where((t // 40) % 2 == 0, 1.0, -1.0)
        force = lfilter([0.1], [1.0, -0.95], rng.standard_normal(t.size))  # disturbance
        y = response(m, u + force) + noise * rng.standard_normal(t.size)
        found += made.add({"speed": y, "u": u})
    return found


def monitor(reference: list[Moments], **changes: object) -> Monitor:
    options: dict[str, object] = {
        "Ts": TS,
        "reference": reference,
        "instruments": on_simulated(EQUATION.columns, {"speed": "speed^"}),
        "detector": ChangeDetector(1e-4, training=20),
        "derived": {"frequency": Derived(lambda p: math.sqrt(p["k"] / p["m"]), "rad/s", 1.8)},
        "settings": MonitorSettings(every=3, span=12),
    } | changes
    watched: dict[str, object] = {
        "known": Prior({"k": K, "d": D}, {"k": 0.04, "d": 0.02}),
        "free": {"m": 1.0},
    }
    watched |= {n: options.pop(n) for n in ("known", "free", "start") if n in options}
    options["parameters"] = MonitoredParameters(**watched)  # type: ignore[arg-type]
    return Monitor(MODEL, **options)  # type: ignore[arg-type]


REFERENCE = windows_of([(1.0, 60)], seed=10)


def test_a_change_of_mass_is_found_dated_and_told_with_intervals() -> None:
    """One window tells the mass to 6 %, so that 30 % are seen within a few windows."""
    watched = monitor(REFERENCE, derived={})
    for w in windows_of([(1.0, 40), (1.3, 16)], seed=11):
        watched.add(w)
    (alarm,) = watched.alarms
    assert alarm.kind == "change"
    assert alarm.what == "m"
    change = 40 * SIZE * TS
    assert change < alarm.time <= change + 5 * SIZE * TS
    assert alarm.since == pytest.approx(change, abs=2 * SIZE * TS)
    assert alarm.before["m"].lower < 1.0 < alarm.before["m"].upper
    last = watched.status[-1]["m"]
    assert last.lower < 1.3 < last.upper
    assert last.upper - last.lower < 0.15
    assert "m changed" in str(alarm)


def test_the_estimate_is_the_truth_where_there_is_no_noise() -> None:
    """Noise-free data satisfy the difference equation at any mass, exactly."""
    watched = monitor(REFERENCE, settings=MonitorSettings(differential=False))
    made = WindowedMoments(["speed", "u"], 2, SIZE, simulated=_simulated(), settle=SIZE)
    u = np.where((np.arange(9 * SIZE) // 40) % 2 == 0, 1.0, -1.0)
    sums = sum(made.add({"speed": response(1.3, u), "u": u}))
    theta, _ = watched.estimator.estimate(sums, 8.0)  # type: ignore[arg-type]
    # the iteration rests at a ten-thousandth of a standard error; the error of mass here is 1e-2
    assert theta[0] == pytest.approx(1.3, abs=1e-5)


def test_intervals_cover_at_their_level() -> None:
    """95 % of 200 spans of one window, errors coloured; binomial bounds at 0.1 %.

    The reference stretch's own moments are in all of them: 60 windows against 1, a sixtieth.
    """
    watched = monitor(
        REFERENCE, known=Prior({"k": K, "d": D}), settings=MonitorSettings(every=1, span=1)
    )
    for w in windows_of([(1.0, 200)], seed=12):
        watched.add(w)
    held = sum(s["m"].lower <= 1.0 <= s["m"].upper for s in watched.status)
    assert binom.ppf(0.001, 200, 0.95) <= held <= 200


def test_calibration_errors_cancel_at_the_reference_and_reach_derived_numbers() -> None:
    """With s_0 subtracted, d m/d k = 0 at theta_0; the frequency sqrt(k/m) keeps k's own error."""
    found = {}
    for differential in (True, False):
        settings = MonitorSettings(differential=differential)
        watched = monitor(REFERENCE, settings=settings)
        theta, joint = watched.estimator.estimate(sum(REFERENCE), 60.0)  # type: ignore[arg-type]
        found[differential] = abs(joint[0, 1]) / 0.04**2  # d m/d k
        assert theta[0] == pytest.approx(1.0, abs=0.05)
    assert found[True] < 1e-3 * found[False]
    frequency = monitor(REFERENCE).intervals(sum(REFERENCE), 60.0)["frequency"]  # type: ignore[arg-type]
    assert frequency.std_error >= 0.5 * 0.04 / K * 2.0 * 0.99  # sigma_k/(2 k) of 2 rad/s


def test_a_small_margin_raises_one_alarm_until_it_recovers() -> None:
    watched = monitor(REFERENCE)
    for w in windows_of([(1.0, 24), (1.5, 24), (1.0, 24), (1.5, 24)], seed=13):
        watched.add(w)
    limits = [a for a in watched.alarms if a.kind == "limit"]
    assert len(limits) == 2  # sqrt(4/1.5) = 1.63 rad/s, twice
    assert all(a.what == "frequency" and "is small" in str(a) for a in limits)
    assert limits[0].time > 24 * SIZE * TS


def test_a_sudden_rise_of_noise_is_no_change_of_mass() -> None:
    """Five times the noise from one window to the next; 0.02 alarms are expected in 180 windows."""
    watched = monitor(REFERENCE, derived={})
    for w in windows_of([(1.0, 60)], seed=14) + windows_of([(1.0, 120)], seed=15, noise=0.25):
        watched.add(w)
    scales = np.array([scale for *_, scale in watched.vectors])
    assert scales[60:].mean() > 5.0 * scales[:60].mean()
    assert watched.alarms == []


def test_what_cannot_be_watched_is_refused_with_a_mend() -> None:
    with pytest.raises(DataError, match="Record longer"):
        monitor(REFERENCE[:4])
    with pytest.raises(ModelError, match="free and known at once"):
        monitor(REFERENCE, free={"k": K})
    with pytest.raises(IdentifiabilityError, match="Monitor fewer parameters"):
        monitor(
            REFERENCE,
            known=Prior({}),
            free={"m": 1.0, "k": K, "d": D},
            instruments=on_simulated(EQUATION.columns[:1], {"speed": "speed^"}),
        )


def _simulated() -> dict[str, Simulated]:
    from scipy.signal import bilinear

    b, a = bilinear([1.0, 0.0], [1.0, D, K], 1 / TS)
    return {"speed^": Simulated("u", b, a)}
