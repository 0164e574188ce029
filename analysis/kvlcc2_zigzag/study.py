"""A real hull in zigzags: what drives its roll, what is missed without, what the rudder can claim.

    python -m analysis.kvlcc2_zigzag [--quick] [--out DIR]

KVLCC2, free-running tests of MARIN (SIMMAN 2008) scaled to full scale, zigzags of 10 and 20 degrees
(`problems/kvlcc2_zigzag.py`). Target: the published roll frequency, 0.3468 rad/s, to be met within
6 % and 12 % where lateral acceleration, yaw, sway and rudder are inputs. Without any of them a
regression gives 0.17 and 0.08 rad/s, and the diagnosis is to say that inputs are missing. First
regressions with plain numpy gave 0.333 and 0.309 rad/s with the same inputs.

The intervals are of statistical error under the model. Those of the simulation are narrower than
what model and published value share: that one is model data of another facility (GM and radius of
inertia as built there), and residuals are coloured, so it may lie outside.

Everything is estimated on one record and judged on the other, which is the only one there is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

import casid
from analysis.common.output import Output
from analysis.common.runner import Run, Study, shared_folder
from analysis.common.targets import Target, at_most, completed, near
from casid.estimation.covariance import autocorrelation
from casid.estimation.equation_error import equation_error
from casid.estimation.estimate import Estimate
from casid.estimation.measured_motion import Butterworth
from casid.estimation.moments.instruments.exogeneity import reference_depends_on
from casid.estimation.prediction_error.coordinated_turn import Track, rounding_error
from casid.model.declarations import Input
from casid.model.effects.balances.balance_effects import cubic_stiffness, quadratic_damping
from problems import kvlcc2_zigzag
from problems.kvlcc2_zigzag import OMEGA_0

RECORDS = {"zz_10": 0.06, "zz_20": 0.12}
"""Record -> how far the roll frequency may lie from the published one, relative."""

ALONE = {"zz_10": 0.17, "zz_20": 0.08}
"""Record -> what a regression finds for the roll frequency without inputs [rad/s]."""

FIRST = {"zz_10": 0.333, "zz_20": 0.309}
"""Record -> first regression with inputs [rad/s], to be beaten."""

PREFILTER = Butterworth(0.3)
"""Five and a half times the roll frequency of 0.055 Hz."""

U_0 = 7.0
"""Speed [m/s] to which coefficients that depend on speed refer: what the zigzags run at."""

LONGEST = 150.0
"""Lag up to which the error of the balance is looked at [s]: between two reversals."""


def frequency(estimate: Estimate) -> tuple[float, float]:
    """Roll frequency sqrt(C_1) [rad/s] and its standard error, by the delta method."""
    row = next(p for p in estimate.parameters if p.name == "C_1")
    omega = math.sqrt(max(row.value, 0.0))
    return omega, (row.std_error or math.nan) / (2 * max(omega, 1e-12))


def _text(omega: float, error: float) -> str:
    return f"{omega:.4f} [{omega - 1.96 * error:.4f}, {omega + 1.96 * error:.4f}] rad/s"


def frequencies(data: Mapping[str, casid.Experiment]) -> Iterator[Target]:
    """The roll frequency by regression and by simulation, with the inputs and without."""
    problem, alone = kvlcc2_zigzag.problem, kvlcc2_zigzag.without_inputs()
    for name, e in data.items():
        within = RECORDS[name]
        wanted = f"{OMEGA_0:g} rad/s +- {100 * within:g} %"
        regression = equation_error(problem, e, prefilter=PREFILTER, decimate=4).estimate
        simulation = casid.identify(problem, kvlcc2_zigzag.coarse(e))
        for how, estimate in (("regression", regression), ("simulation", simulation)):
            omega, error = frequency(estimate)
            met = abs(omega / OMEGA_0 - 1) <= within
            yield Target(f"{name}, {how}: roll frequency", _text(omega, error), wanted, met)
            off, first = (100 * abs(x / OMEGA_0 - 1) for x in (omega, FIRST[name]))
            what, limit = f"{name}, {how}: off the published value by", f"< {first:.1f} %"
            yield Target(what, f"{off:.2f} %", f"{limit}, the first regression's", off < first)
        lone, _ = frequency(equation_error(alone, e, prefilter=PREFILTER, decimate=4).estimate)
        what = f"{name}, regression without inputs: roll frequency"
        yield near(what, lone, ALONE[name], 0.1, "rad/s")


def smoothed(folder: Path, name: str) -> tuple[Track, Any]:
    """The track from positions and heading of a record, every fourth sample; and its columns.

    The noise is the rounding of what was written. Beside it there is next to none: found so if it
    is left free, and slower.
    """
    d = np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True)[::4]
    record = casid.Record(
        {"x": d["x_m"], "y": d["y_m"], "psi": np.deg2rad(d["psi_deg"])},
        {"x": "m", "y": "m", "psi": "rad"},
        Ts=float(np.mean(np.diff(d["t_s"]))),
        name=name,
    )
    known = {
        "x": rounding_error(d["x_m"]),
        "y": rounding_error(d["y_m"]),
        "psi": np.deg2rad(rounding_error(d["psi_deg"])),
    }
    levels = {"position": 0.01, "heading": 1e-6}
    return casid.smooth_track(record, known=known, levels=levels), d


def surge_speeds(folder: Path) -> Iterator[Target]:
    """Surge speed by a coordinated-turn smoother from positions and heading alone."""
    for name in RECORDS:
        track, d = smoothed(folder, name)
        psi = np.deg2rad(d["psi_deg"])
        recorded = d["u_mps"] * np.cos(psi) + d["v_mps"] * np.sin(psi)
        rms = float(np.sqrt(np.mean((track.u - recorded) ** 2)))
        yield at_most(f"{name}: smoothed surge speed from the recorded one, rms", rms, 0.1, "m/s")


def pooled(data: Mapping[str, casid.Experiment]) -> Iterator[Target]:
    """One C_1 for both records, everything else for each."""
    problem = kvlcc2_zigzag.problem
    own = [n for n in problem.model.parameters if n != "C_1"]
    both = [kvlcc2_zigzag.coarse(e) for e in data.values()]
    estimate = casid.identify(problem, both, settings=casid.FitSettings(starts=1, own=own))
    omega, error = frequency(estimate)
    met = abs(omega / OMEGA_0 - 1) <= 0.06
    wanted = f"{OMEGA_0:g} rad/s +- 6 %"
    yield Target("both, simulation: one roll frequency", _text(omega, error), wanted, met)


# -- the wrong model -------------------------------------------------------------------------------


def diagnosed(data: Mapping[str, casid.Experiment], out: Output) -> Iterator[Target]:
    """What the diagnosis says of the roll without inputs."""
    alone = kvlcc2_zigzag.without_inputs()
    for name, e in data.items():
        d = casid.diagnose(alone, kvlcc2_zigzag.coarse(e))
        out.report(name, d)
        named = [(c.kind, c.where) for c in d.causes]
        said = {*named, *((a.kind, a.where) for c in d.causes for a in c.alternatives)}
        first = " in ".join(named[0]) if named else d.verdict
        met = bool(named) and named[0][0] == "extra_input"
        yield Target(f"{name}, no inputs: first cause", first, "extra_input", met)
        inputs = sorted(where for kind, where in said if kind == "extra_input")
        what = f"{name}, no inputs: missing, or not to be rejected"
        yield Target(what, ", ".join(inputs) or "none", "a_y among them", "a_y" in inputs)
        before = d.held_out["baseline_rmse"]["phi"]
        after = d.held_out.get("extended_rmse", d.held_out["baseline_rmse"])["phi"]
        text = f"{np.rad2deg(before):.4f} -> {np.rad2deg(after):.4f} deg"
        what = f"{name}, no inputs: rms of the held-out 30 %"
        yield Target(what, text, "better with the causes", after < before)


# -- what (1) may still lack -----------------------------------------------------------------------


def speed_dependence(model: casid.Model, parameter: str, power: int) -> casid.Effect:
    """A coefficient that follows the speed: c (1 + s ((U/U_0)^power - 1)), s = 1 if wholly so.

    Linder (2017), after (8.20): k, d and K_r depend on U. A rudder's force goes with U^2.
    """

    def apply(new: casid.Model, names: Sequence[str]) -> None:
        U = new.add_input(Input("U", "m/s", "known", "foh"))
        reference = new.constant(new.free_name("U_0"), U_0, "m/s")
        share = 1 + new.symbol(names[0]) * ((U / reference) ** power - 1)
        new.substitute_symbol(parameter, new.symbol(parameter) * share)

    s = casid.Parameter(f"s_{parameter}", "1", 0.0, lower=-20.0, upper=20.0)
    return casid.Effect("speed_dependence", parameter, (s,), apply)


def extensions(model: casid.Model) -> list[casid.Effect]:
    """Nonlinear damping and restoring, and every coefficient that may follow the speed."""
    cubic = cubic_stiffness(model, "torque")
    return [
        quadratic_damping(model, "torque"),
        *([cubic] if cubic is not None else []),
        speed_dependence(model, "C_1", 2),
        speed_dependence(model, "B_1", 1),
        speed_dependence(model, "b_r", 1),
        speed_dependence(model, "b_v", 1),
        speed_dependence(model, "b_delta", 2),
    ]


def extended(data: Mapping[str, casid.Experiment]) -> Iterator[Target]:
    """Every extension fitted on one record, with its gain there and on the other."""
    problem = kvlcc2_zigzag.problem
    coarse = {n: kvlcc2_zigzag.coarse(e) for n, e in data.items()}
    settings = casid.FitSettings(starts=1)
    gains: dict[str, list[float]] = {}
    for name, other in (("zz_10", "zz_20"), ("zz_20", "zz_10")):
        plain = casid.identify(problem, coarse[name], hold_out=[coarse[other]], settings=settings)
        start = {p.name: p.value for p in plain.parameters if not p.known}
        for effect in extensions(problem.model):
            wider = replace(problem, model=problem.model.extend(effect), truth={}, simulate=None)
            what = f"{effect.kind} in {effect.where}"
            held = [coarse[other]]
            try:
                fit = casid.identify(
                    wider, coarse[name], hold_out=held, settings=settings, start=start
                )
            except (casid.SolveError, casid.IdentifiabilityError) as error:
                found = f"not estimated: {type(error).__name__}"
                yield Target(f"{name}: {what}", found, "reported", True)
                continue
            row = next(p for p in fit.parameters if p.name == effect.parameters[0].name)
            ratio = abs(row.value / row.std_error) if row.std_error else math.nan
            here = _gain(plain.rmse[name], fit.rmse[name])
            there = _gain(plain.held_out_rmse[other], fit.held_out_rmse[other])
            gains.setdefault(what, []).append(there)
            size = f"{ratio:.1f} s.e." if math.isfinite(ratio) else row.note.split(":")[0]
            text = f"{size}, gain {here:+.1f} %, on {other} {there:+.1f} %"
            yield Target(f"{name}: {what}", text, "reported", True)
    helpful = [what for what, both in gains.items() if len(both) == 2 and min(both) > 0.5]
    what = "extensions that gain on the other record both ways"
    yield Target(what, ", ".join(helpful) or "none", "reported", True)


def _gain(before: Mapping[str, float], after: Mapping[str, float]) -> float:
    """Per cent by which the rms error of the roll angle falls."""
    return 100 * (1 - after["phi"] / before["phi"])


# -- the rudder as a reference ---------------------------------------------------------------------


def external(data: Mapping[str, casid.Experiment]) -> Iterator[Target]:
    """Whether delta depends on the heading, and what instruments made of it may claim."""
    for name, e in data.items():
        found = reference_depends_on(e.record, "delta", ["psi", "r", "v", "phi", "p"])
        print(found)
        coarse = kvlcc2_zigzag.coarse(e, 8).record
        few = reference_depends_on(coarse, "delta", ["psi"], method="regression")
        print(
            f"  {name}: a regression of delta on past psi alone has p = {few.p_value:.2g}; "
            f"{found.reversals} reversals have {2**found.reversals} patterns of signs, and it sees "
            "no more of them"
        )
        yield Target(
            f"{name}: delta depends on outputs",
            f"p = {found.p_value:.2g}, from {', '.join(found.culprits) or 'none'}",
            "p < 0.05, psi first",
            found.depends and found.culprits[0] == "psi",
        )
        print(
            f"  {name}: the error of the roll balance is correlated over {_memory(e):.0f} s "
            f"(looked at: up to {LONGEST:g} s). No lag of delta shorter than that is an "
            "instrument; and psi, which never forgets a disturbance of yaw, sets the instants of "
            "the reversals. An estimate by instruments made of delta is a check on the regression "
            "here, with a bias that nothing bounds; it may not be called consistent"
        )


def _memory(e: casid.Experiment) -> float:
    """Longest lag [s] at which the error of the balance is correlated, at 5 % for all lags."""
    model, d = kvlcc2_zigzag.problem.model, kvlcc2_zigzag.coarse(e).record
    fit = equation_error(model, casid.Experiment(d), prefilter=PREFILTER)
    r = {n: PREFILTER.apply(d[n], d.Ts) for n in d.names}
    v = {p.name: p.value for p in fit.estimate.parameters}
    error = np.gradient(r["p"], d.Ts) + v["C_1"] * r["phi"] + v["B_1"] * r["p"] - v["c_0"]
    for name in kvlcc2_zigzag.INPUTS:
        error -= v["b_a" if name == "a_y" else f"b_{name}"] * r[name]
    error = error[40:-40]  # the filter distorts both ends
    rho = autocorrelation(error, round(LONGEST / d.Ts))
    band = NormalDist().inv_cdf(1 - 0.025 / len(rho)) / math.sqrt(len(error))
    outside = np.flatnonzero(np.abs(rho) > band)
    return float((outside[-1] + 1 if outside.size else 0) * d.Ts)


def study(run: Run) -> Iterator[Target]:
    """All targets; prints what the records are, and what is derived from them, first."""
    folder = shared_folder("data/kvlcc2_marin_free")
    data = {n: kvlcc2_zigzag.problem.read(folder / f"{n}.csv") for n in RECORDS}
    for name, e in data.items():
        print(f"{name}: {e.record!r}")
        for line in e.record.provenance:
            if "derived" in line:
                print(f"  {line}")
    yield from frequencies(data)
    yield from external(data)
    yield from surge_speeds(folder)
    if not run.quick:
        yield from pooled(data)
        yield from diagnosed(data, run.output)
        yield from extended(data)


STUDY = Study(
    lambda run: completed(study(run)),
    quick="frequencies and the rudder alone",
    out="folder for targets.json and the reports",
)
