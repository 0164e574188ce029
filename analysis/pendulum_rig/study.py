"""The laboratory pendulum, made synthetically: stages, joint, noise models, validation, limits.

    python -m analysis.pendulum_rig [--quick] [--out DIR] [--runs N] [--jobs N]

The counterpart of Linder (2017), section 7.5.2, whose records are unpublished: the rig of
problems/pendulum_rig.py with the constants of Tables 7.3 and 7.4. Two loggers are aligned by
knocks, two records of ten minutes are low-passed and thinned to 50 Hz, the cart's inertial unit is
the noisy reference with F_delta = 1. A disturbance torque of 4.5 mN m rms makes validation fits
about as low as the published ones.

- Table 7.5 beside the thesis's, the entries of errata E-15 and E-16 corrected.
- Least squares and both weightings beside it, with the disturbance and with sensor noise alone.
- Figure 7.15: 100 000 draws through the maps (7.36)-(7.38).
- Figure 7.14: the loop simulated from the cart's unit, on records that were not fitted.
- Monte Carlo: coverage of stages, with and without propagation, of the joint estimate, and with an
  uncertain step 1.
- Springs that stiffen, large angles, noise on the reference: how far the linear regression holds.

Targets are derived ones: the truth is known here. Numbers of the thesis stand beside, as what its
measurements gave. Set OMP_NUM_THREADS=1: the matrices are small, and threads fight over them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from analysis.common.figures import Chart
from analysis.common.output import Output
from analysis.common.runner import Run, Study, jobs, runs
from analysis.common.targets import Target, at_most, near
from analysis.pendulum_rig.estimators import (
    FREE,
    INSTRUMENTS,
    MODEL,
    NOISE_MODELS,
    STEPS,
    TRUTH,
    bilinear_offset,
    cloud,
    derived,
    derived_errors,
    joint,
    staged,
)
from analysis.pendulum_rig.records import TORQUE, TS
from analysis.pendulum_rig.robustness import limits, noisy_references
from analysis.pendulum_rig.runs import RigRun, coverages, largest_disagreement, noise_models
from analysis.pendulum_rig.tables import PUBLISHED, PUBLISHED_FITS, PUBLISHED_VALUES
from casid.campaigns.campaign import campaign
from casid.data.experiment import Experiment
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.validation import validate
from casid.identification.moment_estimators import multistage
from problems import pendulum_rig as rig

BASE = {n: p.value or 0.0 for n, p in MODEL.parameters.items()}


def clocks() -> Iterator[Target]:
    """The knocks determine the offset of the two loggers."""
    run = rig.record(rig.Pendulum(), duration=10.0, seed=1)
    found = rig.aligned(run)
    error = found.offset - run.offset
    print(f"clock offset {found.offset:.7f} s, error {1e6 * error:+.2f} us, {found!r}")
    yield at_most(
        "clock offset: error over its standard error", abs(error) / found.std_error, 4.0, ""
    )


def table_7_5(estimates: Mapping[str, MomentEstimate], out: Output) -> Iterator[Target]:
    """Estimates, standard errors and relative errors beside the thesis's."""
    truth = derived(TRUTH)
    rows = []
    print(f"{'':22}{'':9}{'truth':>11}{'estimate':>11}{'std.err.':>10}{'error %':>9}   thesis")
    for name, e in estimates.items():
        errors = derived_errors(e)
        for quantity, value in derived(e.values).items():
            relative = 100 * abs(value / truth[quantity] - 1)
            other = PUBLISHED_VALUES.get(name, {}).get(quantity)
            theirs = PUBLISHED.get(name, {}).get(quantity)
            print(
                f"{name:22}{quantity:9}{truth[quantity]:>11.5g}{value:>11.5g}"
                f"{errors[quantity]:>10.2g}{relative:>9.2f}   "
                + (f"{other:g} ({theirs:g} %)" if other is not None else "--")
            )
            row = {"estimator": name, "quantity": quantity, "truth": truth[quantity]}
            row |= {"estimate": value, "std_error": errors[quantity], "error_percent": relative}
            rows.append(row | {"thesis_estimate": other, "thesis_error_percent": theirs})
        print(
            f"{name:22}{'d, k':9}{'':11}{e['d']:>11.4g}, {e['k']:.4g}; moments p = "
            f"{e.propagated.p_value:.2g}, {sum(s.iterations for s in e.stages)} iterations"
        )
        load = ("m", "z_m", "m z_m", "m z_m^2")
        values = derived(e.values)
        farthest = max(abs(values[q] - truth[q]) / errors[q] for q in load)
        what = f"{name}: farthest of m, z_m and products from truth"
        yield at_most(what, farthest, 3.0, "std. errors")
        off = abs(e["I_x"] - truth["I_x"] - bilinear_offset(TS)["I_x"]) / errors["I_x"]
        what = f"{name}: I_x from the bilinear transform's value"
        yield at_most(what, off, 3.0, "std. errors")
    out.table("table_7_5", rows)


def discretisation(run: RigRun) -> Iterator[Target]:
    """The motion alone, without torque and noise: what 50 Hz leave."""
    clean = run.estimators[0](run.draws.experiments())
    for name, offset in bilinear_offset(TS).items():
        found = clean[name] - TRUTH[name]
        print(f"without noise: {name} {100 * found / TRUTH[name]:+.3f} %")
        yield near(f"without noise: offset of {name}, bilinear", found, offset, 0.25, "")
    for name in ("m", "z_m"):
        found = 100 * abs(clean[name] / TRUTH[name] - 1)
        yield at_most(f"without noise: error of {name}", found, 1.0, "%")


def comparison(run: RigRun, out: Output, *, quick: bool) -> Iterator[Target]:
    """Least squares and weightings, with the disturbance and with sensor noise alone.

    A disturbance torque moves the pendulum and with it the accelerometer: the loop is closed, and
    least squares is biased. Without it standard errors are so small that the bilinear transform's
    offset is the remaining error, and the test of overidentification shows it. A prefilter 1/C, of
    a C that takes the low-pass for a property of the noise, lifts what lies above 6 Hz by 1/|C|:
    instruments have nothing there, the regressors of least squares have their noise.
    """
    offset = bilinear_offset(TS)["I_x"]
    rows = []
    for torque in (run.draws.torque, 0.0):
        experiments = run.draws.experiments(np.random.default_rng(7), torque=torque)
        for name in ("(7.60)",) if quick else ("(7.60)", "(7.58)"):
            found = {
                f"IV, weighting {w}": staged(name, weighting=w, iterations=3)(experiments)
                for w in ("2sls", "optimal")
            }
            settings = MomentSettings(form="linear", noise_model=NOISE_MODELS[name], iterations=3)
            found["least squares"] = multistage(MODEL, experiments, STEPS, settings=settings)
            for kind, e in found.items():
                bounds = [p.name for p in e.estimate.parameters if "bound" in p.note]
                print(
                    f"torque {1e3 * torque:3g} mN m, {name} {kind:24} p = "
                    f"{e.propagated.p_value:8.2g}  "
                    + ", ".join(f"{n} {e[n]:.5g} +- {e.std_error(n):.2g}" for n in FREE)
                    + (f"; at a bound: {', '.join(bounds)}" if bounds else "")
                )
                rows.append(
                    {"torque": torque, "noise_model": name, "estimator": kind}
                    | {n: e[n] for n in FREE}
                    | {f"se {n}": e.std_error(n) for n in FREE}
                    | {"p_value": e.propagated.p_value, "at_bound": " ".join(bounds)}
                )
                if name == "(7.58)":
                    continue
                apart = abs(e["I_x"] - TRUTH["I_x"] - offset) / e.std_error("I_x")
                if torque and kind == "least squares":
                    what = "least squares: I_x from the bilinear transform's value"
                    text = f"{apart:.1f} std. errors"
                    yield Target(what, text, "> 5: the loop is closed", apart > 5)
                elif torque:
                    yield at_most(f"{kind}: I_x from the same", apart, 3.0, "std. errors")
                elif kind != "least squares":
                    p, off = e.propagated.p_value, (e["I_x"] - TRUTH["I_x"]) / e.std_error("I_x")
                    what = f"{kind}, sensor noise alone: offset of I_x"
                    text = f"{off:.0f} std. errors, p = {p:.1g}"
                    yield Target(what, text, "p < 0.01: the moments reject", p < 0.01)
    out.table("comparison", rows)


def clouds(estimates: Mapping[str, MomentEstimate], out: Output) -> Iterator[Target]:
    """Figure 7.15: m against z_m."""
    chart = Chart("Load and its height: N(theta, P) through the maps (Figure 7.15)")
    rows = []
    stages, together = estimates["multi-stage (7.60)"], estimates["joint (7.60)"]
    kinds = (
        ("multi-stage, step 2 taken as exact", stages, False, "#D55E00"),
        ("multi-stage, propagated", stages, True, "#0072B2"),
        ("joint", together, True, "#009E73"),
    )
    for name, e, propagated, colour in kinds:
        m, z_m = cloud(e, propagated=propagated)
        low, middle, high = np.quantile(m, [0.025, 0.5, 0.975])
        bottom, _, top = np.quantile(z_m, [0.025, 0.5, 0.975])
        print(
            f"cloud, {name}: m {middle:.4f}, 95 % {low:.4f} to {high:.4f} kg; z_m "
            f"{bottom:.4f} to {top:.4f} m"
        )
        row = {"cloud": name, "m_std": m.std(), "z_m_std": z_m.std(), "m_low": low}
        rows.append(row | {"m_high": high, "z_m_low": bottom, "z_m_high": top})
        inside = low < TRUTH["m"] < high and bottom < TRUTH["z_m"] < top
        se = e.std_error("m", propagated=propagated)
        yield near(f"cloud of {name}: spread of m", float(m.std()), se, 0.1, "kg")
        if propagated:
            yield Target(f"cloud of {name}: holds the truth", str(inside), "True", bool(inside))
        look: dict[str, Any] = {
            "mode": "markers",
            "marker": {"size": 3, "opacity": 0.35, "color": colour},
        }
        chart.add("Scattergl", name=name, x=z_m[:4000], y=m[:4000], **look)
    cross = {"symbol": "x", "size": 12}
    chart.points([TRUTH["z_m"]], [TRUTH["m"]], "truth", "black", marker=cross)
    chart.x_axis("height of the load z_m [m]")
    chart.y_axis("mass of the load m [kg]")
    out.figure("figure_7_15", chart.figure)
    out.table("clouds", rows)


def validation(
    estimate: MomentEstimate,
    run: RigRun,
    clean: Mapping[str, float],
    out: Output,
    *,
    duration: float,
) -> Iterator[Target]:
    """Figure 7.14, on a motion of the cart that was not fitted."""
    fresh = RigRun(duration, run.seed + 1).draws
    noisy = fresh.experiments(np.random.default_rng(run.seed + 1))
    truth = {**BASE, **TRUTH}
    check = validate(MODEL, estimate.values, noisy, INSTRUMENTS)
    print(check)
    print("fits in %, thesis: " + ", ".join(f"{v}" for v in PUBLISHED_FITS.values()))
    print(f"{'simulated by, at':38}{'with disturbance':>28}{'without':>28}")
    for method in ("bilinear", "foh"):
        for what, values in (("estimate", estimate.values), ("true parameters", truth)):
            fits = [
                " ".join(
                    f"{c.fit:6.1f}"
                    for c in validate(MODEL, values, e, INSTRUMENTS, method=method).channels
                )
                for e in (noisy, fresh.experiments())
            ]
            print(f"{method + ', ' + what:38}{fits[0]:>28}{fits[1]:>28}")
    best = validate(MODEL, {**truth, **clean}, noisy, INSTRUMENTS)
    rows = []
    for (record, channel), published in PUBLISHED_FITS.items():
        c = check[record, channel]
        rows.append({**asdict(c), "thesis_fit": published})
        yield Target(
            f"validation, {record} {channel}: fit",
            f"{c.fit:.1f} %, noise-free estimate {best[record, channel].fit:.1f} %",
            f"at most 3 below; thesis {published} %",
            c.fit >= best[record, channel].fit - 3.0,
        )
        off = abs(c.period_error) * c.period / TS
        yield at_most(f"validation, {record} {channel}: period", off, 1.0 + 1e-9, "samples")
    out.table("validation", rows)
    out.figure("figure_7_14", check.plot())


def monte_carlo(run: RigRun, runs: int, jobs: int, out: Output) -> Iterator[Target]:
    """Coverage over many runs."""
    import joblib

    with joblib.parallel_config(n_jobs=jobs):
        results = campaign(run, runs, seed=3)
    print(results)
    rows = coverages(results, run.centre)
    print(f"{'intervals of':36}{'':6}{'spread':>11}{'std.err.':>11}{'ratio':>7}{'covered':>9}")
    for r in rows:
        print(
            f"{r.kind:36}{r.parameter:6}{r.spread:>11.3g}{r.std_error:>11.3g}{r.ratio:>7.2f}"
            f"{100 * r.covered:>8.1f}%   {100 * r.expected:.1f} % expected of this ratio"
        )
    out.table("coverage", [{**asdict(r), "ratio": r.ratio} for r in rows])
    every = {(r.kind, r.parameter): r for r in rows}
    yield at_most("Monte Carlo: runs that failed", float(len(results.failures)), 0.0, "")
    for kind in ("stages", "joint", "uncertain M, z_g"):
        for n in FREE:
            r = every[kind, n]
            text = f"{100 * r.covered:.1f} % of {r.runs}"
            wanted = "95 % within 4 binomial deviations"
            yield Target(f"{kind}: 95 % intervals of {n} cover", text, wanted, r.is_right)
    for n in ("m", "z_m"):
        r = every["stages, earlier ones exact", n]
        full = every["stages", n]
        yield Target(
            f"step 2 taken as exact: std. error of {n} too small",
            f"{full.std_error / r.std_error:.2f} times, covers {100 * r.covered:.1f} %",
            f">= 1.2 times; {100 * r.expected:.0f} % expected",
            full.std_error / r.std_error >= 1.2,
        )
    r = every["uncertain M, z_g, taken as exact", "k"]
    what = "step 1 taken as exact: std. error of k too small"
    text = f"{r.ratio:.2f} times, covers {100 * r.covered:.1f} %"
    yield Target(what, text, ">= 1.2 times", r.ratio >= 1.2)
    for n in FREE:
        what, most = f"stages and joint, largest distance in {n}", largest_disagreement(results, n)
        yield at_most(what, most, 3.0, "std. errors")


def prefilters(run: RigRun, runs: int, iterations: int, out: Output) -> Iterator[Target]:
    """(7.58) against (7.60) where the truth is known."""
    rows = noise_models(run, runs, iterations=iterations)
    out.table("noise_models", [asdict(r) for r in rows])
    for r in rows:
        print(
            f"(7.58) over (7.60) in step 3, {r.parameter}, {runs} runs: rms error "
            f"{r.spread:.3f}, standard error {r.std_error:.3f}"
        )
        yield at_most(
            f"(7.58) and (7.60), largest distance in {r.parameter}", r.apart, 0.5, "std. errors"
        )


def estimate_all(
    experiments: Sequence[Experiment], *, iterations: int
) -> dict[str, MomentEstimate]:
    """Stages and joint with both noise models."""
    found = {}
    makers: Mapping[str, Callable[..., Any]] = {"multi-stage": staged, "joint": joint}
    for kind, make in makers.items():
        for name in NOISE_MODELS:
            found[f"{kind} {name}"] = make(name, iterations=iterations)(experiments)
    return found


def study(run: Run) -> Iterator[Target]:
    """All parts in turn."""
    out, quick, made = run.output, run.quick, RigRun()
    yield from clocks()
    experiments = rig.experiments(seed=1, torque=TORQUE)
    sizes = {e.record.N for e in experiments}
    yield Target("samples of a record", str(sizes), "{30000}", sizes == {30_000})
    estimates = estimate_all(experiments, iterations=1 if quick else 5)
    yield from table_7_5(estimates, out)
    yield from discretisation(made)
    yield from comparison(made, out, quick=quick)
    yield from clouds(estimates, out)
    stages = estimates["multi-stage (7.60)"]
    clean = made.estimators[0](made.draws.experiments()).values
    yield from validation(stages, made, clean, out, duration=120.0 if quick else 600.0)
    errors = {n: stages.std_error(n) for n in FREE}
    yield from limits(errors, out, duration=300.0 if quick else 600.0, quick=quick)
    yield from monte_carlo(made, run.runs(200, quick=20), run.options.jobs, out)
    if not quick:
        yield from prefilters(made, 12, 2, out)
        yield from noisy_references(out, duration=600.0)


STUDY = Study(study, quick="short sweeps, 20 runs", options=runs(200, quick=20) | jobs(1))
