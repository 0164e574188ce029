"""What biases the estimate of a weight aboard, and what does not (Linder 2017, section 9.6).

    python -m analysis.ship_bias [--quick] [--out DIR]

1. One imperfection at a time, least squares (LS) against instruments (IV): bias of m and zbar_m
   with its Monte Carlo standard error, and the standard deviation of one estimate in brackets;
   rudder with and without a mean; what a mean in the instruments does (trap T-5). Calibration,
   nominal and loaded records of 300 s each, rudder a telegraph of +-0.35 rad, z_f known.
2. The ship's own hidden effects, diagnosed by `casid.diagnose`.
3. The sea state, in beam seas with a peak period of 8 s at full scale.
4. k, d and K_r as functions of the speed.
5. Wrong signs, and a straight course.

Targets are printed beside the numbers. --quick: few draws. Exit 1 where a target is missed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, replace

import numpy as np

from analysis.common.output import Output
from analysis.common.runner import Study, sections
from analysis.common.targets import Target, equal
from analysis.ship_bias.figures import imperfections, speed
from analysis.ship_bias.figures import sea as sea_figure
from analysis.ship_bias.hidden_effects import RMSE, SLOPE, Found, Hidden, diagnosed
from analysis.ship_bias.records import IMPERFECTIONS, SHIP, Imperfection, Rudder, answers, weakest
from analysis.ship_bias.speed import AtSpeed, against_speed, at_sea
from analysis.ship_bias.table import Row, mean_in_instruments, rows
from analysis.ship_bias.wrong_signs import straight_course, suspected

BIASED = {
    "gyro bias 0.01 rad/s": 0,
    "roll torque 0.01 N m rms": 0,
    "gyro noise 0.002 rad/s": 0,
    "accelerometer noise 0.02 m/s^2": 1,
    "yaw-rate noise 0.002 rad/s": 0,
    "all of these": 1,
}
"""Imperfections that bias least squares, and the component of (m, zbar_m) that has the target."""


def excitation(is_quick: bool, out: Output) -> Iterator[Target]:
    """How nearly dependent the regressors are, with the thesis' added mass in sway and ours."""
    table = replace(SHIP, coefficients=replace(SHIP.coefficients, Y_vdot=-100.0))
    found = {}
    for name, ship in (("100 kg, Table 8.2", table), ("22 kg, here", SHIP)):
        (nominal,) = answers(0, cases=("nominal",), ship=ship)
        found[name] = weakest(nominal.experiment(Imperfection()).record)
        print(f"  smallest singular value of Phi, added mass in sway {name}: {found[name]:.2g}")
    first, second = found.values()
    text, met = f"{second / first:.2g}", second > 3 * first
    yield Target("weakest direction, 22 kg over 100 kg", text, "> 3", met)


def table(is_quick: bool, out: Output) -> Iterator[Target]:
    """The table of imperfections."""
    plans = ((Rudder(), 4 if is_quick else 12), (Rudder(mean=0.1), 3 if is_quick else 6))
    for rudder, draws in plans:
        print(f"  rudder mean {rudder.mean:g} rad, {draws} draws of 3 x 300 s: m [kg], zbar_m [m]")
        made: dict[tuple[str, str], Row] = {}
        for row in rows(list(IMPERFECTIONS), rudder, draws, seconds=300.0):
            print(f"    {row}", flush=True)
            made[row.imperfection, row.method] = row
        label = f"imperfections_mean_{rudder.mean:g}"
        out.table(label, [row.numbers() for row in made.values()])
        out.figure(label, imperfections(list(made.values()), rudder.mean))
        for name in IMPERFECTIONS:
            squares, instruments = made[name, "LS"], made[name, "IV"]
            z = np.abs(instruments.bias) * np.sqrt(len(instruments.kept))
            z /= np.nanmean(instruments.stated, axis=0)
            what = f"mean {rudder.mean:g}: IV bias, {name}"
            text = f"{np.max(z):.2g} standard errors"
            met = np.max(z) <= 3.5 and instruments.refused == 0
            yield Target(what, text, "<= 3.5, none refused", met)
            # The biases of m partly cancel in all together: few draws do not determine the sum.
            is_determined = not (is_quick and name == "all of these")
            if name in BIASED and is_determined and len(squares.kept) > 1:
                i = BIASED[name]
                size = abs(squares.bias[i]) / squares.monte_carlo[i]
                what = f"mean {rudder.mean:g}: LS bias, {name}"
                yield Target(what, f"{size:.2g} standard errors", "> 3", size > 3)
    wrong = IMPERFECTIONS["gyro bias 0.01 rad/s"]
    for mean in (0.0, 0.1):
        errors = mean_in_instruments(wrong, Rudder(mean=mean), seed=0)
        text = ", ".join(f"{what} {e:+.1f} %" for what, e in errors.items())
        print(f"  T-5, gyro bias, rudder mean {mean:g} rad, error of alpha_2: lags of delta {text}")
        rest = max(abs(e) for what, e in errors.items() if what != "as it is")
        what = f"T-5, mean {mean:g}: alpha_2 without a mean in instruments"
        met = rest <= 5.0 and 5 * rest < abs(errors["as it is"])
        yield Target(what, f"{rest:.2g} %", "<= 5 %, a fifth of as it is", met)


EXPECTED: Mapping[Hidden, tuple[str, str] | None] = {
    "nothing": None,
    "damping": ("quadratic_damping", "torque"),
    "speed": ("scheduled_parameter", "K_r~speed"),
    "rudder": ("extra_input", "rudder"),
}


def hidden_effects(is_quick: bool, out: Output) -> Iterator[Target]:
    """What is named."""
    plain = math.nan
    for hidden, wanted in EXPECTED.items():
        if is_quick and hidden != "damping":
            continue
        found = diagnosed(hidden)
        print(f"  {found}", flush=True)
        if wanted is None:
            plain = found.rmse("baseline_rmse")
            verdict = found.diagnosis.verdict if found.diagnosis else "refused"
            met = found.named == () and found.diagnosis is not None
            yield Target("hidden: nothing", verdict, "adequate", met)
            continue
        named = ", ".join(f"{k} in {w}" for k, w in found.named) or "nothing"
        text = f"{wanted[0]} in {wanted[1]} reported"
        yield Target(f"hidden: {hidden}", named, text, wanted in found.reported)
        if hidden == "speed":
            yield from _speed_targets(found, plain)


def _speed_targets(found: Found, plain: float) -> Iterator[Target]:
    """K_r (u - U) r is the largest torque that a constant speed leaves out; d u p is the other.

    The gain wanted is 80 % of what there is in mean square, as in the tests of the diagnosis;
    `plain` [rad/s] is the error that is left where the speed holds, with the same noise.
    """
    slope, before, after = found.slope, *map(found.rmse, RMSE)
    error = slope.value - SLOPE if slope else math.nan
    size = abs(error) / (slope.std_error or math.nan) if slope else math.nan
    text = f"{size:.2g} standard errors from {SLOPE:g} N s^2/rad"
    yield Target("hidden: speed, slope of K_r", text, "named first, <= 3", size <= 3.0)
    share = (before**2 - after**2) / (before**2 - plain**2)
    text = f"{before:.3g} -> {after:.3g} rad/s, {share:.0%} of the way to {plain:.3g}"
    yield Target("hidden: speed, held out", text, ">= 80 % in mean square", share >= 0.8)


def sea_states(is_quick: bool, out: Output) -> Iterator[Target]:
    """Standard deviation and bias of m against significant wave height."""
    found = [
        at_sea(Hs, 3 if is_quick else 6, seconds=300.0)
        for Hs in ((0.0, 0.3) if is_quick else (0.0, 0.1, 0.2, 0.3, 0.5))
    ]
    for sea in found:
        print(f"  {sea}", flush=True)
    out.table("sea_states", [row for sea in found for row in sea.rows()])
    out.figure("sea_states", sea_figure(found))
    calm, rough = found[0], next(s for s in found if s.Hs == 0.3)
    before, after = (float(np.nanstd(s.by_instruments[:, 0], ddof=1)) for s in (calm, rough))
    text = f"{after:.3g} kg over {before:.3g} kg"
    yield Target("std of m by IV, Hs 0.3 m over calm", text, "grows", after > before)
    LS, IV, still = (
        abs(float(np.nanmean(e[:, 0])))
        for e in (rough.by_squares, rough.by_instruments, calm.by_instruments)
    )
    yield Target("|bias| of m at Hs 0.3 m, LS over IV", f"{LS / IV:.2g}", "> 3", LS > 3 * IV)
    yield Target("calm: |bias| of m by IV", f"{still:.2g} kg", "<= 0.004 kg", still <= 0.004)


def speeds(is_quick: bool, out: Output) -> Iterator[Target]:
    """The coefficients against speed."""
    found: list[AtSpeed] = []
    for U in (0.6, 1.4) if is_quick else (0.6, 0.8, 1.0, 1.2, 1.4):
        found += against_speed(U, seconds=300.0, seed=1)
        for row in found[-3:]:
            print(f"  {row}")
            what, text = f"{row.name} at {U:g} m/s", f"{row.z:+.2f} standard errors"
            yield Target(what, text, "within 3.5", abs(row.z) < 3.5)
    out.table("speeds", [asdict(row) for row in found])
    out.figure("speeds", speed(found))


def mistakes(is_quick: bool, out: Output) -> Iterator[Target]:
    """Signs and a straight course."""
    nothing = "nothing suspected"
    for name in ("none", "all of these"):
        for channel, suspect in suspected(name, seconds=120.0, seed=0).items():
            flip = f"-{channel}" if channel else "all signs right"
            yield equal(f"signs, {name}: {flip}", suspect or nothing, channel or nothing)
    for jitter in (0.0, 0.005):
        course = f"straight course, rudder +-{jitter:g} rad"
        said = straight_course(seconds=60.0, seed=0, jitter=jitter)
        for method, text in said.items():
            print(f"  {course}, {method}: {text}")
        why, warns = said["instruments"], "noise" in said["warnings"]
        refused = "refuse, and say why"
        yield Target(f"{course}: instruments", why.partition(":")[0], refused, "Error" in why)
        text = "warns" if warns else "does not warn"
        yield Target(f"{course}: least squares", text, "warns of noise", warns)


SECTIONS: Mapping[str, Callable[[bool, Output], Iterator[Target]]] = {
    "Excitation": excitation,
    "1. One imperfection at a time": table,
    "2. Hidden effects": hidden_effects,
    "3. Sea state": sea_states,
    "4. Coefficients against speed": speeds,
    "5. Mistakes": mistakes,
}

STUDY = Study(
    lambda run: sections(SECTIONS, run.quick, run.output),
    quick="few draws",
    out="folder for ship_bias.json, tables and figures",
    file="ship_bias.json",
)
