"""The verdict on what was found: causes, errors before and after, and what remains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from casid.data.problem import Problem
from casid.diagnosis.evidence.disturbances import Disturbance
from casid.diagnosis.evidence.records.sufficiency import (
    none_is_known,
    still_inputs,
    weak_parameters,
)
from casid.diagnosis.evidence.whitening.holding_bounds import held_beyond_chance
from casid.diagnosis.evidence.whitening.robust_errors import std_error
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.findings import Findings
from casid.diagnosis.verdict.cause import NO_DOUBTS, Cause, Doubts, Ranked, Verdict
from casid.diagnosis.verdict.error_bars import bars_of, extended_bars, unknown_sizes
from casid.diagnosis.verdict.extended_model import extended_model
from casid.diagnosis.verdict.gain import (
    Errors,
    bounds_met,
    chance_over_floor,
    errors_of,
    unlike_under_disturbance,
    views,
)
from casid.diagnosis.verdict.held_out_failures import (
    failing_where_held_out,
    other_clocks,
    unlike_where_held_out,
)
from casid.diagnosis.verdict.not_accepted import with_refusal_reasons
from casid.diagnosis.verdict.ranking import ranking
from casid.diagnosis.verdict.remainder import (
    Moved,
    NoiseFound,
    Remaining,
    moved_parameters,
    over_floors,
    what_remains,
)
from casid.diagnosis.verdict.reported_causes import (
    causes_of,
    remainders_of,
    with_the_sign,
    with_the_sizes,
)
from casid.diagnosis.verdict.sentences import verdict_sentence
from casid.diagnosis.verdict.taken_as_exact import taken_as_exact
from casid.diagnosis.verdict.tested_remainder import Remainder, described, tested_remainder
from casid.diagnosis.verdict.unknown_cause import (
    with_a_doubt,
    with_the_unknown,
    with_the_unnamed_alternative,
)
from casid.diagnosis.verdict.unnamed_alternatives import unnamed_alternatives
from casid.estimation.estimate import Estimate, RecordView
from casid.estimation.fit_statistics import poor_fit_text, poor_outputs
from casid.estimation.holdout import validation
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.record_agreement import disagreements
from casid.estimation.simulation_estimate import channel_notes, estimate_of


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """The verdict with its reasons.

    Attributes
    ----------
    fitted, held_out : RMS errors before and after, and the noise floor, see `Diagnosis`.
    doubts : what contradicts the model although no cause was found for it.
    remainder : the test of the residual, and its description.
    """

    verdict: Verdict
    sentence: str
    why_undecided: str
    causes: tuple[Cause, ...]
    remainders: tuple[Cause, ...]
    ranking: tuple[Ranked, ...]
    baseline: Estimate
    extended: Estimate | None
    records: tuple[RecordView, ...]
    fitted: Errors
    held_out: Errors
    moved: tuple[Moved, ...]
    remaining: Remaining | None
    remainder: Remainder | None
    doubts: Doubts = NO_DOUBTS

    @property
    def disturbances(self) -> tuple[Disturbance, ...]:
        """Disturbances in the residual, where it is nothing else."""
        return self.remainder.disturbances if self.remainder is not None else ()


def judge(problem: Problem, found: Findings, false_alarm_rate: float) -> Judgement:
    """Name the causes, compute how much they explain, and decide."""
    start, baseline = found.baseline, _baseline(problem, found)
    extended = _extended(problem, found, baseline)
    last = extended or baseline
    remainder = _tested(found)
    disturbances = remainder.disturbances if remainder is not None else ()
    # Causes found under a disturbance explain what it leaves.
    is_disturbed = bool(disturbances) or bool(found.adopted and found.at.noise.spectra)
    fitted, held = errors = _errors(found, with_disturbances=is_disturbed)
    part = held if held.get("extended_rmse") else fitted
    # What is held out has another disturbance in it, but one that its past predicts.
    is_random = is_disturbed and predicts_held_out(found, remainder)
    named = causes_of(found, last, problem.columns())
    poor = _left_to_disturbances(found, disturbances, last)
    remaining = _remaining(
        found,
        _with_the_sign(found, named),
        errors,
        last,
        remainder,
        false_alarm_rate,
        is_random=is_random,
        is_poor=bool(poor),
    )
    causes, remainder = _with_what_has_no_name(
        problem, found, named, remainder, remaining, is_disturbed=is_disturbed
    )
    failing = failing_where_held_out(found, *errors, extended, remainder)
    causes = with_a_doubt(_with_the_sign(found, causes), failing)
    causes = with_refusal_reasons(causes, found.search.refused)
    beside = remainder.beside if remainder is not None and not causes else None
    unlike = unlike_where_held_out(found, fitted, held, baseline, beside)
    why, bounds = _undecided(problem, found, beside, unlike, disturbances)
    doubts = _doubts(found, remainder, bounds, poor, failing if causes else unlike)
    verdict: Verdict = "deficient" if causes else "undecided" if why else "adequate"
    untested = start.why_undecided
    return Judgement(
        verdict=verdict,
        sentence=verdict_sentence(
            verdict, causes, part, why, problem, disturbances, untested, doubts
        ),
        why_undecided=why,
        causes=tuple(causes),
        remainders=remainders_of(found),
        ranking=ranking(found.search, found.adopted, causes),
        baseline=baseline,
        extended=extended,
        records=views(
            found.base_fit, found.extended_fit, start.split, start.recorded, start.negated
        ),
        fitted=fitted,
        held_out=held,
        moved=moved_parameters(baseline, extended) if extended is not None else (),
        remaining=remaining if extended is not None or remainder is not None else None,
        remainder=remainder,
        doubts=doubts,
    )


def _baseline(problem: Problem, found: Findings) -> Estimate:
    """The estimate of the model without causes; without input bias if it is the final model."""
    own = found.corrected if found.extended_fit is None else None
    fit = own.fit if own is not None else found.base_fit
    valid = validation(fit, found.baseline.recorded)
    return estimate_of(problem, fit, valid, bars=bars_of(fit, own))


def _tested(found: Findings) -> Remainder | None:
    """The remainder, tested; None where the diagnosis is undecided from the start."""
    if found.baseline.why_undecided:
        return None
    found.search.progress("test the residual")
    test = partial(tested_remainder, found.at, found.search, found.adopted)
    return found.search.attempts.attempt("the test of the remainder", test)


def _extended(problem: Problem, found: Findings, baseline: Estimate) -> Estimate | None:
    """The estimate of the extended model; None where nothing was adopted."""
    fit, split = found.extended_fit, found.baseline.split
    if fit is None:
        return None
    extended = estimate_of(problem, fit, validation(fit, split), bars=extended_bars(found))
    if extended.model is None:
        return extended
    return replace(extended, model=extended_model(found, extended.model, baseline.model))


def predicts_held_out(found: Findings, remainder: Remainder | None) -> bool:
    """False where the held-out errors of a model under a disturbance exceed the fitted ones.

    A law that is valid in the fitted part alone leaves an error there that a small disturbance
    absorbs, and a large one in what was held out.
    """
    at = _beside(found, remainder)
    return not found.adopted or at.unbiased is None or _is_predicted(found, at)


def _beside(found: Findings, remainder: Remainder | None) -> Weighted:
    """The last model, under a disturbance where one explains what it leaves."""
    return (remainder.beside if remainder is not None else None) or found.at


def _is_predicted(found: Findings, at: Weighted) -> bool:
    """True if a model under a disturbance is seen to predict what was held out as it should."""
    split = found.baseline.split
    if at.unbiased is None or split.judging(at.unbiased.criterion.model).is_empty:
        return False
    far = partial(unlike_under_disturbance, found, at)
    return found.search.attempts.attempt("the comparison with what was held out", far) == ""


def errs_in_held_out_alone(found: Findings, judged: Judgement) -> bool:
    """True where the last model, with causes or without, fits what was fitted to the noise alone.

    What sets in where a record is held out is in no part that was fitted.
    """
    is_judged = not (found.baseline.why_undecided or found.baseline.split.is_empty)
    if not is_judged or judged.remainder is None or judged.verdict == "adequate":
        return False
    return bool(judged.doubts.held_out)


def _remaining(
    found: Findings,
    causes: Sequence[Cause],
    errors: tuple[Errors, Errors],
    estimate: Estimate,
    remainder: Remainder | None,
    false_alarm_rate: float,
    *,
    is_random: bool,
    is_poor: bool,
) -> Remaining | None:
    """The share that the causes explain, and whether the remainder is noise or at least random."""
    fitted, held = errors
    part = fitted if is_random or not held.get("extended_rmse") else held
    chance: dict[str, float] = {}
    if part is held:
        fit, floor = found.best_fit, part["noise_floor"]
        split = found.baseline.split.judging(fit.criterion.model)
        of = partial(chance_over_floor, fit, estimate.covariance, found.at, split, floor)
        attempt = found.search.attempts.attempt
        chance = attempt("what chance gives to the held-out error", of) or {}
    return what_remains(
        [(c.kind, c.where, c.share) for c in causes],
        part,
        p_value=remainder.p_value if remainder is not None else None,
        test="test of the residual (spectrum, dependence on states and inputs, change in time)",
        false_alarm_rate=remainder.level if remainder is not None else false_alarm_rate,
        noise=NoiseFound(
            estimate.fit.coloured,
            is_random=is_random and remainder is not None and bool(remainder.disturbances),
            is_poor=is_poor,
            is_of_inputs=_has_input_noise(found.at),
            chance=chance,
            held_out=over_floors(held) if part is fitted else {},
            is_predicted=is_random and _is_predicted(found, _beside(found, remainder)),
        ),
        descriptions={(c.kind, c.where): c.description for c in causes},
    )


def _has_input_noise(at: Weighted) -> bool:
    """True if noise of a measured input is in the noise model: it moves the outputs."""
    inputs = at.model.inputs
    return any(
        sd > 0 and source in inputs and inputs[source].kind == "measured"
        for source, sd in at.full.source_sd.items()
    )


def _doubts(
    found: Findings,
    remainder: Remainder | None,
    bounds: Mapping[str, str],
    poor: tuple[str, ...],
    held_out: str,
) -> Doubts:
    """The doubts: contradictions of the model, named or not."""
    weigh = None if found.corrected is None else found.corrected.weigh
    apart = disagreements(found.best_fit, weigh) if not found.baseline.why_undecided else []
    is_more = (
        remainder is not None and remainder.p_value < remainder.level and not remainder.disturbances
    )
    return Doubts(is_more, tuple(apart), bounds, poor, held_out)


def _left_to_disturbances(
    found: Findings, disturbances: Sequence[Disturbance], estimate: Estimate
) -> tuple[str, ...]:
    """Outputs that a disturbance moves, and the recorded inputs hardly.

    It stands for whatever the model has wrong there. Without inputs a model has nothing else.
    """
    is_driven = any(u.kind in {"measured", "known"} for u in found.at.model.inputs.values())
    if not is_driven or not any(d.is_dominant for d in disturbances):
        return ()
    return tuple(poor_outputs(estimate.fit.nrmse))


def _undecided(
    problem: Problem,
    found: Findings,
    beside: Weighted | None,
    unlike: str,
    disturbances: Sequence[Disturbance],
) -> tuple[str, dict[str, str]]:
    """Why the records support no answer, and the bounds that forbid one.

    What a disturbance moves is no error of the model, and holds no parameter at its bound: they are
    those of the model `beside` it, where it has a spectrum of its own. Nor does what noise moves.
    """
    absorbs = found.at.noise_absorbs_misfit
    bounds = _bounds_beyond_chance(problem, found.best_fit, None if absorbs else found.at.fit)
    if beside is not None and beside.unbiased is not None:
        near = {n: said for n, said in bounds.items() if _is_near_bound(beside.unbiased, n)}
        bounds = near | _bounds_beyond_chance(problem, beside.unbiased, beside.unbiased)
    why = _why_undecided(found, unlike, beside, disturbances)
    # A fit that is held at a bound leaves a large error, and says what to do about it.
    if why and not (bounds and why == found.baseline.why_doubtful):
        return why, {}
    still = still_inputs(found.base_fit.criterion)
    if not bounds:
        # A disturbance explains whatever an input did that is recorded as standing still.
        is_random = bool(still and disturbances)
        return f"a disturbance explains what was measured{still}" if is_random else "", bounds
    return f"the fit holds {' and '.join(bounds.values())}{still}", bounds


def _bounds_beyond_chance(problem: Problem, fit: Fit, under: Fit | None) -> dict[str, str]:
    """The bounds that a fit met, of those which hold the same fit `under` noise beyond chance.

    All, where that noise is None: a noise model that absorbs misfit is no measure of chance.
    """
    met = bounds_met(problem, fit)
    beyond = met if under is None else held_beyond_chance(under)
    return {name: said for name, said in met.items() if name in beyond}


def _is_near_bound(fit: Fit, name: str) -> bool:
    """True if a bound of a parameter is within two standard errors of its estimate."""
    i = fit.criterion.names.index(name)
    v = fit.criterion.variables[i]
    distance = min(abs(fit.x[i] - v.lower), abs(v.upper - fit.x[i]))
    return not distance > 2 * std_error(fit, name)


def _errors(found: Findings, *, with_disturbances: bool) -> tuple[Errors, Errors]:
    """The errors by `errors_of`, None for a model that was not fitted."""
    if not found.baseline.is_fitted:
        return {}, {}
    return errors_of(found, with_disturbances=with_disturbances)


def _with_the_sign(found: Findings, causes: list[Cause]) -> list[Cause]:
    """The causes, with a wrong sign first where there is one, or absolute values."""
    negated, sizes = found.baseline.negated, found.baseline.rectified
    if negated is not None:
        return with_the_sign(negated, causes, found.base_fit, found.best_fit)
    if sizes is not None:
        return with_the_sizes(sizes, causes, found.base_fit, found.best_fit)
    return causes


def _why_undecided(
    found: Findings, unlike: str, beside: Weighted | None, disturbances: Sequence[Disturbance]
) -> str:
    """Why the records support no answer.

    A doubtful fit is explained by a disturbance beside which a parameter is known. Beside one that
    leaves none, any model would do.
    """
    start, at = found.baseline, beside or found.at
    why = start.why_undecided or unlike
    if why or not start.why_doubtful:
        return why
    if disturbances and not none_is_known(at, partial(std_error, at.fit)):
        return ""
    return start.why_doubtful


def _with_what_has_no_name(
    problem: Problem,
    found: Findings,
    causes: list[Cause],
    remainder: Remainder | None,
    remaining: Remaining | None,
    *,
    is_disturbed: bool,
) -> tuple[list[Cause], Remainder | None]:
    """The causes with one of kind "unknown" where they leave much, or functions explain more.

    A parameter held at its bound leaves misfit of its own: it is named first.
    """
    is_something = remainder is not None and remainder.unexplained is not None
    if is_something and (causes or not bounds_met(problem, found.best_fit)):
        assert remainder is not None
        causes = with_the_unknown(
            causes, remainder, remaining, found.search.refused, is_disturbed=is_disturbed
        )
    compare = partial(_compared_with_functions, found, causes, remainder)
    what = "the comparison with functions outside the catalogue"
    return found.search.attempts.attempt(what, compare) or (causes, remainder)


def _compared_with_functions(
    found: Findings, causes: list[Cause], remainder: Remainder | None
) -> tuple[list[Cause], Remainder | None]:
    """The causes, if they explain the misfit no worse than functions outside the catalogue.

    A remainder without a name beside them says that they are not all, or not the right ones.
    """
    if remainder is None or any(a.candidate.effect.kind == "unknown" for a in found.adopted):
        return causes, remainder
    found.search.progress("compare the causes with functions outside the catalogue")
    start = found.baseline.start
    rivals = unnamed_alternatives(found.search, start, found.at, found.adopted)
    if not rivals:
        return causes, remainder
    best = rivals[0]
    if not best.is_better:
        return with_the_unnamed_alternative(causes, best), remainder
    named = [c for c in causes if c.kind != "unknown"]
    whole = described(start, found.search, remainder.level, remainder.p_value)
    return with_the_unnamed_alternative(named, best, whole), whole


def notes_on(
    problem: Problem, found: Findings, judged: Judgement, not_accepted: Sequence[str]
) -> tuple[str, ...]:
    """Notes that qualify a diagnosis, `not_accepted` those of `refusal_notes` among them."""
    search, base, negated = found.search, found.baseline, found.baseline.negated
    notes = channel_notes(problem.model, [*base.recorded.whole, *base.recorded.apart])
    notes += base.notes
    if base.is_fitted:
        poor = poor_fit_text((judged.extended or judged.baseline).fit.nrmse)
        notes += [poor] if poor else []
    if not base.why_undecided:
        notes += (base.why_doubtful,) if base.why_doubtful else ()
        notes += judged.doubts.disagreements
        reported = judged.extended or judged.baseline
        switches = {a.candidate.names[0] for a in found.adopted if a.candidate.effect.is_switched}
        errors = partial(std_error, found.at.fit)
        notes += weak_parameters(found.at, errors, reported, without=switches)
        met = bounds_met(problem, found.best_fit)
        by_chance = [said for name, said in met.items() if name not in judged.doubts.bounds]
        if by_chance and not judged.why_undecided:
            notes += (f"the fit holds {' and '.join(by_chance)}, by no more than chance",)
        notes += unknown_sizes(judged.causes, reported)
        notes += other_clocks(found)
    if negated is not None and negated.reference:
        notes.append(
            f"the sign of {negated.channel} was determined with instruments from "
            f"{negated.reference}: negated, Hansen's J falls to {100 * negated.left:.2g} %; "
            "the simulation error alone, most of it noise or disturbance, does not determine it"
        )
    notes += [
        f"{channel} is the reference of a control loop: it acts through a measured input and is "
        "not an input of its own"
        for channel in search.memory.references or ()
    ]
    if judged.verdict == "deficient":
        notes += taken_as_exact(problem.model)
    notes += not_accepted
    notes += [why for why in search.refitting.left_out.values() if why]
    return (*notes, *search.attempts.notes())
