"""How wrong the simulation is before and after, against the best that is possible."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from casid.arrays import TINY, Array, BoolArray
from casid.data.channel_quality import quantisation_step
from casid.data.problem import Problem
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.comparison.simulation_errors import simulation_errors
from casid.diagnosis.search.findings import Findings
from casid.diagnosis.thresholds import FUNCTIONS, JUDGING, RESIDUAL
from casid.estimation.estimate import RecordView
from casid.estimation.fit_statistics import rms
from casid.estimation.holdout import Split, record_views, simulate_apart, whole_simulation
from casid.estimation.simulation.channels.sensor_dynamics import due_to_earlier_inputs
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import signals_of
from casid.identification.signs_from_simulation import WrongSign


def rmse(
    fit: Fit, reference: Fit, split: Split, limits: dict[str, float], *, held: bool
) -> dict[str, float]:
    """Rms error by output over all records, of those that have a sample there.

    Of an output whose noise grows with its reading, over the noise's relative size at each sample.

    Samples that `reference` clips are left out, and the first samples of its delayed or lagging
    outputs, which depend on inputs before the record.
    """
    outputs = fit.criterion.outputs
    counted: list[BoolArray] = []
    parts: list[Array] = []
    for e in range(len(split.whole)):
        d, y, _ = whole_simulation(fit, split, e)
        _, best, _ = whole_simulation(reference, split, e)
        late = due_to_earlier_inputs(
            reference.criterion.model, d.u, d.Ts, window=split.whole[e].window
        )
        counts = d.used & ~late
        for name, level in limits.items():
            i = outputs.index(name)
            counts[np.abs(best[:, i]) >= FUNCTIONS.at_limit * level, i] = False
        part = split.held[e] if held else ~split.held[e]
        counted.append(counts[part])
        parts.append(np.where(counts, d.errors(y), np.nan)[part])
    if held:
        for experiment in split.apart:
            d, y, _ = simulate_apart(fit, experiment)
            counted.append(d.used)
            parts.append(np.where(d.used, d.errors(y), np.nan))
    is_measured = np.any(np.concatenate(counted), axis=0).tolist()
    errors = zip(outputs, rms(np.concatenate(parts)).tolist(), is_measured, strict=True)
    return {name: error for name, error, measured in errors if measured}


def clipping_limits(fit: Fit) -> dict[str, float]:
    """Clipping levels of the outputs, where the model has them."""
    values = fit.values
    return {s.channel: values[s.parameter] for s in fit.criterion.model.stages if s.kind == "clip"}


def noise_floor(at: Weighted, *, with_disturbances: bool = False) -> dict[str, float]:
    """Rms that the best possible model would leave: output noise and measured inputs' noise.

    Where a disturbance is all that is left, with it. Never less than an output resolves, a step of
    its quantisation over sqrt(12).
    """
    measured = {
        s: float(at.input_sd.get(s, 0.0)) for s in at.full.source_sd if s in at.model.inputs
    }
    noise = at.full if with_disturbances else at.full.quiet(measured)
    floors = np.array([noise.floor(e) for e in range(len(at.criterion.data))])
    weight = np.array([d.N for d in at.criterion.data], dtype=float)
    total = np.sqrt(np.average(floors**2, axis=0, weights=weight))
    found = dict(zip(at.criterion.outputs, total.tolist(), strict=True))
    return {name: max(floor, _resolved(at, i)) for i, (name, floor) in enumerate(found.items())}


def _resolved(at: Weighted, output: int) -> float:
    """Standard deviation of the rounding of an output, 0 where it is not quantised."""
    steps = [quantisation_step(d.y[d.used[:, output], output]) for d in at.criterion.data]
    return min((step or 0.0) for step in steps) / math.sqrt(12)


def chance_over_floor(
    fit: Fit, covariance: Array, at: Weighted, split: Split, floor: Mapping[str, float]
) -> dict[str, float]:
    """The largest RMS error of what was held out, over its floor, that chance alone gives.

    The mean square of the noise there over that of the fitted part is F distributed, each with the
    degrees of freedom of its spectrum. The error dx of the estimates, of which the initial state is
    one, adds the square of (dy/dx) dx: where one direction of dx gives most of it, chi-squared of
    one degree of freedom times its mean, the trace of (dy/dx) P (dy/dx)'. Of records held out as a
    whole, whose initial state is fitted anew, the noise alone counts.

    Parameters
    ----------
    fit, covariance : the model that was simulated, and P of its variables (SI).
    at : with the noise.
    """
    outputs = fit.criterion.outputs
    of_noise = chance_by_noise(fit, at, split)
    if not of_noise:
        return {}
    of_estimates = chance_by_estimates(fit, covariance, split, floor)
    return {o: math.sqrt(of_noise[o] + of_estimates[o]) for o in outputs}


def chance_by_noise(fit: Fit, at: Weighted, split: Split) -> dict[str, float]:
    """The part of the square of `chance_over_floor` that is due to noise; empty without samples."""
    held, fitted = (_counts(fit, split, held=held) for held in (True, False))
    if not held.readings.any():
        return {}
    free = [2 / np.maximum(_spread(at, part) ** 2, TINY) for part in (held, fitted)]
    size = f_distribution.isf(RESIDUAL.held_out_chance, *free)
    return dict(zip(fit.criterion.outputs, size.tolist(), strict=True))


def chance_by_estimates(
    fit: Fit, covariance: Array, split: Split, floor: Mapping[str, float]
) -> dict[str, float]:
    """The part of the square of `chance_over_floor` that is due to the errors of the estimates."""
    outputs = fit.criterion.outputs
    moved = np.zeros(len(outputs))
    for e, mask in enumerate(split.held):
        if not mask.any() or fit.criterion.parts(e) > 1:
            continue
        d = signals_of(fit.criterion.model, split.whole[e])
        slopes = fit.criterion.simulated(fit.x, e, signals=d).jacobian[mask]
        square = np.sum((slopes @ covariance) * slopes, axis=2)
        square = np.sum(np.where(d.used[mask], square, 0.0), axis=0)
        moved += np.nan_to_num(square, nan=0.0, posinf=0.0)
    size = np.array([floor.get(o, 0.0) for o in outputs])
    readings = _counts(fit, split, held=True).readings
    mean = moved / np.maximum(readings, 1) / np.maximum(size**2, TINY)
    share = chi2.isf(RESIDUAL.held_out_chance, 1) * mean
    return dict(zip(outputs, share.tolist(), strict=True))


class _Counts(NamedTuple):
    """Samples of the clock, and readings of each output (ny,), in one part of the records."""

    samples: int
    readings: Array


def _counts(fit: Fit, split: Split, *, held: bool) -> _Counts:
    model = fit.criterion.model
    used = [signals_of(model, e).used for e in split.whole]
    used = [u[m == held] for u, m in zip(used, split.held, strict=True)]
    if held:
        used += [signals_of(model, e).used for e in split.apart]
    every = np.concatenate(used)
    return _Counts(len(every), every.sum(axis=0))


def _spread(at: Weighted, part: _Counts) -> Array:
    """(ny,) relative standard deviation of the mean square of the readings.

    With r the correlation of the noise it is sqrt(2/N sum r^2) of N samples. Of n readings among
    them, at random, n/N of the neighbours of each are there: 2/n (1 + n/N (sum r^2 - 1)).
    """
    whole = at.full.spread(0, max(part.samples, 1))
    fewer = 2 / np.maximum(part.readings, 1) - 2 / max(part.samples, 1)
    return np.asarray(np.sqrt(whole**2 + np.maximum(fewer, 0.0)))


def unlike_held_out(
    found: Findings,
    fitted: Mapping[str, Mapping[str, float]],
    held: Mapping[str, Mapping[str, float]],
    by_estimates: Mapping[str, float],
    of: str = "baseline_rmse",
) -> str:
    """Why what was held out forbids to call the model adequate, or an empty text.

    Few readings, and noise of an input that rings at a resonance, have few independent values: the
    mean square may rise by chance (`chance_by_noise`). The errors of the estimates go on into what
    was held out, and add to it.

    Parameters
    ----------
    by_estimates : what they add to the square of each output over its floor
        (`chance_by_estimates`).
    of : whose errors, those of the model as it is or "extended_rmse".
    """
    base = found.baseline
    judged = base.split.judging(found.best_fit.criterion.model)
    by_chance = chance_by_noise(found.at.fit, found.at, judged)
    for output, error in held.get(of, {}).items():
        inside = fitted[of].get(output, math.nan)
        floor = fitted["noise_floor"][output]
        chance = math.sqrt(by_chance.get(output, 1.0) + by_estimates.get(output, 0.0))
        if error > max(JUDGING.unlike * max(inside, floor), chance * floor):
            shown = found.at.criterion.model.shown_size
            unit = found.at.criterion.model.unit_of(output)
            return (
                f"the fitted part shows no model error, but the simulation of {output} is wrong by "
                f"{shown(output, error):.3g} {unit if unit != '1' else ''}".rstrip()
                + f" where it was not fitted, against {shown(output, inside):.3g} where it was: "
                "diagnose what was held out by itself (--window, or its file)"
            )
    return ""


def unlike_under_disturbance(found: Findings, at: Weighted) -> str:
    """`unlike_held_out` for a model under a disturbance: the innovations are compared.

    Kept in the memory of the search: the verdict, its reasons and its doubts each need it.
    """
    known = found.search.memory.held_out
    if at not in known:
        known[at] = _unlike_innovations(at, found.baseline.split)
    return known[at]


def _unlike_innovations(at: Weighted, split: Split) -> str:
    """How the innovations of what was held out contradict a model under a disturbance, or empty.

    A narrow-band disturbance has few independent samples, so the RMS simulation error differs from
    part to part by chance; the errors that their past does not predict are nearly independent.
    """
    assert at.unbiased is not None
    found = simulation_errors(at.unbiased, split, at.criterion.weights, at.noise)
    if not len(found.continued):
        return ""
    for i, output in enumerate(at.criterion.outputs):
        inside, held = (float(rms(part)[i]) for part in (found.fitted, found.continued))
        if held > JUDGING.unlike * max(inside, 1.0):
            return (
                f"the fitted part shows no model error beside a disturbance, but {output} is "
                f"{held:.2g} times as far from its prediction where it was not fitted: diagnose "
                "what was held out by itself (--window, or its file)"
            )
    return ""


def bounds_met(problem: Problem, fit: Fit) -> dict[str, str]:
    """Physical parameters that the fit holds at a bound -> which, in words."""
    met = {}
    for v in fit.criterion.variables:
        p = problem.model.parameters.get(v.source)
        for side in ("lower", "upper"):
            if p is not None and v.name in getattr(fit.solution, f"at_{side}"):
                end = problem.model.shown(p.name, getattr(p, side))
                unit = problem.model.unit_of(p.name)
                size = f"{end:g}" if unit == "1" else f"{end:g} {unit}"
                met[v.name] = f"{v.name} at its {side} bound ({size})"
    return met


def views(
    base: Fit, extended: Fit | None, split: Split, recorded: Split, turned: WrongSign | None
) -> tuple[RecordView, ...]:
    """Signals for figures; with a wrong sign corrected, the baseline is turned like the record."""
    if turned is None or extended is None:
        return record_views(base, extended, split)
    before, after = record_views(base, None, recorded), record_views(extended, None, split)
    signs = np.array([-1.0 if n == turned.channel else 1.0 for n in before[0].outputs])
    return tuple(
        replace(a, baseline=b.baseline * signs, extended=a.baseline)
        for b, a in zip(before, after, strict=True)
    )


Errors = dict[str, dict[str, float]]


def errors_of(found: Findings, *, with_disturbances: bool = False) -> tuple[Errors, Errors]:
    """RMS errors before and after and the noise floor, of what was fitted and what was held out."""
    base_fit, best_fit, base = found.base_fit, found.best_fit, found.baseline
    recorded, split = (s.judging(best_fit.criterion.model) for s in (base.recorded, base.split))
    limits = clipping_limits(best_fit)
    reference, clipped = (best_fit, limits) if base.negated is None else (base_fit, {})
    fitted = {"baseline_rmse": rmse(base_fit, reference, recorded, clipped, held=False)}
    held = {"baseline_rmse": rmse(base_fit, reference, recorded, clipped, held=True)}
    if found.extended_fit is not None or base.corrupted.count:
        fitted["extended_rmse"] = rmse(best_fit, best_fit, split, limits, held=False)
        held["extended_rmse"] = rmse(best_fit, best_fit, split, limits, held=True)
    floor = noise_floor(found.at, with_disturbances=with_disturbances)
    if with_disturbances:
        # The spectrum of a force is that of what it moves here, to which the fit adapts in part:
        # no better model leaves more than this one does.
        left = fitted.get("extended_rmse") or fitted["baseline_rmse"]
        floor = {o: min(size, left.get(o, size)) for o, size in floor.items()}
    fitted["noise_floor"] = held["noise_floor"] = floor
    return fitted, {} if split.is_empty else held


Part = Mapping[str, Mapping[str, float]]
"""Of one part of the records: "baseline_rmse", "extended_rmse", "noise_floor" by output."""


def decisive(fitted: Part, held_out: Part) -> Part:
    """The errors that count: of the held-out part where there is one, else of the fitted part."""
    return held_out if held_out.get("baseline_rmse") else fitted


def changes(part: Part) -> bool:
    """True if including the causes changes an error by more than its third digit."""
    before, after = part.get("baseline_rmse", {}), part.get("extended_rmse", {})
    return any(not math.isclose(before[o], after[o], rel_tol=1e-3) for o in after if o in before)


def improves(part: Part) -> bool:
    """True if including the causes lowers the squared error, outputs in units of their floor.

    An output without a noise floor counts in units of its error before. An error below its floor
    counts as one at the floor: noise makes it larger or smaller. True, too, where there is nothing
    to compare.
    """
    before, after = part.get("baseline_rmse", {}), part.get("extended_rmse", {})
    floor = part.get("noise_floor", {})
    sums = [0.0, 0.0]
    for output in after:
        scale = floor.get(output) or before.get(output, 0.0)
        if output in before and scale > 0 and math.isfinite(before[output] + after[output]):
            least = floor.get(output, 0.0)
            sums[0] += (max(before[output], least) / scale) ** 2
            sums[1] += (max(after[output], least) / scale) ** 2
    return sums[1] <= sums[0]
