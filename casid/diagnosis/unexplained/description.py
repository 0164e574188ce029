"""The unexplained remainder: where it acts, on what it depends, and when.

For every balance and every output, the force or the sensor error that would explain the residual is
estimated (`missing_force`); the place whose functions explain most for their number comes first.
Tests of the residual decide whether it is more than noise, and of what kind (`residual_tests`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.diagnosis.evidence.residual.force_functions import TIME, is_slope, variables_of
from casid.diagnosis.evidence.residual.linearised_path import Linearised
from casid.diagnosis.evidence.residual.residual_tests import (
    IN_TIME,
    NOISE,
    ResidualTests,
    residual_tests,
)
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import DESCRIPTION
from casid.diagnosis.unexplained.missing_force import (
    Dependence,
    MissingForce,
    missing_force,
    quiet_fit,
)
from casid.diagnosis.unexplained.smoothed_force import ForceSeries, smoothed_force
from casid.diagnosis.unexplained.variables import RAMP, STEP, variable_words
from casid.model.effects.names import either_words
from casid.model.quantities import p_statement, span_text


@dataclass(frozen=True, slots=True, eq=False)
class Occurrence:
    """An interval in which the residual is much larger than elsewhere."""

    record: str
    start: float  # s
    stop: float  # s
    power: float  # over the median stretch's


@dataclass(frozen=True, slots=True, eq=False)
class Unexplained:
    """The description of a misfit that no effect of the catalogue explains."""

    where: str  # balance or output, empty where nothing remains or the place is undetermined
    places: tuple[MissingForce, ...]  # best first
    tests: ResidualTests
    sentences: tuple[str, ...]
    occurrences: tuple[Occurrence, ...]
    goes_with: tuple[tuple[str, float], ...]  # variable, rank correlation of power and its size
    signals: tuple[Mapping[str, Array], ...]  # a record: variable -> (N,), for figures

    @property
    def is_something(self) -> bool:
        """True where the residual is more than noise."""
        return self.tests.verdict != NOISE or bool(self.best and self.best.dependences)

    @property
    def best(self) -> MissingForce | None:
        """The place that explains most."""
        return self.places[0] if self.places else None

    @property
    def sentence(self) -> str:
        """The description in words."""
        return " ".join(self.sentences)

    def to_json(self) -> dict[str, Any]:
        """Words and numbers; the series over time thinned to 1000 points a record."""
        best = self.best
        over_time = best.over_time if best is not None else None
        return {
            "where": self.where,
            "sentence": self.sentence,
            "kind_of_residual": self.tests.to_json(),
            "dependences": [d.to_json() for d in best.dependences] if best is not None else [],
            "independent_of": list(best.independent_of) if best is not None else [],
            "explained": best.explained if best is not None else 0.0,
            "places": [
                {"place": p.place, "score": p.score, "explained": p.explained} for p in self.places
            ],
            "occurrences": [
                {"record": o.record, "start": o.start, "stop": o.stop, "power": o.power}
                for o in self.occurrences
            ],
            "goes_with": [{"variable": v, "rank_correlation": r} for v, r in self.goes_with],
            "over_time": None
            if over_time is None
            else {
                "is_seen": over_time.is_seen,
                "share_seen": over_time.share_seen,
                "variance": over_time.variance,
                "memory": over_time.memory,
                "line": over_time.spectrum.line,
                "spectrum": {
                    "frequency": over_time.spectrum.frequency.tolist(),
                    "density": over_time.spectrum.density.tolist(),
                    "floor": over_time.spectrum.floor.tolist(),
                },
                "series": [_thin(s) for s in over_time.series],
            },
        }


def unexplained(
    at: Weighted,
    experiments: Sequence[Experiment],
    recorded: Mapping[str, str] | None = None,
    *,
    alpha: float = 0.05,
    seed: int = 0,
    tests: ResidualTests | None = None,
) -> Unexplained:
    """Describe what the model, fitted under its noise, leaves unexplained.

    Parameters
    ----------
    recorded : channels beside the model's on which it may depend, name -> unit.
    alpha : rate at which each of the two parts, the tests and the terms, calls noise something.
    tests : of this residual, at this rate, where they are there already.

    Notes
    -----
    Terms are sought in every place: `alpha` is divided among the places. Nothing is described over
    time where the tests and the terms find nothing.
    """
    recorded = dict(recorded or {})
    tests = tests or residual_tests(at, experiments, recorded, alpha=alpha, seed=seed)
    found = _forces_by_place(at, experiments, recorded, alpha=alpha, seed=seed)
    best = found[0]
    signals = _signals(at, experiments, recorded)
    is_something = tests.verdict != NOISE or bool(best.dependences)
    occurrences: tuple[Occurrence, ...] = ()
    goes_with: tuple[tuple[str, float], ...] = ()
    sentences = [f"The remainder is consistent with noise ({p_statement(tests.adjusted)})."]
    where = best.place if best.dependences else ""
    if is_something:
        where = where or _only_balance(at, found)
        occurrences, goes_with = _when(at, tests, signals, alpha)
        in_time = _in_time(found, occurrences, goes_with, is_one=len(experiments) == 1)
        sentences = [*_sentences(where, found, tests, alpha), *in_time]
    return Unexplained(
        where=where,
        places=tuple(found),
        tests=tests,
        sentences=tuple(sentences),
        occurrences=occurrences,
        goes_with=goes_with,
        signals=signals,
    )


def _forces_by_place(
    at: Weighted,
    experiments: Sequence[Experiment],
    recorded: Mapping[str, str],
    *,
    alpha: float,
    seed: int,
) -> list[MissingForce]:
    """What is missing in every balance and output, the place that explains most first.

    Over time, too, in every balance, and in the first place where functions explain it.
    """
    fit = quiet_fit(at)[0]
    places = [*at.model.balances, *at.criterion.outputs]
    missing_in = partial(
        missing_force,
        at,
        experiments,
        recorded=recorded,
        alpha=alpha / len(places),
        seed=seed,
        linearised=Linearised(fit.criterion, fit.x),
    )
    found = [missing_in(place, with_series=place in at.model.balances) for place in places]
    found.sort(key=lambda m: -m.score)  # stable: of equal ones, balances come first
    if found[0].over_time is None and found[0].dependences:
        found[0] = missing_in(found[0].place)
    return found


def _only_balance(at: Weighted, found: Sequence[MissingForce]) -> str:
    """The only balance of a model, where a random force in it explains the spectrum; else empty."""
    if len(at.model.balances) != 1:
        return ""
    balance = next(m for m in found if m.is_balance)
    return balance.place if _is_dynamic(at, balance) else ""


def _is_dynamic(at: Weighted, force: MissingForce) -> bool:
    """True if a random force in the balance explains the spectrum better than an error added to
    any one output.

    Both are processes of two parameters: their likelihoods compare as they are.
    """
    fit, noise = quiet_fit(at)
    assert force.over_time is not None
    rivals = [
        smoothed_force(fit.criterion, fit.x, noise, o, at.input_sd).evidence
        for o in fit.criterion.outputs
    ]
    return force.over_time.evidence > max(rivals) + DESCRIPTION.dynamic


def _signals(
    at: Weighted, experiments: Sequence[Experiment], recorded: Mapping[str, str]
) -> tuple[Mapping[str, Array], ...]:
    fit = at.unbiased or at.fit
    out = []
    for k, d in enumerate(fit.criterion.data):
        sim = fit.criterion.simulated(fit.x, k)
        table = variables_of(fit.criterion, experiments, recorded, k, sim, d)
        out.append({n: v for n, v in table.items() if not is_slope(n) and n != TIME})
    return tuple(out)


def _when(
    at: Weighted, tests: ResidualTests, signals: Sequence[Mapping[str, Array]], alpha: float
) -> tuple[tuple[Occurrence, ...], tuple[tuple[str, float], ...]]:
    """Intervals with a large residual, and variables whose size is correlated with its power."""
    blocks, power = tests.blocks, tests.blocks[:, 2]
    usual = float(np.median(power))
    rows: list[Occurrence] = []
    before, data = 0.0, at.criterion.data
    sizes: dict[str, list[float]] = {name: [] for name in signals[0]}
    for d, table in zip(data, signals, strict=True):
        own = blocks[(blocks[:, 0] >= before - 1e-9) & (blocks[:, 0] < before + d.N * d.Ts - 1e-9)]
        for a, b, p in own:
            i, j = round((a - before) / d.Ts), round((b - before) / d.Ts)
            for name in sizes:
                sizes[name].append(float(np.mean(table[name][i:j] ** 2)))
            if p > DESCRIPTION.loud * usual:
                start, stop = float(d.t[0]) + a - before, float(d.t[0]) + b - before
                if rows and rows[-1].record == d.name and abs(rows[-1].stop - start) < 2 * d.Ts:
                    last = rows.pop()
                    start, p = last.start, max(p, last.power * usual)
                rows.append(Occurrence(d.name, start, stop, float(p / usual)))
        before += d.N * d.Ts
    found = []
    for name, size in sizes.items():
        if np.ptp(size) <= 1e-12 * max(size):
            continue
        r = spearmanr(size, power.tolist())
        if float(r.pvalue) < alpha / len(sizes):
            found.append((name, float(r.statistic)))
    found.sort(key=lambda row: -abs(row[1]))
    # Many intervals of large residual are no occurrences: it is then always present.
    is_rare = sum(o.stop - o.start for o in rows) < DESCRIPTION.rare * before
    return (tuple(rows) if is_rare else ()), tuple(found)


# -- words ----------------------------------------------------------------------------------------


def _sentences(
    where: str, found: Sequence[MissingForce], tests: ResidualTests, alpha: float
) -> list[str]:
    """On what the remainder depends; where on nothing found, what it is like."""
    best = found[0]
    if not best.dependences:
        return disturbance_sentences(where, tests, alpha)
    what = (
        f"a missing term in the {best.place} balance"
        if best.is_balance
        else f"an error of {best.place}"
    )
    out = [
        f"The remainder is {what} that {dependence_text(best.dependences)}. "
        f"This explains {100 * best.explained:.0f} % of it."
    ]
    rivals = best.dependences[0].rivals
    if rivals:
        listed = either_words(" times a function of ".join(map(variable_words, r)) for r in rivals)
        out.append(f"In this record {listed} would explain nearly as much.")
    near = [m for m in found[1:] if m.dependences and best.score - m.score < DESCRIPTION.apart]
    if near:
        out.append(
            "The place is not certain: "
            + ", ".join(m.place for m in near)
            + " would explain it as well."
        )
    said = " ".join(d.words for d in best.dependences)
    others = [v for v in best.independent_of if not re.search(rf"\b{re.escape(v)}\b", said)]
    if others and not rivals:
        out.append(f"It does not depend on {', '.join(others)}.")
    return out


def dependence_text(dependences: Sequence[Dependence]) -> str:
    """The dependences in words: on variables, constant, or both."""
    on = "; and on ".join(d.words for d in dependences if d.variables)
    if not on:
        return "is constant"
    return f"depends on {on}" + (
        "" if all(d.variables for d in dependences) else ", about a constant"
    )


def disturbance_sentences(where: str, tests: ResidualTests, alpha: float) -> list[str]:
    """Sentences on a remainder that no function explains, though a test may find dependence."""
    kind = "The remainder resembles a disturbance"
    if tests.verdict == IN_TIME:
        kind = "The mean or the power of the remainder changes in time"
        least = tests.unsteady
        if least is not None and least.p_value < min(
            tests.p_mean, tests.p_power, tests.p_amplitude
        ):
            kind = f"The remainder is like what slow changes of {least.parameter} leave"
    place = f", acting in {where}" if where else ""
    out = [f"{kind}{place}: no function of states, inputs or recorded channels explains it."]
    if tests.p_dependence < alpha:
        out = [
            f"{kind}{place}. It is not independent of states and inputs (p = "
            f"{tests.p_dependence:.2g}), but no function of them explains enough of it to be named."
        ]
    b = tests.loudest
    if b.p_value < DESCRIPTION.band_p:
        out.append(
            f"Most of it lies between {b.low:.3g} and {b.high:.3g} Hz of {b.output}, "
            f"{b.ratio:.2g} times the noise."
        )
    return out


def _in_time(
    found: Sequence[MissingForce],
    occurrences: Sequence[Occurrence],
    goes_with: Sequence[tuple[str, float]],
    *,
    is_one: bool,
) -> list[str]:
    """The line in the spectrum, the intervals (of one record), and what the power goes with."""
    best = found[0]
    out = []
    force = best.over_time
    if force is None:
        force = next((m.over_time for m in found if m.over_time is not None), None)
    if force is not None:
        if force.spectrum.line is not None:
            out.append(f"Its spectrum has a line at {force.spectrum.line:.3g} Hz.")
        if not force.is_seen:
            out.append(
                "Its time series cannot be estimated better than the noise; only its averages can."
            )
    if occurrences:
        ranges = ", ".join(
            span_text(o.start, o.stop) + ("" if is_one else f" of {o.record}")
            for o in occurrences[: DESCRIPTION.stretches]
        )
        out.append(f"It is strongest from {ranges}.")
    if goes_with and not best.dependences:
        name, r = goes_with[0]
        out.append(going_with(name, r))
    return out


def going_with(name: str, correlation: float) -> str:
    """That it is larger or smaller with the size of a variable; one made of the time, in words."""
    more = f"It is {'larger' if correlation > 0 else 'smaller'}"
    if step := STEP.fullmatch(name):
        return f"{more} after t = {float(step[1]):.6g} s than before."
    if ramp := RAMP.fullmatch(name):
        start, stop = (f"{float(t):.6g}" for t in ramp.groups())
        return f"{more} near t = {start} s and t = {stop} s than between."
    return f"{more} when {name} is large."


def _thin(s: ForceSeries) -> dict[str, Any]:
    step = max(1, -(-len(s.t) // 1000))
    return {
        "record": s.name,
        "t": s.t[::step].tolist(),
        "force": s.force[::step].tolist(),
        "sd": s.sd[::step].tolist(),
    }
