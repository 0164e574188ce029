"""The diagnosis put together from what was found."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from casid.data.problem import Problem
from casid.diagnosis.advice.isolability import isolability
from casid.diagnosis.advice.next_experiment import Advice, Suspect, next_experiment
from casid.diagnosis.advice.undetectable import invisible
from casid.diagnosis.calibration.false_alarm_rate import Calibration
from casid.diagnosis.diagnosis import Cause, Diagnosis, Verdict
from casid.diagnosis.search.joint_refit import std_error
from casid.diagnosis.search.open_set import (
    Left,
    described,
    what_is_left,
    with_the_open_rival,
    with_the_unknown,
)
from casid.diagnosis.search.ranking import ranking
from casid.diagnosis.search.rounds import Progress
from casid.diagnosis.search.unnamed_rivals import open_rivals
from casid.diagnosis.verdict.causes import causes_of, with_the_sign
from casid.diagnosis.verdict.findings import Findings
from casid.diagnosis.verdict.gain import (
    bounds_met,
    clipping_limits,
    noise_floor,
    rmse,
    unlike_held_out,
    views,
)
from casid.diagnosis.verdict.remainder import moved_parameters, what_remains
from casid.diagnosis.verdict.sentences import advice, bound_advice, noise_text, verdict_sentence
from casid.diagnosis.verdict.sufficiency import weak_parameters
from casid.errors import CasidError
from casid.estimation.holdout import validation
from casid.estimation.nlp.nlp import Solver
from casid.estimation.simulation.fit import FitSettings
from casid.estimation.simulation.simulation_estimate import estimate_of, standing_channels
from casid.versions import versions

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


def report(
    problem: Problem,
    found: Findings,
    settings: FitSettings,
    *,
    false_alarm_rate: float,
    calibration: Calibration | None = None,
    advise: bool = True,
    say: Progress = lambda _: None,
) -> Diagnosis:
    """The findings as a `Diagnosis`: errors, causes, what is left, and what to do next."""
    search, turned, spoilt = found.search, found.turned, found.spoilt
    base_fit, extended_fit, best_fit = found.base_fit, found.extended_fit, found.best_fit
    baseline = estimate_of(problem, base_fit, validation(base_fit, found.recorded))
    extended = None
    if extended_fit is not None:
        extended = estimate_of(problem, extended_fit, validation(extended_fit, found.split))
    fitted, held = _errors(found)
    part = held if held.get("extended_rmse") else fitted
    causes = causes_of(
        search, found.adopted, spoilt, extended or baseline, best_fit, found.specific
    )
    left = None
    if not found.why_undecided:
        say("look at what is left")
        left = what_is_left(found.at, search, found.adopted)
    remaining = what_remains(
        [(c.kind, c.where, c.share) for c in causes],
        part,
        p_value=left.p_value if left is not None else None,
        test="kind of the residual: spectrum, dependence on states and inputs, change in time",
        false_alarm_rate=left.level if left is not None else false_alarm_rate,
    )
    bounds = bounds_met(problem, best_fit)
    if left is not None and left.unexplained is not None and not (bounds and not causes):
        # A parameter held at its bound leaves misfit of its own: it is told first.
        causes = with_the_unknown(causes, left, remaining)
    causes, left = _held_against_functions(found, causes, left)
    if turned is not None:
        causes = with_the_sign(turned, causes, base_fit, best_fit)
    why_undecided = found.why_undecided or unlike_held_out(fitted, held)
    if bounds and not why_undecided:
        why_undecided = f"the fit holds {' and '.join(bounds.values())}"
    else:
        bounds = {}
    verdict: Verdict = "deficient" if causes else "undecided" if why_undecided else "adequate"
    table = search.first_table
    planned = _plan(problem, found, causes, say) if advise else None
    if turned is not None:
        text = turned.mend
    elif bounds and verdict == "undecided":
        text = bound_advice(problem, bounds)
    else:
        text = advice(verdict, causes, table, why_undecided)
        if planned is not None:
            text = planned.sentence
    return Diagnosis(
        problem=problem.name,
        verdict=verdict,
        sentence=verdict_sentence(verdict, causes, part, why_undecided, problem),
        causes=tuple(causes),
        ranking=ranking(search, found.adopted, causes),
        baseline=baseline,
        extended=extended,
        records=views(base_fit, extended_fit, found.split, found.recorded, turned),
        fitted=fitted,
        held_out=held,
        advice=text,
        noise=noise_text(found.at),
        false_alarm_rate=false_alarm_rate,
        notes=_notes(problem, found),
        provenance=baseline.provenance,
        settings=_settings(found, settings, false_alarm_rate),
        versions=versions(),
        sources=SOURCES,
        moved=moved_parameters(baseline, extended) if extended is not None else (),
        remaining=remaining if extended is not None or left is not None else None,
        unexplained=left.unexplained if left is not None else None,
        isolability=isolability(table, n_samples=base_fit.criterion.n_samples)
        if table is not None
        else None,
        invisible=invisible(table, problem.model, found.split.fitted)
        if table is not None and advise
        else (),
        proposals=planned.proposals if planned is not None else (),
        calibration=calibration,
    )


Errors = dict[str, dict[str, float]]


def _errors(found: Findings) -> tuple[Errors, Errors]:
    """Rms errors before and after and the noise floor, of what was fitted and what was held out."""
    base_fit, best_fit, split = found.base_fit, found.best_fit, found.split
    limits = clipping_limits(best_fit)
    seen_by, clipped = (best_fit, limits) if found.turned is None else (base_fit, {})
    fitted = {"baseline_rmse": rmse(base_fit, seen_by, found.recorded, clipped, held=False)}
    held = {"baseline_rmse": rmse(base_fit, seen_by, found.recorded, clipped, held=True)}
    if found.extended_fit is not None or found.spoilt.count:
        fitted["extended_rmse"] = rmse(best_fit, best_fit, split, limits, held=False)
        held["extended_rmse"] = rmse(best_fit, best_fit, split, limits, held=True)
    fitted["noise_floor"] = held["noise_floor"] = noise_floor(found.at)
    return fitted, {} if split.is_empty else held


def _held_against_functions(
    found: Findings, causes: list[Cause], left: Left | None
) -> tuple[list[Cause], Left | None]:
    """The causes, if what was named is no worse than functions without a name."""
    if left is None or any(c.kind == "unknown" for c in causes):
        return causes, left
    found.search.progress("hold the causes against functions without a name")
    rivals = open_rivals(found.search, found.start, found.at, found.adopted)
    if not rivals:
        return causes, left
    best = rivals[0]
    if not best.is_better:
        return with_the_open_rival(causes, best), left
    whole = described(found.start, found.search, left.level, left.p_value)
    return with_the_open_rival(causes, best, whole), whole


def _plan(
    problem: Problem, found: Findings, causes: Sequence[Cause], say: Progress
) -> Advice | None:
    """Experiments that separate the first cause whose rivals the record cannot reject."""
    for a in found.adopted:
        named = any(
            (c.kind, c.where) == (a.candidate.effect.kind, a.candidate.effect.where)
            and c.alternatives
            for c in causes
        )
        rivals = [r.candidate for r in a.rivals]
        if not named or not rivals or a.before is None:
            continue
        suspects = [Suspect(c.effect, c.fit.values[c.names[0]]) for c in (a.candidate, *rivals[:3])]
        say("plan the experiment that would tell the tied causes apart")
        try:
            return next_experiment(problem, a.before, suspects, progress=say)
        except CasidError as error:
            say(f"no experiment could be planned: {error}")
    return None


def _notes(problem: Problem, found: Findings) -> tuple[str, ...]:
    search, turned = found.search, found.turned
    notes = standing_channels(problem.model, [*found.recorded.whole, *found.recorded.apart])
    notes += found.notes
    if not found.why_undecided:
        notes += weak_parameters(found.at, partial(std_error, found.at.fit))
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
    notes += [why for why in search.refitting.left_out.values() if why]
    return tuple(notes)


def _settings(found: Findings, settings: FitSettings, alpha: float) -> dict[str, str]:
    split = found.split
    share = f"the last {100 * float(np.mean(split.held[0])):.0f} % of each record"
    out = ", ".join(e.name for e in split.apart) or share
    return {
        "fitted records": ", ".join(e.name for e in split.fitted),
        "held out": "nothing" if split.is_empty else out,
        "family-wise false-alarm rate": f"{alpha:g}",
        "starts": str(settings.starts),
        "solver": (settings.solver or Solver()).name,
        "Runge-Kutta steps a sample": str(found.base_fit.criterion.substeps),
        "seed": str(settings.seed),
    }
