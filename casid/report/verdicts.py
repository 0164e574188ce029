"""Verdicts of results that estimate: may the numbers be used, why, and what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from casid.campaigns.monte_carlo import MonteCarlo
from casid.estimation.estimate import Estimate
from casid.estimation.fit_statistics import POOR
from casid.identifiability.records.practical_result import LARGEST_RELATIVE
from casid.model.quantities import percent_text

GOOD_FIT = 90.0
"""Fit [%] of every output below which a residual that is not known to be white is remarked on; a
heuristic: the rms error is then more than a tenth of the output's standard deviation."""
FEW_RUNS = 0.05
"""Half the interval of the coverage from which a study has too few runs to judge 95 % intervals."""


@dataclass(frozen=True, slots=True)
class Judged:
    """A verdict in plain words.

    Attributes
    ----------
    word, beside : the answer, and what it means.
    look : "adequate", "undecided" or "deficient".
    advice : what to do next.
    """

    word: str
    beside: str
    look: str
    sentence: str
    advice: str


_STATUS_WORDS = {
    "Solve_Succeeded": "converged",
    "Solved_To_Acceptable_Level": "converged to the solver's looser tolerance",
}


def status_words(e: Estimate) -> str:
    """What became of the solver, in words where it converged."""
    if not e.is_converged:
        return f"NOT converged: {e.status}"
    return _STATUS_WORDS.get(e.status, e.status)


def judged_estimate(e: Estimate) -> Judged:
    """Whether an estimate and its error bars may be used, and why.

    The answer is the worst of: convergence, identifiability, fit, suspects of the record, whiteness
    of the residual, size of the error bars. Each says what it is about.
    """
    spoilt = list(_spoilt(e))
    if spoilt:
        sentence, advice = spoilt[0]
        more = "".join(f" {text}" for text, _ in spoilt[1:])
        return Judged("do not use", _USELESS, "deficient", sentence + more, advice)
    doubts = list(_doubts(e))
    fit = _fit_text(e)
    poor = list(_poorly_determined(e))
    if doubts:
        text = " ".join((fit, *(sentence for sentence, _ in (*doubts, *poor))))
        return Judged("use with care", _DOUBTFUL, "undecided", text, doubts[0][1])
    for sentence, advice in poor:
        text = f"{fit} {sentence} The error bars can be used."
        return Judged("imprecise", _IMPRECISE, "undecided", text, advice)
    bars = "The estimates and their error bars can be used"
    if not e.whiteness:
        return Judged("usable", _GOOD, "adequate", f"{fit} {bars}.", _CONFIRM)
    if e.fit.autocorrelated:
        said = f"{fit} The residual is autocorrelated, for which the error bars allow. {bars}."
        return Judged("usable", _GOOD, "adequate", said, _CONFIRM)
    said = f"{fit} The rest is consistent with white noise. {bars}."
    return Judged("usable", _GOOD, "adequate", said, _CONFIRM)


_USELESS = "the numbers mean little"
_DOUBTFUL = "the error bars do not contain every error"
_IMPRECISE = "the error bars are large"
_GOOD = "no test contradicts the estimates"
_CONFIRM = (
    "Confirm the model on another record (--hold-out FILE) before you rely on it, and run "
    "casid diagnose: what is missing need not colour the residual."
)


def _spoilt(e: Estimate) -> Iterator[tuple[str, str]]:
    """Why the values mean nothing, and what to do about each."""
    if not e.is_converged:
        yield (
            f"The solver did not converge ({e.status}): the values are no optimum.",
            "Give better starting values (start=) or more of them (--starts), or fit a shorter "
            "window first.",
        )
    i = e.identifiability
    if i.rank < i.unknowns:
        yield (
            f"The record determines {i.rank} of {i.unknowns} unknowns"
            + (f"; {i.undetermined}." if i.undetermined else "."),
            "Give one of them a known value (--set), or run casid identifiability to find the "
            "sensors and experiments that would determine them.",
        )
    for text in e.suspects:
        yield f"{text[:1].upper()}{text[1:]}.".replace("..", "."), "Correct the channel, fit again."
    poor = [
        f"{output} ({fit:.0f} %{', held out' * is_held_out})"
        for output, (fit, is_held_out) in _fits(e).items()
        if fit <= POOR
    ]
    if poor:
        listed = ", ".join(poor)
        yield (
            f"The model explains next to nothing of {listed}.",
            "Check signs, units and the mapping of the channels; then run casid diagnose to find "
            "what the model is missing.",
        )


def _doubts(e: Estimate) -> Iterator[tuple[str, str]]:
    """Why the error bars are not all there is to say, and what to do about each."""
    coloured = e.fit.coloured
    if coloured:
        listed = "; ".join(f"{k}: {v}" for k, v in coloured.items())
        yield (
            f"The residual is autocorrelated ({listed}): the model or its noise is incomplete. The "
            "error bars allow for coloured noise, but not for the bias due to what the model "
            "lacks.",
            "Run casid diagnose to find what the model is missing.",
        )
    if (coloured or not e.whiteness) and any(v < GOOD_FIT for v, _ in _fits(e).values()):
        yield (
            f"The fit is below {GOOD_FIT:.0f} %: noise, disturbances or a missing effect account "
            "for the rest.",
            "Compare the error with the noise of the sensors, as casid diagnose does.",
        )
    if e.fit.untested:
        yield (
            f"{', '.join(e.fit.untested)}: too few samples to test whether the residual is white. "
            "The error bars hold only if the model is right.",
            "Record more samples, or compare the estimates of several records.",
        )
    bound = [p.name for p in e.parameters if p.bound and p.ends is None]
    if bound:
        yield (
            f"{', '.join(bound)} ended at a bound and has no standard error.",
            "Widen the bound if it is not physical. If it is, something else in the model is "
            "wrong: run casid diagnose.",
        )
    if e.starts_tried > 1 and e.starts_agreeing * 2 <= e.starts_tried:
        yield (
            f"Only {e.starts_agreeing} of {e.starts_tried} starts found this optimum: another may "
            "be better.",
            "Use more starts (--starts), or a shorter window first.",
        )
    if e.warnings and not coloured:
        yield "A warning below affects these numbers.", "Read the warning; it says what to do."


def _poorly_determined(e: Estimate) -> Iterator[tuple[str, str]]:
    """Parameters with large error bars, those left out that may well be zero: their start is."""
    relative = {
        p.name: p.std_error / abs(p.value)
        for p in e.parameters
        if p.std_error is not None and p.value and p.start
    }
    poor = sorted((r, name) for name, r in relative.items() if r > LARGEST_RELATIVE)[::-1]
    if poor:
        sizes = [percent_text(100 * r) if r < 1 else "more than 100 %" for r, _ in poor]
        sizes[0] = f"standard error {sizes[0]} of the value"
        listed = ", ".join(f"{name} ({s})" for s, (_, name) in zip(sizes, poor, strict=True))
        yield (
            f"Poorly determined: {listed}.",
            "Record for longer or with a stronger excitation; casid design PROBLEM --estimate "
            f"{','.join(name for _, name in poor)} finds the best one.",
        )


def _fits(e: Estimate) -> dict[str, tuple[float, bool]]:
    """Output -> its worst fit [%], and whether that is of a held-out part or record."""
    worst: dict[str, tuple[float, bool]] = {}
    for by_record, is_held_out in ((e.nrmse_fit, False), (_held_out_fits(e), True)):
        for by_output in by_record.values():
            for output, fit in by_output.items():
                if math.isfinite(fit) and fit < worst.get(output, (math.inf, False))[0]:
                    worst[output] = fit, is_held_out
    return worst


def _held_out_fits(e: Estimate) -> dict[str, dict[str, float]]:
    """The fit [%] of what was held out, by the larger spread of it and of its fitted record.

    A decay ends at rest: by the spread that is left there, no model explains its end.
    """
    return {
        record: {output: _by_larger_spread(e, record, output) for output in by_output}
        for record, by_output in e.held_out_fit.items()
    }


def _by_larger_spread(e: Estimate, record: str, output: str) -> float:
    held = e.held_out_rmse.get(record, {}).get(output, math.nan), e.held_out_fit[record][output]
    fitted = (part.get(record, {}).get(output, math.nan) for part in (e.rmse, e.nrmse_fit))
    spreads = [rmse / (1 - fit / 100) for rmse, fit in (held, tuple(fitted)) if fit < 100]
    if not spreads or not math.isfinite(held[0]):
        return held[1]
    return max(held[1], 100 * (1 - held[0] / max(spreads)))


def _fit_text(e: Estimate) -> str:
    fits = _fits(e)
    if not fits:
        return "The fit converged."
    listed = ", ".join(
        f"{output} to {fit:.3g} %{' (held out)' * is_held_out}"
        for output, (fit, is_held_out) in fits.items()
    )
    return f"The model reproduces {listed}."


def _misled(biased: list[str], rarely: list[str], lost: str) -> Judged:
    said = [f"The estimates of {', '.join(biased)} are biased."] if biased else []
    if rarely:
        said.append(f"The 95 % intervals of {', '.join(rarely)} contain the truth too rarely.")
    advice = (
        "Do not rely on these error bars. A bias comes from a wrong model, from noise on "
        "measured inputs, or from a nonlinear estimate of little data: look at the histogram; "
        "then try a longer record, another method, or a model that has what is missing."
    )
    return Judged("not reliable", _PROMISE, "deficient", " ".join(said) + lost, advice)


def _mostly_failed(failed: int, runs: int) -> Judged:
    most = (
        f"{failed} of {runs} runs failed: the others show how an estimate errs where there is one, "
        "and most records like these give none."
    )
    advice = "Remedy what the failures say, and run the study again (--force)."
    return Judged("undecided", _PROMISE, "undecided", most, advice)


def judged_study(m: MonteCarlo) -> Judged:
    """Whether the error bars of an estimator keep what they promise."""
    failed, runs = len(m.campaign.failures), m.campaign.runs
    lost = f" {failed} of {runs} runs failed." if failed else ""
    biased = [p.name for p in m.parameters if p.is_misled]
    rarely = [p.name for p in m.parameters if any("too rarely" in r for r in p.remarks)]
    often = [p.name for p in m.parameters if any("too often" in r for r in p.remarks)]
    if biased or rarely:
        return _misled(biased, rarely, lost)
    halves = [
        0.5 * (p.coverage_interval[1] - p.coverage_interval[0])
        for p in m.parameters
        if p.coverage_interval is not None
    ]
    if not halves:
        said_none = "Without the truth of the parameters the intervals cannot be judged."
        advice = "Give the problem its truth (Problem(truth=...)), and run the study again."
        return Judged("undecided", _PROMISE, "undecided", said_none + lost, advice)
    if 2 * failed > runs:
        return _mostly_failed(failed, runs)
    if max(halves) > FEW_RUNS:
        needed = math.ceil(0.95 * 0.05 * (1.96 / 0.03) ** 2)
        few = (
            f"Nothing in {runs} runs contradicts the error bars, but they determine the coverage "
            f"only to within {100 * max(halves):.0f} %."
        )
        return Judged(
            "reliable so far",
            _PROMISE,
            "undecided",
            few + lost,
            f"Run more: {needed} runs determine it to within 3 % (--runs {needed}).",
        )
    wide = f" Those of {', '.join(often)} are wider than they need to be." if often else ""
    slight = [p.name for p in m.parameters if p.is_biased]
    small = f" The bias of {', '.join(slight)} is small beside the spread." if slight else ""
    first = "The" if slight else "The estimates are unbiased and the"
    return Judged(
        "reliable",
        _PROMISE,
        "adequate",
        f"{first} 95 % intervals contain the truth as often as stated, as far as {runs} runs show."
        f"{small}{wide}{lost}",
        "The error bars can be used for records like these.",
    )


_PROMISE = "the error bars of this estimator"
