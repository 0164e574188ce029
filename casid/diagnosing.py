"""`diagnose`: what the simulation gets wrong, why, and what naming the cause gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from casid.data import Experiment, Record
from casid.diagnosis import Alternative, Cause, Diagnosis, Ranked, Verdict
from casid.errors import SolveError
from casid.estimate import Estimate, Estimated, RecordView
from casid.holdout import (
    Split,
    held_out_error,
    record_views,
    simulate_apart,
    split_records,
    validation,
    whole_simulation,
    why_no_better,
)
from casid.identifiability.requirement import require_identifiable
from casid.identification import (
    FitSettings,
    estimate_of,
    experiments_of,
    fit_model,
    rms,
    standing_channels,
    versions,
)
from casid.problem import Problem
from casid.scores import INVISIBLE
from casid.search import Adopted, Candidate, Progress, Search, Weighted
from casid.simulation_error import Fit
from casid.solving.nlp import Solver
from casid.spikes import Spikes, find_spikes
from casid.wrong_signs import WrongSign, in_short_order, negated_split, wrong_sign

Array = np.ndarray[Any, Any]

SOURCES = (
    "J. Linder, Indirect System Identification for Unknown Input Problems, Linkoping 2017",
    "D. W. K. Andrews, Econometrica 59 (1991) 817-858: bandwidth of a robust covariance",
    "W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708: robust covariance",
    "J. P. Romano, M. Wolf, Econometrica 73 (2005) 1237-1282: stepwise multiple testing",
    "Q. H. Vuong, Econometrica 57 (1989) 307-333: tests between models that are not nested",
    "F. X. Diebold, R. S. Mariano, J. Bus. Econ. Stat. 13 (1995) 253-263: predictive accuracy",
    "L. T. Biegler, A. Waechter, Math. Program. 106 (2006) 25-57: Ipopt",
    "J. A. E. Andersson et al., Math. Program. Comput. 11 (2019) 1-36: CasADi",
)
"""Papers behind the methods of a diagnosis."""


def diagnose(
    problem: Problem,
    experiments: Sequence[Experiment | Record] | Experiment | Record | None = None,
    *,
    hold_out: float | Sequence[Experiment] | Experiment = 0.3,
    false_alarm_rate: float = 0.05,
    max_causes: int = 4,
    solver: Solver | None = None,
    starts: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find what the model of `problem` is missing in these records.

    Parameters
    ----------
    experiments : records in the problem's channels (SI); default the problem's own example.
    hold_out : share of each record, at its end, that is not fitted (the simulation continues into
        it), or whole records of their own (their initial state is refitted). 0 fits everything.
    false_alarm_rate : family-wise, for the whole catalogue.
    max_causes : the search stops there.
    progress : called with a line of text at every step.

    A channel that was probably recorded with the wrong sign is named first, as `sensor_scale`, and
    negated for everything after; the baseline is the model with the record as it is.

    Returns
    -------
    Diagnosis
        Verdict "undecided" where the record cannot support an answer at all.

    Raises
    ------
    DataError, ModelError, IdentifiabilityError, SolveError
        As `identify`.

    Notes
    -----
    The false-alarm rate assumes residuals that are stationary after whitening, with memory short
    against the record, and white noise on measured inputs.
    """
    say = progress or (lambda _: None)
    chosen = experiments_of(problem, experiments)
    if isinstance(hold_out, Experiment):
        hold_out = [hold_out]
    split = split_records(chosen, hold_out)
    settings = FitSettings(
        starts=problem.starts if starts is None else starts, solver=solver, seed=seed
    )
    require_identifiable(problem.model, split.fitted, problem=problem, progress=say)
    say("fit the model as it is")
    turned = wrong_sign(problem, split.fitted, settings, alpha=false_alarm_rate)
    as_recorded: Fit | None = None
    if turned is not None:
        say(f"negate {turned.channel}, which probably has the wrong sign")
        as_recorded = _fit_as_recorded(problem, split, settings, turned)
        split = negated_split(split, turned.channel)
    base_fit = fit_model(problem.model, split.fitted, settings, throw=False)
    spikes, split = _without_spikes(base_fit, split, false_alarm_rate)
    if spikes:
        say(f"leave out {sum(s.count for s in spikes)} outliers and fit again")
        base_fit = fit_model(problem.model, split.fitted, settings, start=base_fit.values)
    search = Search(
        experiments=split.fitted,
        recorded=_recorded(problem, split.fitted),
        alpha=false_alarm_rate,
        max_causes=max_causes,
        known_noise=problem.noise,
        solver=solver,
        seed=seed,
        progress=say,
    )
    say("estimate the noise")
    at = search.weigh(problem.model, base_fit)
    adopted: list[Adopted] = []
    extended_fit: Fit | None = None
    why_undecided = _undecidable(search, base_fit, at)
    if not why_undecided:
        if not base_fit.solution.is_converged:
            raise SolveError(
                f"{problem.name}: the model as it is could not be fitted "
                f"({base_fit.solution.status}): {base_fit.solution.mend}"
            )
        adopted, at, extended_fit = _search(search, at, base_fit, split, settings)
    if turned is not None and as_recorded is not None:
        extended_fit, base_fit = extended_fit or base_fit, as_recorded
    return _report(
        problem,
        split,
        settings,
        search,
        at,
        base_fit,
        extended_fit,
        adopted,
        spikes,
        why_undecided,
        false_alarm_rate,
        turned,
    )


def _fit_as_recorded(
    problem: Problem, split: Split, settings: FitSettings, turned: WrongSign
) -> Fit:
    """The best that is found in short order with the sign as it was recorded."""
    short = in_short_order(settings)
    try:
        return fit_model(problem.model, split.fitted, short, check_rank=False, throw=False)
    except SolveError as error:
        raise SolveError(f"{turned} As recorded: {error}") from error


# -- the search -----------------------------------------------------------------------------------


def _search(
    search: Search, at: Weighted, base_fit: Fit, split: Split, settings: FitSettings
) -> tuple[list[Adopted], Weighted, Fit | None]:
    """Adopt effects until nothing significant is left that improves what was held out.

    Returns what was adopted, the last model under its noise, and its simulation-error fit.
    """
    adopted: list[Adopted] = []
    extended: Fit | None = None
    once = replace(settings, starts=1)
    error = held_out_error(base_fit, split)
    while len(adopted) < search.max_causes:
        search.progress(f"test every effect (round {len(adopted) + 1})")
        table = search.table(at, [a.candidate for a in adopted])
        if search.first_table is None:
            search.first_table = table
        if not search.is_suspicious(at, table):
            break
        found = search.round(at, table)
        if not found:
            break
        if not adopted:
            search.first_candidates = found
        taken: Adopted | None = None
        for best in _named_first(found):
            p = search.p_value(table, best)
            if p >= search.alpha or best.merit <= 0:
                continue
            fit = fit_model(
                best.model, split.fitted, once, start=best.fit.values, check_rank=False, throw=False
            )
            new_error = held_out_error(fit, split)
            why = why_no_better(error, new_error)
            if why and best.effect.kind != "parameter_jump":
                # The errors that an integrator has gathered say little: judge the end anew as well.
                again = [held_out_error(f, split, anew=True) for f in (extended or base_fit, fit)]
                why = why and why_no_better(*again)
            if why:
                search.refused.append((best, why))
                continue
            taken = Adopted(best, p, search.rivals(best, found))
            error, extended = new_error, fit
            at = search.weigh(best.model, fit, rounds=1)
            break
        if taken is None:
            break
        adopted.append(taken)
    if extended is not None and len(adopted) > 1:
        extended = _eliminated(search, adopted, extended, split, once)
        at = search.weigh(extended.criterion.model, extended, rounds=1)
    return adopted, at, extended


def _eliminated(
    search: Search, adopted: list[Adopted], fit: Fit, split: Split, settings: FitSettings
) -> Fit:
    """Take back, last first, what later causes have made insignificant; refit what is left."""
    for a in reversed(list(adopted)):
        c = a.candidate
        if len(adopted) == 1 or c.effect.test == "clip" or abs(search.wald(fit, c.names[0])) > 2.0:
            continue
        search.refused.append((c, "the other causes together leave nothing for it to explain"))
        adopted.remove(a)
        model = fit.criterion.model.with_known(**{n: 0.0 for n in c.names})
        values = {k: v for k, v in fit.values.items() if k not in c.names}
        fit = fit_model(model, split.fitted, settings, start=values, check_rank=False, throw=False)
    return fit


def _named_first(found: list[Candidate]) -> list[Candidate]:
    """By merit; of those that are the same thing in this model, the one named by convention."""
    order = list(found)
    for i in range(1, len(order)):
        for j in range(i, 0, -1):
            near = order[j - 1].merit - order[j].merit < 2.0
            if near and order[j].effect.priority < order[j - 1].effect.priority:
                order[j - 1], order[j] = order[j], order[j - 1]
    return order


# -- outliers -------------------------------------------------------------------------------------


def _without_spikes(fit: Fit, split: Split, alpha: float) -> tuple[list[Spikes], Split]:
    """Mark isolated spikes of every output as missing, in fitted and held-out parts alike."""
    found: list[Spikes] = []
    for i, channel in enumerate(fit.criterion.outputs):
        residuals = []
        for e in range(len(split.whole)):
            d, y, _ = whole_simulation(fit, split, e)
            residuals.append(np.where(d.used[:, i], d.y[:, i] - y[:, i], 0.0))
        aside = []
        for experiment in split.apart:
            d, y, _ = simulate_apart(fit, experiment)
            aside.append(np.where(d.used[:, i], d.y[:, i] - y[:, i], 0.0))
        spikes = find_spikes(channel, [*residuals, *aside], alpha / 50)
        if spikes is not None:
            found.append(spikes)
            n = len(residuals)
            split = split.mask(channel, spikes.masks[:n], spikes.masks[n:])
    return found, split


# -- judging --------------------------------------------------------------------------------------


def _undecidable(search: Search, fit: Fit, at: Weighted) -> str:
    """Why the record cannot support an answer at all, or an empty text."""
    criterion = fit.criterion
    if criterion.n_samples < 10 * len(fit.x):
        return (
            f"{criterion.n_samples} samples are too few to judge a model with {len(fit.x)} unknowns"
        )
    loudest = 0.0
    for e, d in enumerate(criterion.data):
        y = criterion.simulated(fit.x, e).y
        for i in range(len(criterion.outputs)):
            noise = float(at.noise.output_sd[i])
            loudest = max(loudest, float(np.std(y[d.used[:, i], i])) / max(noise, 1e-300))
    if loudest < 1.0:
        return (
            f"the simulated outputs move by {loudest:.2g} of the noise only: nothing excites the "
            "system enough to show what the model lacks"
        )
    relative = [
        abs(search.std_error(at, v.name) / v.scale)
        for v in at.fit.criterion.variables
        if v.source in criterion.model.parameters
    ]
    if relative and min(relative) > 1.0:
        return "no parameter is known to better than its own size from this record"
    return ""


def _recorded(problem: Problem, experiments: Sequence[Experiment]) -> dict[str, str]:
    """Channels recorded beside the model's that every record has and that move.

    One that is named like something of the model's own (an eliminated input, a state) is what the
    model has already.
    """
    used = {*problem.model.inputs, *problem.model.outputs}
    out = {}
    for name, unit in problem.recorded.items():
        is_own = name in used or problem.model.free_name(name) != name
        if is_own or not all(name in e.record.channels for e in experiments):
            continue
        complete = all(not np.any(e.record.is_missing(name)) for e in experiments)
        if complete and any(np.ptp(e.record[name]) > 0 for e in experiments):
            out[name] = unit
    return out


_SAYS = {
    "quadratic_damping": "damping that grows with the rate squared acts in the {where} balance",
    "coulomb_friction": "dry (Coulomb) friction acts in the {where} balance",
    "cubic_stiffness": "the restoring {where} is not linear: it has a cubic term",
    "offset": "a constant {where} acts on the system",
    "extra_input": "the recorded channel {where} acts on the system, which the model leaves out",
    "parameter_jump": "the parameter {where} changes during the record",
    "scheduled_parameter": "a parameter depends on a channel that the model leaves out: {where}",
    "sensor_bias": "the channel {where} has a constant bias",
    "time_delay": "the channel {where} arrives late",
    "saturation": "the channel {where} is clipped",
    "outliers": "the channel {where} has isolated outliers",
}

_SEPARATES = {
    "quadratic_damping": "free decays from a large and a small amplitude",
    "coulomb_friction": "slow motion and free decays to rest, where dry friction is all there is",
    "cubic_stiffness": "excitation at two clearly different amplitudes",
    "offset": "a stretch at rest, or the same manoeuvre mirrored",
    "extra_input": "a record in which that channel moves while everything else rests",
    "parameter_jump": "a second record with all conditions held, and a note of when loads move",
    "scheduled_parameter": "records in each of which that channel is held, at different values",
    "sensor_bias": "a stretch at rest with the sensor turned over",
    "time_delay": "wide-band excitation, and a knock that all loggers see",
    "saturation": "a record at half the amplitude",
    "outliers": "a look at the logger: cable, range, radio link",
}


def _parameters_of(candidate: Candidate, estimate: Estimate) -> tuple[Estimated, ...]:
    rows = [p for p in estimate.parameters if p.name in candidate.names]
    if candidate.effect.kind == "parameter_jump" and candidate.effect.variant is not None:
        rows.append(Estimated("time", candidate.effect.variant, "s", note="searched"))
    return tuple(rows)


def _report(
    problem: Problem,
    split: Split,
    settings: FitSettings,
    search: Search,
    at: Weighted,
    base_fit: Fit,
    extended_fit: Fit | None,
    adopted: list[Adopted],
    spikes: list[Spikes],
    why_undecided: str,
    alpha: float,
    turned: WrongSign | None,
) -> Diagnosis:
    recorded = split if turned is None else negated_split(split, turned.channel)
    base_held = validation(base_fit, recorded)
    baseline = estimate_of(problem, base_fit, base_held)
    extended = None
    if extended_fit is not None:
        extended = estimate_of(problem, extended_fit, validation(extended_fit, split))
    best_fit = extended_fit or base_fit
    limits = _limits(best_fit)
    seen_by, clipped = (best_fit, limits) if turned is None else (base_fit, {})
    fitted = {"baseline_rmse": _rmse(base_fit, seen_by, recorded, clipped, held=False)}
    held = {"baseline_rmse": _rmse(base_fit, seen_by, recorded, clipped, held=True)}
    if extended_fit is not None or spikes:
        fitted["extended_rmse"] = _rmse(best_fit, best_fit, split, limits, held=False)
        held["extended_rmse"] = _rmse(best_fit, best_fit, split, limits, held=True)
    floor = _noise_floor(search, at)
    fitted["noise_floor"] = floor
    held["noise_floor"] = floor
    if split.is_empty:
        held = {}

    causes = _causes(search, adopted, spikes, extended or baseline, best_fit)
    if turned is not None:
        causes = _with_the_sign(turned, causes, base_fit, best_fit)
    verdict: Verdict = "adequate"
    why_undecided = why_undecided or _unlike(fitted, held)
    bounds = _bounds_met(problem, best_fit)
    if bounds and not why_undecided:
        why_undecided = f"the fit holds {' and '.join(bounds.values())}"
    else:
        bounds = {}
    if causes:
        verdict = "deficient"
    elif why_undecided:
        verdict = "undecided"
    part = held if held.get("extended_rmse") else fitted
    sentence = _sentence(verdict, causes, part, why_undecided, problem)
    notes = standing_channels(problem.model, [*recorded.whole, *recorded.apart])
    if turned is not None and turned.reference:
        notes.append(
            f"the sign of {turned.channel} was told by instruments from {turned.reference}: "
            f"negated, Hansen's J falls to {100 * turned.left:.2g} %; the simulation error alone, "
            "most of it noise or disturbance, does not tell it"
        )
    notes += [
        f"{c.effect.kind} in {c.effect.where} was significant but refused: {why}"
        for c, why in search.refused
    ]
    return Diagnosis(
        problem=problem.name,
        verdict=verdict,
        sentence=sentence,
        causes=tuple(causes),
        ranking=_ranking(search, adopted, causes),
        baseline=baseline,
        extended=extended,
        records=_views(base_fit, extended_fit, split, recorded, turned),
        fitted=fitted,
        held_out=held,
        advice=(
            turned.mend
            if turned is not None
            else _bound_advice(problem, bounds)
            if bounds and verdict == "undecided"
            else _advice(verdict, causes, search, why_undecided)
        ),
        noise=_noise_text(search, at),
        false_alarm_rate=alpha,
        notes=tuple(notes),
        provenance=baseline.provenance,
        settings={
            "fitted records": ", ".join(e.name for e in split.fitted),
            "held out": "nothing"
            if split.is_empty
            else (
                ", ".join(e.name for e in split.apart)
                or f"the last {100 * float(np.mean(split.held[0])):.0f} % of each record"
            ),
            "family-wise false-alarm rate": f"{alpha:g}",
            "starts": str(settings.starts),
            "solver": (settings.solver or Solver()).name,
            "Runge-Kutta steps a sample": str(base_fit.criterion.substeps),
            "seed": str(settings.seed),
        },
        versions=versions(),
        sources=SOURCES,
    )


def _with_the_sign(turned: WrongSign, causes: list[Cause], before: Fit, after: Fit) -> list[Cause]:
    """The wrong sign in front of what was found with it mended."""
    lost = max(before.solution.value - after.solution.value, 0.0)
    share = lost / max(before.solution.value, 1e-300)
    alternatives = tuple(
        Alternative("sensor_scale", c, p, "negated, it fits as well: look at both sensors' axes")
        for c, p in turned.rivals.items()
    )
    first = Cause(
        kind="sensor_scale",
        where=turned.channel,
        p_value=turned.p_value,
        parameters=(Estimated("scale", -1.0, "1", note="the sign alone was tried"),),
        alternatives=alternatives,
        share=share,
        sentence=f"the channel {turned.channel} probably has the wrong sign, a scale of -1",
    )
    return [first, *(replace(c, share=(1 - share) * c.share) for c in causes)]


def _views(
    base: Fit, extended: Fit | None, split: Split, recorded: Split, turned: WrongSign | None
) -> tuple[RecordView, ...]:
    """Signals for figures; with a wrong sign mended, the baseline is turned like the record."""
    if turned is None or extended is None:
        return record_views(base, extended, split)
    before, after = record_views(base, None, recorded), record_views(extended, None, split)
    signs = np.array([-1.0 if n == turned.channel else 1.0 for n in before[0].outputs])
    return tuple(
        replace(a, baseline=b.baseline * signs, extended=a.baseline)
        for b, a in zip(before, after, strict=True)
    )


def _unlike(
    fitted: Mapping[str, Mapping[str, float]], held: Mapping[str, Mapping[str, float]]
) -> str:
    """Why what was held out forbids to call the model adequate, or an empty text."""
    for output, error in held.get("baseline_rmse", {}).items():
        inside = fitted["baseline_rmse"][output]
        floor = fitted["noise_floor"][output]
        if error > 1.5 * max(inside, floor):
            return (
                f"the fitted part hides nothing, but the simulation of {output} is wrong by "
                f"{error:.3g} where it was not fitted, against {inside:.3g} where it was: "
                "diagnose the whole record (--hold-out 0), or that part of it (--window)"
            )
    return ""


def _bounds_met(problem: Problem, fit: Fit) -> dict[str, str]:
    """Physical parameters that the fit holds at a bound -> which, in words."""
    met = {}
    for v in fit.criterion.variables:
        p = problem.model.parameters.get(v.source)
        for side in ("lower", "upper"):
            if p is not None and v.name in getattr(fit.solution, f"at_{side}"):
                met[v.name] = f"{v.name} at its {side} bound ({getattr(p, side):g} {p.unit})"
    return met


def _bound_advice(problem: Problem, bounds: Mapping[str, str]) -> str:
    name = next(iter(bounds))
    p = problem.model.parameters[name.partition("@")[0]]
    return (
        "A wrong sign of a channel drives a parameter to its bound: compare the sensors' axes with "
        "the model's, channel by channel (casid.sign_flips.sign_flips asks each). Where the signs "
        f"are right and the bound is no physics, widen it (lower={p.lower:g}, upper={p.upper:g} of "
        f"{p.name} in the problem file); where it is, give {p.name} that value "
        f"(--set {p.name}=VALUE) and diagnose again."
    )


def _limits(fit: Fit) -> dict[str, float]:
    """Clipping levels of the outputs, where the model has them."""
    values = fit.values
    return {s.channel: values[s.parameter] for s in fit.criterion.model.stages if s.kind == "clip"}


def _rmse(
    fit: Fit, reference: Fit, split: Split, limits: dict[str, float], *, held: bool
) -> dict[str, float]:
    """Rms error by output over all records, on samples that no clipping touches."""
    outputs = fit.criterion.outputs
    parts: list[Array] = []
    for e in range(len(split.whole)):
        d, y, _ = whole_simulation(fit, split, e)
        _, best, _ = whole_simulation(reference, split, e)
        error = np.where(d.used, d.y - y, np.nan)
        for name, level in limits.items():
            i = outputs.index(name)
            error[np.abs(best[:, i]) >= 0.999 * level, i] = np.nan
        parts.append(error[split.held[e]] if held else error[~split.held[e]])
    if held:
        for experiment in split.apart:
            d, y, _ = simulate_apart(fit, experiment)
            parts.append(np.where(d.used, d.y - y, np.nan))
    stacked = np.concatenate(parts)
    if not len(stacked):
        return {}
    return dict(zip(outputs, rms(stacked).tolist(), strict=True))


def _noise_floor(search: Search, at: Weighted) -> dict[str, float]:
    """Rms that the best possible model would leave: output noise and measured inputs' noise."""
    measured = {s: search.input_floor(at, s) for s in at.full.source_sd if s in at.model.inputs}
    quiet = at.full.quiet(measured)
    floors = np.array([quiet.floor(e) for e in range(len(at.criterion.data))])
    weight = np.array([d.N for d in at.criterion.data], dtype=float)
    total = np.sqrt(np.average(floors**2, axis=0, weights=weight))
    return dict(zip(at.criterion.outputs, total.tolist(), strict=True))


def _noise_text(search: Search, at: Weighted) -> dict[str, str]:
    out = {
        name: f"white output noise {sd:.3g} {at.model.outputs[name][1]}"
        for name, sd in zip(at.criterion.outputs, at.full.output_sd.tolist(), strict=True)
    }
    for source, sd in at.full.source_sd.items():
        if sd <= 0:
            continue
        if source in at.model.inputs:
            own, unit = at.input_sd.get(source, 0.0), at.model.inputs[source].unit
            text = f"white input noise {own:.3g} {unit}"
            moves = max(float(np.std(e.record[source])) for e in search.experiments)
            if sd > moves:
                text += (
                    f"; the residual shows more than {source} itself moves ({moves:.3g} {unit}): "
                    f"it is no noise of {source}, but a misfit"
                )
            elif sd > 1.5 * max(own, 1e-300):
                text += f"; the residual shows as much as {sd:.3g}, a disturbance or a misfit"
        else:
            text = f"disturbance {sd:.3g} {at.model.balances[source].unit} a sample"
        out[source] = text
    return out


def _causes(
    search: Search,
    adopted: list[Adopted],
    spikes: list[Spikes],
    estimate: Estimate,
    fit: Fit,
) -> list[Cause]:
    """Causes in the order of their contribution: the misfit that returns when one is taken out."""
    rows: list[tuple[float, Cause]] = []
    losses = search.contributions(adopted, fit)
    outputs, weights = fit.criterion.outputs, fit.criterion.weights
    energy = {s.channel: s.energy * weights[outputs.index(s.channel)] ** 2 / 2 for s in spikes}
    # Few and small spikes are left out of the fit, but are nothing that a user would miss.
    spikes = [s for s in spikes if energy[s.channel] > 0.01 * fit.solution.value]
    total = max(sum(losses) + sum(energy[s.channel] for s in spikes), 1e-300)
    for a, loss in zip(adopted, losses, strict=True):
        effect = a.candidate.effect
        alternatives = tuple(
            Alternative(
                r.candidate.effect.kind,
                r.candidate.effect.where,
                r.p_value,
                _why_alternative(a.candidate, r.candidate),
            )
            for r in a.rivals
        )
        alternatives += tuple(search.aliases(effect))
        rows.append(
            (
                loss,
                Cause(
                    kind=effect.kind,
                    where=effect.where,
                    p_value=a.p_value,
                    parameters=_parameters_of(a.candidate, estimate),
                    alternatives=alternatives,
                    share=loss / total,
                    sentence=_SAYS[effect.kind].format(where=effect.where),
                ),
            )
        )
    for s in spikes:
        rows.append(
            (
                energy[s.channel],
                Cause(
                    kind="outliers",
                    where=s.channel,
                    p_value=s.p_value,
                    parameters=(
                        Estimated("share", s.share, "1"),
                        Estimated("size", s.size, search_unit(search, s.channel)),
                    ),
                    share=energy[s.channel] / total,
                    sentence=_SAYS["outliers"].format(where=s.channel),
                ),
            )
        )
    rows.sort(key=lambda row: -row[0])
    return [cause for _, cause in rows]


def search_unit(search: Search, channel: str) -> str:
    """Unit of a channel in the records searched."""
    return str(search.experiments[0].record.units.get(channel, "1"))


def _why_alternative(best: Candidate, other: Candidate) -> str:
    gap = best.merit - other.merit
    return (
        f"explains the misfit as well (BIC {abs(gap):.1f} {'worse' if gap >= 0 else 'better'}); "
        f"{_SEPARATES[best.effect.kind]} would tell them apart"
    )


def _sentence(
    verdict: Verdict,
    causes: list[Cause],
    part: Mapping[str, Mapping[str, float]],
    why_undecided: str,
    problem: Problem,
) -> str:
    if verdict == "undecided":
        return f"This record cannot tell whether the model is adequate: {why_undecided}."
    if verdict == "adequate":
        return (
            "Nothing in this record contradicts the model: no effect of the catalogue is "
            "significant and improves what was held out."
        )
    text = "; ".join(c.sentence for c in causes)
    gains = []
    for output, before in part.get("baseline_rmse", {}).items():
        after = part.get("extended_rmse", {}).get(output)
        if after is not None:
            unit = problem.model.outputs[output][1]
            gains.append(f"{output} from {before:.3g} to {after:.3g} {unit}")
    gain = f" Naming it brings the rms error of {', '.join(gains)}." if gains else ""
    return f"{text[0].upper()}{text[1:]}.{gain}"


def _advice(verdict: Verdict, causes: list[Cause], search: Search, why_undecided: str) -> str:
    if verdict == "undecided":
        return "Record longer, or excite the system more strongly over a wider band."
    tied = [c for c in causes if c.alternatives]
    if tied:
        c = tied[0]
        others = ", ".join(f"{a.kind} in {a.where}" for a in c.alternatives)
        return f"To tell {c.kind} in {c.where} from {others}: {_SEPARATES[c.kind]}."
    if verdict == "deficient":
        return (
            "Use the extended model; confirm it on a record of its own (--hold-out FILE), best "
            f"with "
            f"{_SEPARATES[causes[0].kind]}."
        )
    invisible = search.invisible()
    if invisible:
        names = ", ".join(sorted({f"{k} in {w}" for k, w in invisible}))
        return f"The model may be used. This set-up cannot show: {names}."
    return "The model may be used for motions like those recorded."


def _ranking(search: Search, adopted: list[Adopted], causes: list[Cause]) -> tuple[Ranked, ...]:
    """The first round's candidates, most significant first, one row a kind and place."""
    named = {(c.kind, c.where) for c in causes}
    tied = {(x.kind, x.where) for c in causes for x in c.alternatives}
    gains = {c.effect.key: c.gain for c in search.first_candidates}
    refused = {c.effect.key: why for c, why in search.refused}
    rows: dict[tuple[str, str], Ranked] = {}
    if search.first_table is None:
        return ()
    for s in sorted(search.first_table.scores, key=lambda s: (s.adjusted, s.p_value)):
        key = s.effect.key
        if key in rows:
            continue
        why = refused.get(key, "")
        if key in named:
            status = "named"
        elif s.visible <= INVISIBLE:
            status = "invisible"
            why = "the baseline's own parameters and initial state absorb it in this record"
        elif key in tied:
            status = "cannot be rejected"
        elif key in gains or s.adjusted < search.alpha:
            status = "rejected"
            why = why or "another candidate explains the misfit better"
        else:
            status = "not significant"
        rows[key] = Ranked(
            s.effect.kind, s.effect.where, s.p_value, s.adjusted, gains.get(key), status, why
        )
    return tuple(rows.values())
