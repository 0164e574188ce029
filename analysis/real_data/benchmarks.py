"""Silverbox, cascaded tanks and a free swing: benchmarks of others against what is named here.

Each study yields its numbers beside their targets; `analysis.real_data` prints them. Targets of the
fits are rms errors of fits with plain scipy, to be reached or beaten.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

import casid
from analysis.common.output import Output
from analysis.common.targets import Target, at_most, equal, near
from analysis.real_data.judgement import causes, few_causes, rms_after
from casid.model.effects.balances.balance_effects import (
    coulomb_friction,
    cubic_stiffness,
    quadratic_damping,
    quadratic_stiffness,
)
from casid.model.effects.balances.flow_laws import power_law
from problems import cascaded_tanks, multiarm_pendulum, silverbox

ONCE = casid.FitSettings(starts=1)


def _fit(
    problem: casid.Problem,
    model: casid.Model,
    data: casid.Experiment | list[casid.Experiment],
    *,
    start: Mapping[str, float] | None = None,
    hold_out: float = 0.0,
) -> casid.Estimate:
    """Another model in the channels of a problem, fitted once."""
    changed = replace(problem, model=model, simulate=None, truth={})
    return casid.identify(changed, data, hold_out=hold_out, settings=ONCE, start=start)


def circuit(folder: Path, out: Output, *, quick: bool) -> Iterator[Target]:
    """Silverbox: 40 000 samples fitted, 10 000 held out; quick: 2000 and 500."""
    problem = silverbox.problem
    data = problem.read(folder / "multisine.csv")
    if quick:
        record = data.record
        data = problem.experiment(record.between(record.t0, record.t0 + 2499.5 * record.Ts))
    linear: dict[Literal["zoh", "foh"], float] = {"zoh": 14.7, "foh": 7.2}
    for hold, wanted in linear.items():
        fit = _fit(problem, silverbox.silverbox_model(hold), data, hold_out=0.2)
        rms = 1000 * next(iter(fit.held_out_rmse.values()))["y"]
        yield near(f"silverbox, {hold}: linear, rms held out", rms, wanted, 0.1, "mV")
    hardening = silverbox.silverbox_model("foh")
    cubic = cubic_stiffness(hardening, "force")
    assert cubic is not None
    hardening = hardening.extend(cubic)
    fit = _fit(problem, hardening, data, hold_out=0.2, start={"k_3": 7e5})
    rms = 1000 * next(iter(fit.held_out_rmse.values()))["y"]
    yield at_most("silverbox, foh: cubic, rms held out", rms, 1.1, "mV")
    smooth = silverbox.silverbox_model("bandlimited")
    for make in (cubic_stiffness, quadratic_stiffness):
        effect = make(smooth, "force")
        assert effect is not None
        smooth = smooth.extend(effect)
    fit = _fit(problem, smooth, data, hold_out=0.2, start={"k_3": 7e5})
    rms = 1000 * next(iter(fit.held_out_rmse.values()))["y"]
    yield at_most("silverbox, band-limited: cubic and quadratic, rms held out", rms, 0.30, "mV")
    d = casid.diagnose(problem, data, hold_out=0.2, **few_causes(2, quick))
    out.report("silverbox", d)
    kinds = [c.kind for c in d.causes]
    met = kinds[:2] == ["hold", "cubic_stiffness"]
    yield causes("silverbox, declared zoh: causes", d, "hold, then cubic_stiffness", met)
    rms = 1000 * rms_after(d.held_out, "y")
    yield at_most("silverbox, declared zoh: extended, rms held out", rms, 0.5, "mV")


def tanks(folder: Path, out: Output, *, quick: bool) -> Iterator[Target]:
    """Cascaded tanks: the linear law, the root, and what the diagnosis says of the former."""
    problem = cascaded_tanks.problem
    data = problem.read(folder / "estimation.csv")
    linear = _fit(problem, problem.model, data).rmse["estimation"]["y"]
    yield near("tanks: linear, rms of the whole record", linear, 1.152, 0.005, "V")
    model = cascaded_tanks.tanks_model(alike=False)
    for state in ("x_1", "x_2"):
        law = power_law(model, state, 1.0)
        assert law is not None
        model = model.extend(law)
    model = model.with_known(exponent_x_1=0.5, exponent_x_2=0.5)
    fit = _fit(problem, model, data, start={"k_1": 0.05, "k_3": 0.08, "k_4": 0.07})
    root = fit.rmse["estimation"]["y"]
    yield near("tanks: square roots, rms of the whole record", root, 0.603, 0.005, "V")
    d = casid.diagnose(problem, data, **few_causes(2, quick))
    out.report("cascaded_tanks", d)
    names = [c.kind for c in d.causes]
    yield equal("tanks: verdict on the linear law", d.verdict, "deficient")
    powers = [p.name for c in d.causes for p in c.parameters if p.name.startswith("exponent")]
    yield causes("tanks: causes", d, "a power of a level among them", bool(powers))
    is_noted = "saturation" in names or any("clipped" in n for n in d.notes)
    yield Target(
        "tanks: overflow at 10 V",
        "saturation" if "saturation" in names else "noted" if is_noted else "not named",
        "saturation named, or a note of the plateau",
        is_noted,
    )


def swing(folder: Path, out: Output, *, quick: bool) -> Iterator[Target]:
    """A free swing in three pieces, from 1.6, 1.2 and 0.9 rad; 100 Hz, but for the first fit."""
    problem = multiarm_pendulum.problem
    names = ["est_1", "est_2", "est_3"]
    whole = [problem.read(folder / f"{n}.csv") for n in names]
    fit = _fit(problem, problem.model, whole[0])
    rms = 1000 * fit.rmse["est_1"]["theta"]
    yield near("swing, 1 kHz: viscous, rms of est_1", rms, 2.01, 0.01, "mrad")
    runs = [problem.experiment(e.record.decimate(10)) for e in whole]
    total: dict[str, float] = {}
    for label, kinds in {
        "viscous": (),
        "viscous and drag": ("drag",),
        "viscous and dry": ("dry",),
        "viscous, drag and dry": ("drag", "dry"),
    }.items():
        model = problem.model
        if "drag" in kinds:
            model = model.extend(quadratic_damping(model, "torque"))
        if "dry" in kinds:
            model = model.extend(coulomb_friction(model, "torque", 0.2))
        start = {"d": 0.01, "d_2": 0.004, "F_c": 0.15} if len(kinds) == 2 else {}
        joint = _fit(problem, model, runs, start=start)
        squares = [r["theta"] ** 2 for r in joint.rmse.values()]
        total[label] = 1000 * float(np.sqrt(np.mean(squares)))
    found = ", ".join(f"{v:.2f}" for v in total.values())
    yield Target(
        "swing, joint: viscous; drag; dry; drag and dry",
        f"{found} mrad",
        "the last below the others: both are there",
        total["viscous, drag and dry"] < 0.75 * min(list(total.values())[:3]),
    )
    d = casid.diagnose(problem, runs, hold_out=0.0, **few_causes(2, quick))
    out.report("multiarm_pendulum", d)
    # Drag by its name, or a force that grows with the cube of the rate.
    named = {c.kind if c.kind != "unknown" else c.description for c in d.causes}
    beside = {a.kind for c in d.causes for a in c.alternatives}
    steep = {"quadratic_damping", "a force that grows with the cube of rate"}
    dry = {"coulomb_friction"}
    met = bool((steep | dry) & named)
    yield causes("swing, joint: causes", d, "damping is not viscous only", met)
    for c in d.causes:
        print(f"     swing, joint: {c.sentence or c.kind}")
    for c in d.causes:
        if (
            c.kind == "coulomb_friction"
        ):  # its size depends on what the growing damping is taken for
            sizes = [*c.by_record.values()] or [{p.name: p for p in c.parameters}]
            clear = min(s["F_c"].value / (s["F_c"].std_error or np.inf) for s in sizes)
            yield Target(
                "swing, joint: dry friction", f"{clear:.2g} standard errors", "> 3", clear > 3
            )
    both = bool(steep & named) and bool(dry & named)
    yield Target(
        "swing, joint: dry friction against damping that grows",
        "both named" if both else "one beside the other" if (steep | dry) & beside else "not both",
        "both named, or one beside the other",
        both or (bool((steep | dry) & named) and bool((steep | dry) & beside)),
    )
