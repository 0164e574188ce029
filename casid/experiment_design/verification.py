"""The prediction of a design checked: records with noise drawn, and every hypothesis fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from casid.experiment_design.aim import Aim
from casid.experiment_design.designed_experiment import Outcome
from casid.experiment_design.question import Question
from casid.experiment_design.rival_fits import fitted_to, record_of
from casid.experiment_design.search import Found


def verified(
    aim: Aim,
    question: Question,
    best: Found,
    outcomes: Sequence[Outcome],
    seed: int,
    *,
    runs: int,
    progress: Callable[[str], None],
) -> tuple[Outcome, ...]:
    """Outcomes with how often simulated records gave the right answer.

    Of each truth `runs` records are drawn, and truth and rival are fitted to each. Right is the
    better fit of the truth; of a detection, a significant likelihood ratio.
    """
    margin = float(chi2.isf(aim.false_alarm_rate, 1)) if aim.kind == "detect" else 0.0
    prediction, out = best.prediction, []
    noise = prediction.setup.noise
    for k, (c, outcome) in enumerate(zip(question.comparisons, outcomes, strict=True)):
        progress(f"verify: {runs} simulated records of {outcome.truth}")
        rng = np.random.default_rng((seed, 3, k))
        assert c.truth is not None
        y = prediction.course(c.truth, best.u, best.release).y
        measured = prediction.measured(c.truth, best.u, best.release)
        right = 0
        for _ in range(runs):
            noisy = y + noise * rng.standard_normal(y.shape)
            errors = []
            for i in (c.truth, c.rival):
                h = prediction.hypotheses[i]
                record = record_of(prediction, best.u, noisy, h.model, measured)
                fitted = fitted_to(prediction, h, record, best.release)
                errors.append(np.inf if fitted is None else fitted[0])
            right += bool(errors[1] - errors[0] > margin)
        out.append(replace(outcome, right=right, runs=runs))
    return tuple(out)
