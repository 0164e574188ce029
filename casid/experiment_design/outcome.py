"""What a found input is predicted to give: powers, standard errors, records, standard inputs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casid.data.record import Record
from casid.experiment_design.aim import Aim
from casid.experiment_design.designed_experiment import (
    FITTED,
    Learned,
    Outcome,
    Standard,
    probability_of_detection,
    probability_of_right_name,
)
from casid.experiment_design.hypotheses import Comparison, nominal_hypothesis
from casid.experiment_design.information import covariance
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.question import Question
from casid.experiment_design.rival_fits import imitation, record_of
from casid.experiment_design.search import Found
from casid.experiment_design.setup import Setup


def outcomes(aim: Aim, question: Question, best: Found, standard: Found) -> tuple[Outcome, ...]:
    """Energies and powers of every comparison of causes."""
    if not question.effects:
        return ()
    found = []
    for k, c in enumerate(question.comparisons):
        assert c.truth is not None
        truth, rival = (question.hypotheses[i].name for i in (c.truth, c.rival))
        energy, other = (float(np.exp(f.scores[k])) for f in (best, standard))
        alone = 0.0
        if aim.kind == "detect":
            rate = aim.false_alarm_rate
            power, usual = (probability_of_detection(e, rate) for e in (energy, other))
        else:
            alone = _left_without_a_cause(best, c.truth)
            power = probability_of_right_name(energy, alone)
            usual = probability_of_right_name(other, _left_without_a_cause(standard, c.truth))
        size = next(iter(question.truths[k].values())) if any(question.others) else None
        found.append(Outcome(truth, rival, energy, power, usual, alone=alone, size=size))
    return tuple(found)


def _left_without_a_cause(found: Found, truth: int) -> float:
    """Energy that the model without any cause leaves of a truth."""
    prediction, setup = found.prediction, found.prediction.setup
    base = nominal_hypothesis(setup.nominal, setup.designed, setup.excitation.hold)
    own = prediction.hypotheses[truth].values
    base = base.at({name: own[name] for name in base.values})
    return imitation(prediction, truth, base, found.u, found.release)[0]


def learned(setup: Setup, best: Found, standard: Found) -> tuple[Learned, ...]:
    """Expected standard errors of the free parameters of the first hypothesis."""
    h, model = best.prediction.hypotheses[0], best.prediction.hypotheses[0].model
    errors = []
    for found in (best, standard):
        alone = Prediction(setup, [h], [Comparison(None, 0)], best.prediction.substeps)
        grams = alone.grams(found.u, found.release)
        n = len(h.free_states)
        variances = np.full(len(h.free), np.inf)
        if grams is not None:
            variances = np.diag(covariance(grams[0]))[n:]
        errors.append([float(np.sqrt(v)) if np.isfinite(v) else None for v in variances])
    out = []
    for name, error, other in zip(h.free, *errors, strict=True):
        shown = [None if e is None else model.shown_size(name, e) for e in (error, other)]
        value = model.shown(name, h.values[name])
        out.append(Learned(name, model.unit_of(name), value, *shown))
    return tuple(out)


def predicted_records(setup: Setup, best: Found) -> dict[str, Record]:
    """Name of a hypothesis -> what it would record without noise, rivals as they fit best.

    Of several scenarios, or sizes of a cause, the first.
    """
    prediction, records = best.prediction, {}
    at = best.u, best.release
    sources = prediction.sources
    for i, h in enumerate(prediction.hypotheses):
        if i in prediction.possible:
            if h.name not in records:
                y, acting = prediction.shown(i, *at), setup.nominal.acting
                records[h.name] = record_of(prediction, best.u, y, acting, name=h.name)
            continue
        name = f"{h.name}{FITTED}{prediction.hypotheses[sources[i]].name}"
        if name in records:
            continue
        y, measured = prediction.course(i, *at).y, prediction.measured(sources[i], *at)
        records[name] = record_of(prediction, best.u, y, h.model, measured, name)
    return records


def ranked_standards(
    setup: Setup, judged: Sequence[tuple[str, Found]], best: Found
) -> tuple[Standard, ...]:
    """The best of each kind, with its information relative to the designed input's."""
    kinds: dict[str, Standard] = {}
    for kind, found in sorted(judged, key=lambda entry: -entry[1].least):
        share = float(np.exp(found.least - best.least))
        seconds = setup.duration / share if share > 0 else float("inf")
        kinds.setdefault(kind, Standard(kind, found.what, share, seconds))
    return tuple(kinds.values())
