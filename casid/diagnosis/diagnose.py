"""`diagnose`: the simulation error, its causes, and the gain of including them."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from casid.argument_types import names_wrong_types
from casid.data.arguments import Recorded, experiments_of, in_si
from casid.data.problem import Problem
from casid.diagnosis.advice.recommendation import recommend
from casid.diagnosis.calibration.calibration import Calibration
from casid.diagnosis.calibration.false_alarm_rate import calibrate as run_calibration
from casid.diagnosis.calibration.false_alarm_rate import require_runs
from casid.diagnosis.calibration.null_runs import recipe_of
from casid.diagnosis.diagnosis import Diagnosis, Evidence, Gain, Limits
from casid.diagnosis.evidence.baseline import fit_baseline
from casid.diagnosis.evidence.records.recorded_channels import with_unused_columns
from casid.diagnosis.search.findings import Findings, search_causes
from casid.diagnosis.settings import DiagnosisSettings, Progress, require_settings
from casid.diagnosis.thresholds import BUDGET
from casid.diagnosis.verdict.ended_changes import may_be_over
from casid.diagnosis.verdict.error_bars import without_made_up
from casid.diagnosis.verdict.judgement import Judgement, errs_in_held_out_alone, judge, notes_on
from casid.diagnosis.verdict.not_accepted import refusal_notes
from casid.diagnosis.verdict.resting_held_out import RESTS, refused_at_rest
from casid.diagnosis.verdict.sentences import noise_text
from casid.errors import OutOfTimeError
from casid.estimation.estimate import Origin
from casid.estimation.holdout import Split, split_records
from casid.estimation.nlp.solver import Solver
from casid.estimation.simulation.fit import FitSettings
from casid.estimation.simulation.records.input_gaps import with_gaps_treated
from casid.estimation.simulation.records.signals import clock_inputs
from casid.identifiability.requirement import require_identifiable
from casid.identification.problem_notes import problem_notes
from casid.model.rate_laws import with_balances
from casid.model.written_accelerations import with_written_accelerations
from casid.time_limit import until, wall_clock
from casid.versions import versions

SOURCES = (
    "J. Linder, Indirect System Identification for Unknown Input Problems, Linkoping 2017",
    "D. W. K. Andrews, Econometrica 59 (1991) 817-858: bandwidth of a robust covariance",
    "W. K. Newey, K. D. West, Econometrica 55 (1987) 703-708: robust covariance",
    "J. P. Romano, M. Wolf, Econometrica 73 (2005) 1237-1282: stepwise multiple testing",
    "Q. H. Vuong, Econometrica 57 (1989) 307-333: tests between models that are not nested",
    "R. J. Carroll, D. Ruppert, Transformation and Weighting in Regression, 1988: variance that "
    "grows with the mean",
    "F. X. Diebold, R. S. Mariano, J. Bus. Econ. Stat. 13 (1995) 253-263: predictive accuracy",
    "L. T. Biegler, A. Waechter, Math. Program. 106 (2006) 25-57: Ipopt",
    "J. A. E. Andersson et al., Math. Program. Comput. 11 (2019) 1-36: CasADi",
)
"""Papers behind the methods of a diagnosis."""


@names_wrong_types()
def diagnose(
    problem: Problem,
    experiments: Sequence[Recorded] | Recorded | None = None,
    *,
    hold_out: float | Sequence[Recorded] | Recorded = 0.3,
    false_alarm_rate: float = 0.05,
    max_causes: int = 4,
    without: Collection[str] = (),
    calibrate: int = 0,
    advise: bool = True,
    budget: float | None = None,
    solver: Solver | None = None,
    starts: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find what the model of `problem` is missing in these records.

    Parameters
    ----------
    problem : the model and its channels.
    experiments : records in the problem's channels (SI), or DataFrames with its columns; default
        the problem's own example. A cause has to explain all of them with one size, or is reported
        with the size of each record.
    hold_out : share of each record, at its end, that is not fitted (the simulation continues into
        it), or whole records of their own (their initial state is refitted). 0 fits everything. A
        change at an instant acts in windows of the fitted record, or file; a record on another
        clock neither confirms nor refutes it.
    false_alarm_rate : family-wise, for the whole catalogue.
    max_causes : the search stops there.
    without : kinds that are left out of the catalogue.
    calibrate : null records that the false-alarm rate is measured on, for this problem and these
        records; where it is too high, the records are judged at the level that holds it. 0: none.
    advise : whether experiments that separate tied causes are planned, which takes some seconds.
    budget : seconds that the diagnosis may take; what no time is left for is listed in `not_done`,
        and the verdict is "undecided" where that leaves it open. Default 600, and for `calibrate`
        what it takes.
    solver, starts, seed : of every fit of the whole model: Ipopt, the number of starts that the
        problem states, and the seed of those that are drawn, by default.
    progress : called with a line of text at every step.

    A channel that was probably recorded with the wrong sign is named first, as `sensor_scale`, and
    negated for everything after; the baseline is the model with the record as it is. One that shows
    absolute values (`rectified`) likewise, where the model without them is far from its record.

    Returns
    -------
    Diagnosis
        Verdict "undecided" where the record cannot support an answer at all. A cause of kind
        "unknown" is a misfit that no effect of the catalogue explains; `unexplained` describes it.

    Raises
    ------
    DataError, ModelError, IdentifiabilityError, SolveError
        As `identify`; also for settings that mean nothing, and for a term that probably has the
        wrong sign: no effect follows a record where that makes the model unstable.

    Notes
    -----
    The false-alarm rate assumes residuals that are stationary after whitening, with a correlation
    time that is short compared with the record, and white noise on measured inputs. It is the first
    cause's: a further one must be as significant and improve what was held out. `calibrate`
    measures it on records drawn from the fitted model and its noise.

    Example
    -------
    >>> import casid
    >>> import numpy as np
    >>> m = casid.Model("cooling cup")
    >>> T, tau = m.state("T", "K"), m.parameter("tau", "s", start=100, lower=1)
    >>> m.derivative(T, -T / tau)
    >>> _ = m.output("excess", T, "K")
    >>> noise = 0.1 * np.random.default_rng(1).standard_normal(200)
    >>> excess = 50 * np.exp(-5 * np.arange(200) / 400) + noise
    >>> cup = casid.Record({"excess": excess}, {"excess": "K"}, Ts=5, name="cup")
    >>> casid.diagnose(casid.Problem("cooling cup", m), cup)
    <Diagnosis cooling cup: adequate, no cause>
    """
    # Prepare.
    if not isinstance(hold_out, float | int):
        _, hold_out = in_si(problem, hold_out)
        hold_out = with_gaps_treated(problem.model, hold_out, problem.recorded)
    problem, chosen = in_si(problem, experiments_of(problem, experiments))
    problem = with_unused_columns(problem, chosen)
    model, written = with_written_accelerations(with_balances(problem.model))
    problem = replace(problem, model=model)
    chosen = with_gaps_treated(problem.model, chosen, problem.recorded)
    require_settings(problem, false_alarm_rate, max_causes, without, budget)
    if calibrate:
        require_runs(calibrate)
    stated = frozenset(clock_inputs(problem.model))
    split = replace(split_records(chosen, hold_out), stated=stated)
    starts = problem.starts if starts is None else starts
    settings = DiagnosisSettings(
        false_alarm_rate,
        max_causes,
        without,
        FitSettings(starts=starts, solver=solver, seed=seed),
        progress or (lambda _: None),
        BUDGET.seconds if budget is None else budget,
    )
    if budget is not None:
        ends = settings.began + BUDGET.calibration * budget
        settings = replace(settings, calibration_ends=ends)
    require_identifiable(problem.model, split.fitted, problem=problem, progress=settings.progress)
    # Evidence and search: the baseline, then rounds of candidates.
    found, calibration = _found(problem, split, settings, calibrate)
    # Verdict and advice.
    found, judged, note = _judged_or_whole(problem, found, split, settings)
    notes = [*_notes_on_written(written), *problem_notes(problem, split.fitted), *note]
    diagnosis = _concluded(problem, found, judged, calibration, settings, plan=advise, notes=notes)
    return diagnosis.in_units(found.best_fit.criterion.model.shown_units)


def _found(
    problem: Problem, split: Split, settings: DiagnosisSettings, runs: int
) -> tuple[Findings, Calibration | None]:
    """The findings, at the calibrated level where null records are requested and it differs."""
    found = _searched(problem, split, settings)
    if not runs or found.baseline.why_undecided:
        return found, None
    not_done = found.search.attempts.not_done
    try:
        with until(settings.calibration_ends):
            calibration = _calibrated(problem, found, settings, runs)
    except OutOfTimeError:
        not_done["the calibration"] = None
        return found, None
    if calibration.is_corrected:
        settings.progress(f"repeat at level {calibration.threshold:.2g}")
        again = replace(settings, alpha=calibration.threshold)
        if not math.isfinite(settings.calibration_ends):
            again = replace(again, began=wall_clock())
        found = _searched(problem, split, again)
        not_done = found.search.attempts.not_done
    if calibration.is_interrupted and wall_clock() > settings.calibration_ends:
        not_done[f"{runs - calibration.runs} of the {runs} null records"] = None
    return found, calibration


def _searched(problem: Problem, split: Split, settings: DiagnosisSettings) -> Findings:
    """What was sought and found, without what makes up for a bound alone."""
    return without_made_up(_sought(problem, split, settings))


def _sought(problem: Problem, split: Split, settings: DiagnosisSettings) -> Findings:
    """The baseline fitted, and the causes that it is missing.

    Levels in gaps of inputs that are estimated by the outputs take up a part of what the model is
    missing, and no error bar contains that: causes that are found with them are sought once more
    with levels by the inputs alone, where what the gaps leave is a disturbance. Where levels by the
    outputs leave much that is no noise, they are sought with those by the inputs at once.
    """
    baseline = fit_baseline(problem, split, settings)
    by_inputs = replace(settings, levels_by_outputs=False)
    if baseline.levels and not baseline.why_undecided and baseline.start.noise_absorbs_misfit:
        settings.progress("estimate levels in gaps by the inputs alone: what is left is no gap's")
        return search_causes(problem, fit_baseline(problem, split, by_inputs), by_inputs)
    found = search_causes(problem, baseline, settings)
    is_late = wall_clock() > (settings.began + settings.search_ends) / 2
    if not found.adopted or not found.baseline.levels or is_late:
        return found
    settings.progress("repeat with levels in gaps by the inputs alone")
    held = search_causes(problem, fit_baseline(problem, split, by_inputs), by_inputs)
    return held if held.adopted else found


def _calibrated(
    problem: Problem, found: Findings, settings: DiagnosisSettings, runs: int
) -> Calibration:
    """The false-alarm rate of this very diagnosis, one cause being an alarm."""
    null = partial(
        diagnose,
        max_causes=1,
        without=tuple(settings.without),
        advise=False,
        starts=1,
        solver=settings.fit.solver,
        seed=settings.fit.seed,
    )
    return run_calibration(
        problem,
        recipe_of(found.baseline.split, found.baseline.start, found.base_fit),
        diagnose_null=null,
        alpha=settings.alpha,
        runs=runs,
        seed=settings.fit.seed,
        progress=settings.progress,
    )


def _judged_or_whole(
    problem: Problem, found: Findings, split: Split, settings: DiagnosisSettings
) -> tuple[Findings, Judgement, list[str]]:
    """Findings with their verdict; those of whole records where what was held out alone errs.

    Or where it refuses a change that explains all that was fitted, and may be over there, or where
    it refuses effects although it rests.

    These count where their causes are more, or other ones that leave noise of all of it: the first
    ones fit their part and fail in the rest. A note says then that nothing is held out. The level
    is that of the search, calibrated or not.
    """
    judged = _judged(problem, found, settings)
    if split.apart:
        return found, judged, []
    differs = errs_in_held_out_alone(found, judged) or may_be_over(found, settings.fit)
    rests = not differs and refused_at_rest(found)
    if not (differs or rests):
        return found, judged, []
    settings.progress("diagnose the whole record: what was held out differs from what was fitted")
    try:
        same = replace(settings, alpha=found.search.alpha)
        again = _searched(problem, split_records(split.whole, 0.0), same)
        of_whole = _judged(problem, again, settings)
    except OutOfTimeError:
        return found, judged, []
    if not _explains_more(of_whole, judged):
        return found, judged, []
    note = (
        RESTS
        if rests
        else f"the model that fits the first {100 * float(np.mean(~split.held[0])):.0f} % of each "
        "record fails in what follows: the causes are those of the whole record, and no part is "
        "left to confirm them"
    )
    return again, of_whole, [note]


def _judged(problem: Problem, found: Findings, settings: DiagnosisSettings) -> Judgement:
    """The verdict, which may take what is left of the time."""
    attempts = found.search.attempts
    attempts.ends = max(settings.ends, attempts.ends)
    return judge(problem, found, settings.alpha)


def _explains_more(of_whole: Judgement, of_part: Judgement) -> bool:
    """True of causes of whole records that are more, or others that leave nothing but noise."""
    named, before = ({(c.kind, c.where) for c in of.causes} for of in (of_whole, of_part))
    remainder = of_whole.remainder
    is_all = remainder is not None and remainder.p_value >= remainder.level
    is_other = bool(named) and named != before and is_all
    return len(of_whole.causes) > len(of_part.causes) or is_other


def _concluded(
    problem: Problem,
    found: Findings,
    judged: Judgement,
    calibration: Calibration | None,
    settings: DiagnosisSettings,
    *,
    plan: bool,
    notes: Sequence[str],
) -> Diagnosis:
    """Verdict and advice; `plan` as in `recommend`, `settings` with the requested level.

    `notes` are those on the problem, which come after those on the findings.
    """
    false_alarm_rate = settings.alpha
    advice = recommend(problem, found, judged, plan=plan)
    refused = tuple(refusal_notes(found.search.refused, judged.causes))
    remainder = judged.remainder
    # The noise is that beside the disturbances that are reported.
    beside = remainder.beside if remainder is not None else None
    return Diagnosis(
        problem=problem.name,
        verdict=judged.verdict,
        sentence=judged.sentence,
        causes=judged.causes,
        remainders=judged.remainders,
        ranking=judged.ranking,
        evidence=Evidence(
            judged.baseline,
            judged.extended,
            judged.records,
            noise_text(beside or found.at, is_all=remainder is not None and remainder.is_noise)
            if found.baseline.is_fitted
            else {},
            judged.disturbances,
        ),
        gain=Gain(judged.fitted, judged.held_out, judged.moved, judged.remaining),
        advice=advice.sentence,
        proposals=advice.proposals,
        limits=Limits(
            false_alarm_rate=false_alarm_rate,
            notes=(*advice.notes, *notes_on(problem, found, judged, refused), *notes),
            unexplained=remainder.unexplained if remainder is not None else None,
            isolability=advice.isolability,
            undetectable=advice.undetectable,
            calibration=calibration,
            not_done=tuple(found.search.attempts.not_done),
            not_accepted=refused,
        ),
        origin=Origin(judged.baseline.provenance, versions(), SOURCES),
        settings=_settings_in_words(found, settings.fit, false_alarm_rate),
    )


def _notes_on_written(outputs: Mapping[str, str]) -> list[str]:
    """Notes on accelerations that the model writes as forces; output -> balance."""
    return [
        f"{output} is written as the known forces of the {balance} balance; as an accelerometer "
        "responds to every force, a force that is missing there moves it too"
        for output, balance in outputs.items()
    ]


def _settings_in_words(found: Findings, settings: FitSettings, alpha: float) -> dict[str, str]:
    split = found.baseline.split
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
