"""`diagnose`: what the simulation gets wrong, why, and what naming the cause gains."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial

from casid.data.problem import Problem, experiments_of
from casid.data.record import Experiment, Record
from casid.diagnosis.calibration.false_alarm_rate import Calibration, require_runs
from casid.diagnosis.calibration.false_alarm_rate import calibrate as run_calibration
from casid.diagnosis.diagnosis import Diagnosis
from casid.diagnosis.search.rounds import Progress
from casid.diagnosis.verdict.diagnosis_builder import report
from casid.diagnosis.verdict.findings import Findings, find_causes
from casid.diagnosis.verdict.sufficiency import require_settings
from casid.estimation.holdout import split_records
from casid.estimation.nlp.nlp import Solver
from casid.estimation.simulation.fit import FitSettings
from casid.identifiability.requirement import require_identifiable


def diagnose(
    problem: Problem,
    experiments: Sequence[Experiment | Record] | Experiment | Record | None = None,
    *,
    hold_out: float | Sequence[Experiment] | Experiment = 0.3,
    false_alarm_rate: float = 0.05,
    max_causes: int = 4,
    without: Collection[str] = (),
    calibrate: int = 0,
    advise: bool = True,
    solver: Solver | None = None,
    starts: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find what the model of `problem` is missing in these records.

    Parameters
    ----------
    experiments : records in the problem's channels (SI); default the problem's own example. A cause
        has to explain all of them with one size, or is reported with the size of each record.
    hold_out : share of each record, at its end, that is not fitted (the simulation continues into
        it), or whole records of their own (their initial state is refitted). 0 fits everything.
    false_alarm_rate : family-wise, for the whole catalogue.
    max_causes : the search stops there.
    without : kinds that are left out of the catalogue.
    calibrate : null records that the false-alarm rate is measured on, for this problem and these
        records; where it is too high, the records are judged at the level that holds it. 0: none.
    advise : whether experiments that separate tied causes are planned, which takes some seconds.
    progress : called with a line of text at every step.

    A channel that was probably recorded with the wrong sign is named first, as `sensor_scale`, and
    negated for everything after; the baseline is the model with the record as it is.

    Returns
    -------
    Diagnosis
        Verdict "undecided" where the record cannot support an answer at all. A cause of kind
        "unknown" is something that no effect of the catalogue explains; `unexplained` tells what is
        known of it.

    Raises
    ------
    DataError, ModelError, IdentifiabilityError, SolveError
        As `identify`; also for settings that mean nothing.

    Notes
    -----
    The false-alarm rate assumes residuals that are stationary after whitening, with memory short
    against the record, and white noise on measured inputs. It is the first cause's: a further one
    must be as significant and improve what was held out. `calibrate` tries it without assuming the
    theory behind it, from the fitted model and its noise.
    """
    say = progress or (lambda _: None)
    chosen = experiments_of(problem, experiments)
    require_settings(problem, false_alarm_rate, max_causes, without)
    if calibrate:
        require_runs(calibrate)
    split = split_records(chosen, [hold_out] if isinstance(hold_out, Experiment) else hold_out)
    settings = FitSettings(
        starts=problem.starts if starts is None else starts, solver=solver, seed=seed
    )
    require_identifiable(problem.model, split.fitted, problem=problem, progress=say)
    find = partial(
        find_causes, problem, split, settings, max_causes=max_causes, without=without, say=say
    )
    found = find(alpha=false_alarm_rate)
    calibration: Calibration | None = None
    if calibrate and not found.why_undecided:
        calibration = _calibrated(
            problem, found, settings, false_alarm_rate, calibrate, without, say
        )
        if calibration.is_corrected:
            say(f"judge again at {calibration.threshold:.2g}")
            found = find(alpha=calibration.threshold)
    return report(
        problem,
        found,
        settings,
        calibration=calibration,
        advise=advise,
        say=say,
        false_alarm_rate=false_alarm_rate,
    )


def _calibrated(
    problem: Problem,
    found: Findings,
    settings: FitSettings,
    alpha: float,
    runs: int,
    without: Collection[str],
    say: Progress,
) -> Calibration:
    """The false-alarm rate of this very diagnosis, one cause being an alarm."""
    null = partial(
        diagnose,
        max_causes=1,
        without=tuple(without),
        advise=False,
        starts=1,
        solver=settings.solver,
        seed=settings.seed,
    )
    return run_calibration(
        problem,
        found.split,
        found.start,
        found.base_fit,
        diagnose_null=null,
        alpha=alpha,
        runs=runs,
        seed=settings.seed,
        progress=say,
    )
