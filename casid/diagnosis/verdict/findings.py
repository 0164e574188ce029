"""What a diagnosis finds, before it is put into words: fits, adopted causes, and what is left."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from casid.data.problem import Problem
from casid.data.record import Experiment
from casid.diagnosis.evidence.prewhitening import Weighing, Weighted
from casid.diagnosis.evidence.spoilt_samples import Spoilt, without_spoilt
from casid.diagnosis.search.candidates import Adopted
from casid.diagnosis.search.joint_refit import std_error
from casid.diagnosis.search.reconsideration import reconsidered
from casid.diagnosis.search.record_specific import Specific, record_specific
from casid.diagnosis.search.rounds import Progress, Search
from casid.diagnosis.search.selection import adopt_causes
from casid.diagnosis.verdict.sufficiency import (
    fit_in_vain,
    unweighed,
    usable_beside,
    why_silent,
    why_undecided,
)
from casid.errors import SolveError
from casid.estimation.holdout import Split
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.identification.wrong_signs import WrongSign, in_short_order, negated_split, wrong_sign


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Everything that a report of the diagnosis is made of.

    Attributes
    ----------
    split : the records as they were judged, spoilt samples marked missing and a wrong sign turned.
    recorded : the same with the sign as it was recorded.
    start, at : the model as it is and as extended, under the noise found there.
    base_fit, extended_fit : simulation-error fits of both; None where nothing was adopted.
    specific : causes whose size differs from record to record.
    """

    split: Split
    recorded: Split
    search: Search
    start: Weighted
    at: Weighted
    base_fit: Fit
    extended_fit: Fit | None
    adopted: tuple[Adopted, ...]
    spoilt: Spoilt
    why_undecided: str
    turned: WrongSign | None
    specific: tuple[Specific, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def best_fit(self) -> Fit:
        """The extended model's fit, or the baseline's."""
        return self.extended_fit or self.base_fit


def find_causes(
    problem: Problem,
    split: Split,
    settings: FitSettings,
    *,
    alpha: float,
    max_causes: int,
    without: Collection[str],
    say: Progress,
) -> Findings:
    """Fit the model, look for what it is missing, and adopt what is borne out."""
    silent = why_silent(problem.model, split)
    if silent:
        return _undecided(problem, split, settings, silent, alpha=alpha, say=say)
    say("fit the model as it is")
    turned = wrong_sign(problem, split.fitted, settings, alpha=alpha)
    as_recorded: Fit | None = None
    if turned is not None:
        say(f"negate {turned.channel}, which probably has the wrong sign")
        as_recorded = _fit_as_recorded(problem, split, settings, turned)
        split = negated_split(split, turned.channel)
    base_fit = fit_model(problem.model, split.fitted, settings, throw=False)
    spoilt, split = without_spoilt(base_fit, split, alpha, without=tuple(without))
    if spoilt.count:
        say(f"leave out {spoilt.count} clipped samples or outliers and fit again")
        base_fit = fit_model(problem.model, split.fitted, settings, start=base_fit.values)
    recorded, notes = usable_beside(recorded_beside(problem, split.fitted), split.apart)
    weighing = Weighing(
        split.fitted, known_noise=problem.noise, solver=settings.solver, seed=settings.seed
    )
    search = Search(
        weighing,
        recorded,
        alpha=alpha,
        max_causes=max_causes,
        without=without,
        effects=problem.effects,
        progress=say,
    )
    say("estimate the noise")
    start = at = weighing.weigh(problem.model, base_fit)
    adopted: list[Adopted] = []
    specific: tuple[Specific, ...] = ()
    extended: Fit | None = None
    undecided = why_undecided(base_fit, at, partial(std_error, start.fit))
    if not undecided:
        if not base_fit.solution.is_converged:
            raise SolveError(
                f"{problem.name}: the model as it is could not be fitted "
                f"({base_fit.solution.status}): {base_fit.solution.mend}"
            )
        adopted, at, extended = adopt_causes(search, at, base_fit, split, settings)
        adopted = reconsidered(search, adopted, start, at)
        if extended is not None and len(split.fitted) > 1:
            say("ask whether one size of each cause explains every record")
            specific, extended, at = record_specific(weighing, adopted, extended, at, settings)
    if turned is not None and as_recorded is not None:
        extended, base_fit = extended or base_fit, as_recorded
    return Findings(
        split=split,
        recorded=split if turned is None else negated_split(split, turned.channel),
        search=search,
        start=start,
        at=at,
        base_fit=base_fit,
        extended_fit=extended,
        adopted=tuple(adopted),
        spoilt=spoilt,
        why_undecided=undecided,
        turned=turned,
        specific=specific,
        notes=notes,
    )


def _undecided(
    problem: Problem,
    split: Split,
    settings: FitSettings,
    why: str,
    *,
    alpha: float,
    say: Progress,
) -> Findings:
    """Nothing can be fitted: a baseline for the report all the same."""
    fit = fit_in_vain(problem.model, split.fitted)
    at = unweighed(fit)
    search = Search(Weighing(split.fitted, solver=settings.solver), {}, alpha=alpha, progress=say)
    return Findings(split, split, search, at, at, fit, None, (), Spoilt(), why, None)


def _fit_as_recorded(
    problem: Problem, split: Split, settings: FitSettings, turned: WrongSign
) -> Fit:
    """The best that is found in short order with the sign as it was recorded."""
    short = in_short_order(settings)
    try:
        return fit_model(problem.model, split.fitted, short, check_rank=False, throw=False)
    except SolveError as error:
        raise SolveError(f"{turned} As recorded: {error}") from error


def recorded_beside(problem: Problem, experiments: Sequence[Experiment]) -> dict[str, str]:
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
