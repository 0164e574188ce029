"""What the linear regression of the rig bears: stiffening springs, large angles, bad references.

Without torque and sensor noise the estimates show their bias alone; standard errors are those of
full records with both. All estimates are multi-stage with prefilter 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from analysis.common.figures import Chart
from analysis.common.output import Output
from analysis.common.targets import Target, at_most, near
from analysis.pendulum_rig.estimators import FREE, INSTRUMENTS, MODEL, STEPS, TRUTH, staged
from analysis.pendulum_rig.records import AMPLITUDE, Draws
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.validation import validate
from casid.identification.moment_estimators import multistage
from problems import pendulum_rig as rig

LOAD = ("m", "z_m")


@dataclass(frozen=True, slots=True)
class Stiffening:
    """Springs k (1 + kappa phi^2) phi: relative bias of k, bias of m and z_m in standard errors."""

    kappa: float  # 1/rad^2
    angle: float  # rms, nominal [rad]
    angle_loaded: float
    k: float
    predicted_k: float
    m: float
    z_m: float


def stiffening(
    kappas: Sequence[float], errors: Mapping[str, float], *, duration: float, seed: int = 1
) -> list[Stiffening]:
    """Estimates from springs that stiffen, less those from springs that do not.

    Prediction: for jointly Gaussian signals phi^3 is correlated with every other as 3 sigma^2 phi
    is (Bussgang 1952), so all instruments see k (1 + 3 kappa sigma^2), whatever the filter.
    In a record of ten minutes, 125 lives of the resonance's power (d/I_1)^-1, the fourth moment is
    off by 1/sqrt(125) = 9 %, and what it leaves is shared between k and I_x: 30 % are allowed.

    Parameters
    ----------
    kappas : without 0, ascending [1/rad^2].
    errors : parameter -> standard error of an estimate from full records.
    """
    estimator = staged()
    rows: list[Stiffening] = []
    plain: dict[str, float] = {}
    for kappa in (0.0, *kappas):
        draws = Draws(duration, torque=0.0, kappa=kappa, seed=seed)
        found = estimator(draws.experiments())
        if not plain:
            plain = {n: found[n] for n in FREE}
            continue
        angle, loaded = draws.angle["nominal"], draws.angle["loaded"]
        m, z_m = ((found[n] - plain[n]) / errors[n] for n in LOAD)
        k, predicted = found["k"] / plain["k"] - 1, 3 * kappa * angle**2
        rows.append(Stiffening(kappa, angle, loaded, k, predicted, m, z_m))
    return rows


@dataclass(frozen=True, slots=True)
class Amplitude:
    """A pendulum with springs k phi dragged harder: biases in standard errors at this amplitude.

    The fits are those of the linear model at the true parameters, simulated from the cart.
    """

    amplitude: float  # m/s^2
    angle: float  # rms, loaded [rad]
    m: float
    z_m: float
    direct_m: float
    direct_z_m: float
    fit_gyro: float  # loaded [%]
    fit_accel: float


def amplitudes(
    values: Sequence[float], errors: Mapping[str, float], *, duration: float, seed: int = 1
) -> list[Amplitude]:
    """Indirect and direct linear estimates from the nonlinear pendulum (7.9), without noise.

    With k(phi) = k the accelerometer carries sin(phi) and cos(phi) with it, and the indirect model
    (7.24) is exact at any angle. The direct model (7.10), with the cart's acceleration known, is a
    linearisation. The same amplitude's biases at a tenth of a radian and below are the bilinear
    transform's; `values` begin with an amplitude that small, and its estimates are subtracted.

    Parameters
    ----------
    values : ascending, rms of the cart's acceleration [m/s^2].
    errors : parameter -> standard error at `AMPLITUDE`; a fixed disturbance makes them fall as the
        amplitude grows.
    """
    direct_model = rig.direct_model(cart_recorded=True).with_unknown(m=0.08, z_m=-0.1)
    indirect = staged()
    truth = {**{n: p.value or 0.0 for n, p in MODEL.parameters.items()}, **TRUTH}
    rows: list[Amplitude] = []
    first: dict[str, tuple[float, float]] = {}
    for value in values:
        draws = Draws(duration, amplitude=value, torque=0.0, seed=seed)
        experiments = draws.experiments()
        found = indirect(experiments)
        with_cart = [
            replace(e, record=e.record.with_channel("a_y", e.record["ref"], "m/s^2"))
            for e in experiments
        ]
        settings = MomentSettings(form="linear", outputs=("gyro",))
        direct = multistage(direct_model, with_cart, STEPS, settings=settings)
        first = first or {n: (found[n], direct[n]) for n in LOAD}
        scale = {n: errors[n] * AMPLITUDE / value for n in LOAD}
        check = validate(MODEL, truth, experiments, INSTRUMENTS)
        m, z_m = ((found[n] - first[n][0]) / scale[n] for n in LOAD)
        direct_m, direct_z_m = ((direct[n] - first[n][1]) / scale[n] for n in LOAD)
        gyro, accel = (check["loaded", channel].fit for channel in ("gyro", "accel"))
        angle = draws.angle["loaded"]
        rows.append(Amplitude(value, angle, m, z_m, direct_m, direct_z_m, gyro, accel))
    return rows


@dataclass(frozen=True, slots=True)
class Reference:
    """Instruments from a noisy reference: the load's estimate, its error and what the test says."""

    what: str
    m: float
    m_error: float
    z_m: float
    z_m_error: float
    p_value: float

    @property
    def distance(self) -> float:
        """The larger distance to the truth, in standard errors."""
        return max(
            abs(self.m - TRUTH["m"]) / self.m_error, abs(self.z_m - TRUTH["z_m"]) / self.z_m_error
        )


LOUD = 1.0
"""Sensor noise that makes the point [m/s^2]: twice the cart's rms acceleration."""


def references(*, duration: float, seed: int = 1) -> list[Reference]:
    """The same records with a quiet, a loud and a shared noise on the reference.

    Instruments are made of the reference alone. Noise on it that is independent of the pendulum's
    sensors is uncorrelated with the equation error: (2.44) holds, the correlation with the
    regressors falls, and the variance grows. Noise that both units share is in the equation error,
    through the accelerometer, and in the instruments.
    """
    quiet, loud = rig.Sensors(), rig.Sensors(accel=LOUD, cart=LOUD)
    cases = (
        ("cart 0.01 m/s^2", quiet, False),
        (f"cart {LOUD:g} m/s^2", rig.Sensors(cart=LOUD), False),
        (f"both {LOUD:g} m/s^2, independent", loud, False),
        (f"both {LOUD:g} m/s^2, shared", loud, True),
    )
    draws = Draws(duration, seed=seed)
    estimator = staged()
    rows = []
    for what, sensors, shared in cases:
        rng = np.random.default_rng(seed)
        e = estimator(draws.experiments(rng, sensors=sensors, shared=shared))
        (m, m_error), (z_m, z_m_error) = ((e[n], e.std_error(n)) for n in LOAD)
        rows.append(Reference(what, m, m_error, z_m, z_m_error, e.propagated.p_value))
    return rows


def crossing(x: Sequence[float], bias: Sequence[float], level: float = 1.0) -> float:
    """The smallest x at which |bias| reaches `level`, straight lines from (0, 0); inf if never."""
    points = [(0.0, 0.0), *((a, abs(b)) for a, b in zip(x, bias, strict=True))]
    for (x0, b0), (x1, b1) in zip(points, points[1:], strict=False):
        if b1 >= level > b0:
            return x0 + (level - b0) / (b1 - b0) * (x1 - x0)
    return float("inf")


# -- beside their targets --------------------------------------------------------------------------


def limits(
    errors: Mapping[str, float], out: Output, *, duration: float, quick: bool
) -> Iterator[Target]:
    """Springs that stiffen, angles that grow."""
    kappas = (0.25, 1.0, 4.0) if quick else (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
    springs = stiffening(kappas, errors, duration=duration)
    print(f"{'kappa':>8}{'angle rms':>11}{'k %':>8}{'theory %':>10}{'m/se':>8}{'z_m/se':>8}")
    for s in springs:
        print(
            f"{s.kappa:>8g}{s.angle:>11.3f}{100 * s.k:>8.2f}{100 * s.predicted_k:>10.2f}{s.m:>8.2f}"
            f"{s.z_m:>8.2f}"
        )
    out.table("stiffening", [asdict(s) for s in springs])
    hurts = {n: crossing(kappas, [getattr(s, n) for s in springs]) for n in ("m", "z_m")}
    print(
        "bias reaches one standard error at kappa = "
        + ", ".join(f"{v:.2g}/rad^2 ({n})" for n, v in hurts.items())
    )
    for s in springs:
        if s.predicted_k < 0.03:
            yield near(
                f"kappa {s.kappa:g}: k raised as Bussgang has it", s.k, s.predicted_k, 0.3, ""
            )
    least, inside = min(hurts.values()), "found within the sweep"
    what = "stiffness at which m or z_m is off by a std. error"
    yield Target(what, f"kappa = {least:.2g}/rad^2", inside, np.isfinite(least))
    sizes = (0.25, 0.5, 1.0) if quick else (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
    angles = amplitudes(sizes, errors, duration=duration)
    print(
        f"{'m/s^2':>8}{'angle rms':>11}{'m/se':>8}{'z_m/se':>8}{'direct m':>10}{'direct z_m':>11}"
        f"{'fit gyro':>10}{'fit accel':>10}"
    )
    for a in angles:
        print(
            f"{a.amplitude:>8g}{a.angle:>11.3f}{a.m:>8.2f}{a.z_m:>8.2f}{a.direct_m:>10.2f}"
            f"{a.direct_z_m:>11.2f}{a.fit_gyro:>10.1f}{a.fit_accel:>10.1f}"
        )
    out.table("amplitudes", [asdict(a) for a in angles])
    from_angle = crossing(
        [a.angle for a in angles], [max(abs(a.direct_m), abs(a.direct_z_m)) for a in angles]
    )
    what = f"linear springs, up to {angles[-1].angle:.2f} rad: m and z_m off by"
    yield at_most(what, max(max(abs(a.m), abs(a.z_m)) for a in angles), 0.5, "std. errors")
    what, met = "direct linear model off by a std. error", np.isfinite(from_angle)
    yield Target(what, f"from {from_angle:.2g} rad rms", inside, met)
    chart = Chart("What the linear regression bears before it is biased")
    scaled = [s.angle_loaded * s.kappa**0.5 for s in springs]
    for label, x, y in (
        ("m, stiffening", scaled, [s.m for s in springs]),
        ("z_m, stiffening", scaled, [s.z_m for s in springs]),
        ("m, linear springs, indirect", [a.angle for a in angles], [a.m for a in angles]),
        ("m, linear springs, direct", [a.angle for a in angles], [a.direct_m for a in angles]),
    ):
        chart.line(x, np.abs(y), label, mode="lines+markers")
    chart.figure.add_hline(y=1.0, line_dash="dash")
    chart.x_axis("rms angle [rad]; stiffening: times sqrt(kappa) [1]", type="log")
    chart.y_axis("bias in standard errors [1]", type="log")
    out.figure("limits", chart.figure)


def noisy_references(out: Output, *, duration: float) -> Iterator[Target]:
    """Instruments from a reference with noise of its own, and with shared noise."""
    rows = references(duration=duration)
    for r in rows:
        print(
            f"reference noise, {r.what:30} m {r.m:.4f} +- {r.m_error:.4f} kg, z_m {r.z_m:.4f} +- "
            f"{r.z_m_error:.4f} m, moments p = {r.p_value:.2g}"
        )
        if "shared" in r.what:
            what = "shared noise: the moments contradict one another"
            yield Target(what, f"p = {r.p_value:.2g}", "< 1e-3", r.p_value < 1e-3)
        else:
            yield at_most(f"{r.what}: distance to the truth", r.distance, 3.5, "std. errors")
    out.table("references", [asdict(r) for r in rows])
    ratio = rows[1].m_error / rows[0].m_error
    what = "a reference as noisy as this costs variance alone"
    yield Target(what, f"m {ratio:.2f} times", "> 1 time", ratio > 1)
