"""The prediction of a design checked: records with noise drawn, fitted and diagnosed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from casid.arrays import Array
from casid.data.problem import Problem
from casid.diagnosing import fewest_samples, named_causes
from casid.experiment_design.aim import Aim
from casid.experiment_design.designed_experiment import Outcome
from casid.experiment_design.hypotheses import Comparison, nominal_hypothesis
from casid.experiment_design.question import Question
from casid.experiment_design.rival_fits import fitted_to, model_to_fit, record_of
from casid.experiment_design.search import Found
from casid.experiment_design.setup import Setup
from casid.experiment_design.thresholds import CHECKING


@dataclass(frozen=True, slots=True)
class Verification:
    """How a prediction is checked.

    Attributes
    ----------
    runs : simulated records of each truth.
    with_diagnoses : whether each is diagnosed, too.
    """

    runs: int
    with_diagnoses: bool = True
    seed: int = 0


def verified(
    aim: Aim,
    question: Question,
    best: Found,
    outcomes: Sequence[Outcome],
    how: Verification,
    progress: Callable[[str], None],
) -> tuple[Outcome, ...]:
    """Outcomes with how often simulated records gave the right answer.

    Truth and rival are fitted to each record. Right is the better fit of the truth; of a detection,
    a significant likelihood ratio. A diagnosis is right that names the truth before the rival; none
    is made where the record has too few samples for one.
    """
    setup = best.prediction.setup
    is_diagnosed = how.with_diagnoses and setup.N >= fewest_to_diagnose(setup)
    margin = float(chi2.isf(aim.false_alarm_rate, 1)) if aim.kind == "detect" else 0.0
    out = []
    for k, (c, outcome) in enumerate(zip(question.comparisons, outcomes, strict=True)):
        progress(f"verify: {how.runs} simulated records of {outcome.truth}")
        records = _Records(best, c)
        rng = np.random.default_rng((how.seed, 3, k))
        right, diagnosed = 0, 0
        for run in range(how.runs):
            noisy = records.drawn(rng)
            right += records.misfit_of_rival(noisy) > margin
            if is_diagnosed:
                names = named_causes(*records.to_diagnose(noisy), seed=how.seed)
                known = [n for n in names if n in (outcome.truth, outcome.rival)]
                diagnosed += known[:1] == [outcome.truth]
                if (run + 1) % CHECKING.reported == 0:
                    progress(f"diagnosed {run + 1}, {diagnosed} of them as {outcome.truth}")
        counted = diagnosed if is_diagnosed else None
        out.append(replace(outcome, right=right, runs=how.runs, diagnosed=counted))
    return tuple(out)


def fewest_to_diagnose(setup: Setup) -> int:
    """Samples from which on a diagnosis judges the model without any cause."""
    base = nominal_hypothesis(setup.nominal, setup.designed, setup.excitation.hold)
    every = fewest_samples(len(base.free) + len(base.free_states))
    return -(-every // len(setup.nominal.model.outputs))


def contradictions(outcomes: Sequence[Outcome]) -> list[str]:
    """Sentences on counts that differ from the prediction by more than chance."""
    words = []
    for o in outcomes:
        if o.agreement is None or o.agreement >= CHECKING.level / len(outcomes):
            continue
        by = "fits" if o.diagnosed is None else "whole diagnoses"
        words.append(
            f"{o.truth}: {by} named it in {o.counted} of {o.runs} simulated records, where "
            f"{100 * o.power:.3g} % were predicted; chance explains that with a probability of "
            f"{o.agreement:.2g}."
        )
    return words


class _Records:
    """Simulated records of one truth, and what is fitted to them."""

    def __init__(self, best: Found, comparison: Comparison) -> None:
        assert comparison.truth is not None
        self.best, self.comparison, self.truth = best, comparison, comparison.truth
        self.prediction = best.prediction
        at = best.u, best.release
        self.y = self.prediction.course(self.truth, *at).y
        self.measured = self.prediction.measured(self.truth, *at)

    def drawn(self, rng: np.random.Generator) -> Array:
        """(N, ny) what is measured once."""
        noise = self.prediction.setup.noise
        return np.asarray(self.y + noise * rng.standard_normal(self.y.shape))

    def misfit_of_rival(self, noisy: Array) -> float:
        """Sum of squares that the rival's fit leaves above the truth's."""
        errors = []
        for i in (self.truth, self.comparison.rival):
            h = self.prediction.hypotheses[i]
            record = record_of(self.prediction, self.best.u, noisy, h.model, self.measured)
            fitted = fitted_to(self.prediction, h, record, self.best.release)
            errors.append(np.inf if fitted is None else fitted[0])
        truth, rival = errors
        return rival - truth if np.isfinite(truth) else -np.inf

    def to_diagnose(self, noisy: Array) -> tuple[Problem, object]:
        """The problem as it is without any cause, and its record."""
        setup = self.prediction.setup
        nominal = setup.nominal
        base = nominal_hypothesis(nominal, setup.designed, setup.excitation.hold)
        model = model_to_fit(setup, base, self.best.release)
        noise = dict(zip(nominal.model.outputs, setup.noise.tolist(), strict=True))
        problem = Problem(nominal.name, model, noise=noise, effects=nominal.effects)
        return problem, record_of(self.prediction, self.best.u, noisy, model, self.measured)
