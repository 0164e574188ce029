"""Diagnoses and estimates put together by hand, for tests of what displays them.

A pendulum on a cart: I phi'' = -k phi - d p - d_2 |p| p + s a, output gyro = p. The record has
quadratic damping; "before" is the same pendulum with linear damping only. Nothing is estimated: the
numbers around the signals are plausible, and consistent with each other.
"""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np

from casid.diagnosis.diagnosis import (
    Alternative,
    Cause,
    Diagnosis,
    Disturbance,
    Evidence,
    Gain,
    Limits,
    Ranked,
)
from casid.diagnosis.verdict.remainder import (
    Explained,
    Moved,
    Remaining,
    moved_parameters,
    what_remains,
)
from casid.estimation.estimate import (
    Agreement,
    Estimate,
    Estimated,
    Identifiability,
    Origin,
    RecordView,
    SolverEvidence,
    Uncertainty,
)
from casid.estimation.whiteness import Whiteness
from casid.presentation import present
from tests.support.sample_parts import (
    calibration,
    disturbances,
    isolability,
    proposals,
    undetectable,
    unexplained,
)

TS = 0.02
NOISE = 0.010
HOSTILE = "<script>alert(1)</script></script><img src=x onerror=alert(2)>&amp;%{x}\u202e"


def page_of(result: object, *arguments: Any) -> str:
    """The page of a result, such as `write` would write it."""
    return str(present(result, "page", *arguments))


def pendulum(a: np.ndarray, *, k: float, d: float, d_2: float, s: float) -> np.ndarray:
    """(N, 2) states phi [rad], p [rad/s] from rest: semi-implicit Euler, fine enough to look at."""
    phi = p = 0.0
    x = np.zeros((a.size, 2))
    for i in range(a.size):
        x[i] = phi, p
        for _ in range(4):
            p += TS / 4 * (-k * phi - d * p - d_2 * abs(p) * p + s * a[i])
            phi += TS / 4 * p
    return x


@cache
def view(*, N: int = 6000, seed: int = 3, name: str = "swing-07", d_2: float = 0.35) -> RecordView:
    """The record, its last 30 % held out; the extended model is the truth. Nobody changes it."""
    rng = np.random.default_rng(seed)
    t = 12.0 + TS * np.arange(N)
    a = np.convolve(rng.standard_normal(N), np.hanning(25) / 4, mode="same")
    a *= 1.0 + 0.8 * np.sin(2 * np.pi * t / 60)
    x = pendulum(a, k=10.4, d=0.08, d_2=d_2, s=0.9)
    before = pendulum(a, k=10.4, d=0.08 + 0.25 * (d_2 > 0), d_2=0.0, s=0.9)
    measured = x[:, 1:] + NOISE * rng.standard_normal((N, 1))
    used = np.ones((N, 1), dtype=bool)
    if N > 1300:
        measured[1234, 0] += 3.0
        used[1234, 0] = False
    if N > 2010:
        measured[2000:2010, 0] = np.nan
        used[2000:2010, 0] = False
    for made in (t, measured, used, before, x):
        made.setflags(write=False)
    return RecordView(
        name=name,
        t=t,
        outputs=("gyro",),
        output_units=("rad/s",),
        measured=measured,
        used=used,
        fitted=np.arange(N) < 0.7 * N,
        baseline=before[:, 1:],
        extended=x[:, 1:],
        inputs=("accel",),
        input_units=("m/s^2",),
        u=(a + 0.02 * rng.standard_normal(N))[:, None],
        states=("phi", "p"),
        state_units=("rad", "rad/s"),
        x=x,
    )


def whiteness_of(outside: int) -> Whiteness:
    """The test of a residual with so many lags outside."""
    return Whiteness(outside, 20, meaning="incomplete" if outside > 3 else "")


def estimate(*, extended: bool = False, rmse: float = 0.031, held_out: float = 0.034) -> Estimate:
    """A fit of the pendulum, with or without quadratic damping."""
    parameters = [
        Estimated("k", 10.41 if extended else 10.52, "N m/rad", std_error=0.02, start=9.0),
        Estimated("d", 0.081 if extended else 0.33, "N m s/rad", std_error=0.004, start=0.1),
        Estimated("s", 0.902 if extended else 0.87, "N m s^2/m", std_error=0.006, start=1.0),
        Estimated("I", 1.0, "kg m^2", known=True),
        Estimated("z_s", 0.0, "m", start=0.1, note="at lower bound", bound="lower"),
    ]
    if extended:
        parameters.append(Estimated("d_2", 0.349, "N m s^2/rad^2", std_error=0.011, start=0.0))
    free = tuple(p.name for p in parameters if p.std_error is not None)
    return Estimate(
        problem="pendulum",
        method="simulation error, single shooting",
        parameters=tuple(parameters),
        initial_states=(Estimated("phi(0)", 0.001, "rad", std_error=0.0005, start=0.0),),
        uncertainty=Uncertainty(
            free,
            np.diag([p.std_error**2 for p in parameters if p.std_error is not None]),
            "Normal, from a spectrum of the residual that follows the model; N large.",
        ),
        solver=SolverEvidence("converged", True, 11, 2e-9, 4, 4),
        fit=Agreement(
            {"swing-07": {"gyro": rmse}},
            {"swing-07": {"gyro": 100 * (1 - rmse / 0.3)}},
            {"gyro": whiteness_of(2 if extended or rmse < 0.02 else 19)},
        ),
        held_out=Agreement(
            {"swing-07": {"gyro": held_out}}, {"swing-07": {"gyro": 100 * (1 - held_out / 0.3)}}
        ),
        identifiability=Identifiability(len(free), len(free), 0.04),
        units={"gyro": "rad/s"},
        warnings=(),
        origin=Origin(
            ("swing-07.csv sha256 5b1c0d5e8f", "gyro: deg/s -> rad/s"),
            {"casid": "0.1.0", "casadi": "3.7.0", "numpy": "2.1.0"},
            ("Ljung, L. (1999). System Identification: Theory for the User, 2nd ed.",),
        ),
    )


RANKING = (
    Ranked("quadratic_damping", "torque", 1e-41, 1e-39, 812.0, "named"),
    Ranked("coulomb_friction", "torque", 3e-12, 1e-10, 790.4, "cannot be rejected"),
    Ranked("cubic_stiffness", "torque", 2e-4, 4e-3, 31.0, "rejected", "refit gains too little"),
    Ranked("time_delay", "gyro", 0.03, 0.41, None, "not significant"),
    Ranked("sensor_lag", "gyro", 0.04, 0.45, None, "not significant"),
    Ranked("parameter_drift", "k", 0.2, 0.97, None, "not significant"),
    Ranked("scheduled_parameter", "d~speed", 0.5, 1.0, None, "not significant"),
    Ranked(
        "sensor_scale", "gyro", float("nan"), float("nan"), None, "invisible", "absorbed by s and I"
    ),
)


GROUPS: dict[str, type] = {"evidence": Evidence, "gain": Gain, "limits": Limits, "origin": Origin}


def diagnosis_of(**values: Any) -> Diagnosis:
    """A diagnosis from the values of its own fields and of those of its groups."""
    groups = {
        name: kind(**{f.name: values.pop(f.name) for f in fields(kind) if f.name in values})
        for name, kind in GROUPS.items()
    }
    return Diagnosis(**values, **groups)


def changed(diagnosis: Diagnosis, **values: Any) -> Diagnosis:
    """The same with other values, those of its groups among them."""
    groups = {
        name: replace(
            getattr(diagnosis, name),
            **{f.name: values.pop(f.name) for f in fields(kind) if f.name in values},
        )
        for name, kind in GROUPS.items()
    }
    return replace(diagnosis, **values, **groups)


def deficient(*, records: int = 1, N: int = 6000) -> Diagnosis:
    """Quadratic damping named, Coulomb friction beside it."""
    return diagnosis_of(
        problem="pendulum",
        verdict="deficient",
        sentence="The model lacks quadratic damping in the torque balance; naming it brings the "
        "held-out error of gyro from 0.034 to 0.0104 rad/s, at the noise floor.",
        causes=(
            Cause(
                "quadratic_damping",
                "torque",
                1e-39,
                (Estimated("d_2", 0.349, "N m s^2/rad^2", std_error=0.011),),
                (
                    Alternative(
                        "coulomb_friction",
                        "torque",
                        0.2,
                        "both take energy at every rate; this record hardly leaves 0.2 rad/s",
                    ),
                ),
                share=0.91,
                sentence="Damping grows with the rate: at 1 rad/s the torque is 0.35 N m more.",
            ),
        ),
        ranking=RANKING,
        baseline=estimate(),
        extended=estimate(extended=True, rmse=0.0101, held_out=0.0104),
        records=tuple(
            view(N=N, seed=3 + i, name="swing-07" if i == 0 else f"swing-{7 + i:02d}")
            for i in range(records)
        ),
        fitted={"baseline_rmse": {"gyro": 0.031}, "extended_rmse": {"gyro": 0.0101}},
        held_out={
            "baseline_rmse": {"gyro": 0.034},
            "extended_rmse": {"gyro": 0.0104},
            "noise_floor": {"gyro": 0.010},
        },
        advice="A free decay from a large angle would separate quadratic damping from friction.",
        noise={
            "gyro": "white, rms 0.010 rad/s",
            "accel": "rms 0.02 m/s^2, taken from the datasheet",
        },
        notes=("One sample of gyro is an outlier at t = 36.68 s and is left out.",),
        provenance=("swing-07.csv sha256 5b1c0d5e8f", "gyro: deg/s -> rad/s"),
        settings={"hold_out": "last 30 %", "false_alarm_rate": "0.05"},
        versions={"casid": "0.1.0", "casadi": "3.7.0", "numpy": "2.1.0"},
        sources=(
            "Ljung, L. (1999). System Identification: Theory for the User, 2nd ed.",
            "Romano, J. P., Wolf, M. (2005). Econometrica 73, 1237-1282. "
            "https://doi.org/10.1111/j.1468-0262.2005.00615.x",
        ),
    )


def adequate() -> Diagnosis:
    """The model as it is explains the record."""
    v = replace(view(d_2=0.0), extended=None)
    return changed(
        deficient(N=100),
        verdict="adequate",
        sentence="No effect of the catalogue improves the simulation beyond chance.",
        causes=(),
        ranking=tuple(replace(r, status="not significant", adjusted=0.6) for r in RANKING[2:6]),
        baseline=estimate(rmse=0.0101, held_out=0.0102),
        extended=None,
        records=(v,),
        fitted={"baseline_rmse": {"gyro": 0.0101}, "extended_rmse": {}},
        held_out={
            "baseline_rmse": {"gyro": 0.0102},
            "extended_rmse": {},
            "noise_floor": {"gyro": 0.01},
        },
        advice="Nothing to add.",
        notes=(),
    )


def undecided() -> Diagnosis:
    """A record too short for any answer, and nothing to rank."""
    v = replace(view(N=60), extended=None)
    bare: dict[str, Any] = {"ranking": (), "fitted": {}, "held_out": {}, "noise": {}, "sources": ()}
    return changed(
        adequate(),
        verdict="undecided",
        sentence="The record cannot support an answer: 1.2 s hold less than one period.",
        records=(v,),
        advice="Record at least 20 s with the cart moving.",
        **bare,
    )


def rich() -> Diagnosis:
    """Everything a diagnosis can say at once: two causes, one of them without a name."""
    d = deficient(records=2)
    by_record = {
        f"swing-{7 + i:02d}": {
            "h": Estimated("h", value, "N m s^3/rad^3", std_error=0.008),
            "h_0": Estimated("h_0", 0.01 * i, "N m", std_error=0.004),
        }
        for i, value in enumerate((0.051, 0.083, 0.047, 0.112, 0.049))
    }
    unknown = Cause(
        "unknown",
        "torque",
        4e-7,
        (Estimated("h", 0.064, "N m s^3/rad^3", std_error=0.005),),
        share=0.09,
        sentence="something that the catalogue has no name for acts in the torque balance",
        description="It depends on p, odd, growing about as the cube, and not on phi or on time.",
        by_record=by_record,
    )
    named = replace(d.causes[0], share=0.88)
    causes = (named, replace(unknown, share=0.12))
    extended = d.extended
    assert extended is not None
    return changed(
        d,
        causes=causes,
        remainders=(Cause("coulomb_friction", "torque", 3e-5, (), share=0.012),),
        disturbances=disturbances(),
        moved=moved_parameters(d.baseline, extended),
        remaining=what_remains(
            [(c.kind, c.where, c.share) for c in causes],
            d.held_out,
            p_value=0.31,
            test="scores of every effect of the catalogue that is left, family-wise",
        ),
        unexplained=unexplained(view(N=3000)),
        isolability=isolability(),
        undetectable=undetectable(),
        proposals=proposals(),
        calibration=calibration(),
    )


def hostile() -> Diagnosis:
    """Every text a file can bring in is an attack, a very long word, or both."""
    h = HOSTILE
    d = deficient(N=400)
    v = replace(
        d.records[0], name=h, outputs=(h,), output_units=(h,), inputs=(h,), input_units=(h,)
    )
    v = replace(v, states=(h, "p" * 300), state_units=(h, h))
    bad = Estimated(h, 1.0, h, std_error=0.1, note=h)
    e = replace(
        estimate(),
        problem=h,
        method=h,
        parameters=(bad,),
        initial_states=(bad,),
        uncertainty=replace(estimate().uncertainty, assumes=h),
        solver=replace(estimate().solver, status=h),
        fit=Agreement({h: {h: 0.1}}, {h: {h: 50.0}}, {h: Whiteness(0, 20, h)}),
        held_out=Agreement({h: {h: 0.1}}, {h: {h: 50.0}}),
        identifiability=Identifiability(0, 1, 0.0, h),
        units={h: h},
        warnings=(h,),
        origin=Origin((h,), {h: h}, (h,)),
    )
    return changed(
        d,
        problem=h,
        sentence=h,
        causes=(
            Cause(h, h, 0.001, (bad,), (Alternative(h, h, 0.2, h),), 0.5, h, h, {h: {h: bad}}),
            Cause("unknown", h, 0.001, (bad,), description=h),
        ),
        remainders=(Cause(h, h, 0.001, (bad,), share=0.01, description=h),),
        disturbances=(Disturbance(h, 0.1, h, 0.5, 1.0, 0.5),),
        ranking=(
            Ranked(h, h, 0.001, 0.002, 1.0, "named", h),
            Ranked(h, h, 0.001, 0.002, None, h, h),
            Ranked(h, h, 1.0, 1.0, None, "invisible", h),
        ),
        baseline=e,
        extended=e,
        records=(v, replace(v, name="\ud800" + "n" * 400)),
        fitted={"baseline_rmse": {h: 0.1}, "extended_rmse": {h: 0.05}},
        held_out={"baseline_rmse": {h: 0.1}, "extended_rmse": {h: 0.05}, "noise_floor": {h: 0.04}},
        advice=h,
        noise={h: h},
        notes=(h, "javascript:alert(3)", "<!--<script>"),
        provenance=(h, "/" + "very_long_folder_name" * 30),
        settings={h: h},
        versions={h: h},
        sources=(h,),
        moved=(Moved(h, h, 1.0, 2.0, 0.1), Moved("p" * 300, "u" * 300, 1.0, 2.0, None)),
        remaining=Remaining((Explained(h, h, 0.7),), 0.3, {h: 1.2}, 0.04, h, h),
        unexplained=replace(unexplained(view(N=400), h, h, h), sentences=(h,)),
        isolability=isolability(((h, h), ("k" * 300, h), ("offset", "torque"))),
        undetectable=tuple(replace(i, why=h, remedy=h) for i in undetectable(h, h)),
        proposals=tuple(replace(p, name=h, description=h) for p in proposals((h, h))),
        calibration=replace(calibration(h), failures={h: 2}),
    )
