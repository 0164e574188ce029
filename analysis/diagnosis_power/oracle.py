"""The oracle on the records of the power study: the maximum posterior with the true noise known.

Signatures are those of casid's own catalogue, whitened with the true noise about a fit that starts
from the true parameters; instants are on a grid of the search, and the true frequency of a periodic
disturbance is among the candidates. What decides is `posterior` of the park
(`analysis.diagnosis_park.oracle`), linear in the sizes. Kinds that spoil single samples have no
signature and no oracle.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

import casid
from analysis.diagnosis_park.oracle import posterior
from analysis.diagnosis_power.cases import Hidden
from analysis.diagnosis_power.energy import FITTED, OF_SAMPLES, fit_with_true_noise
from analysis.diagnosis_power.gain import signals_of
from casid.estimation.simulation.minimization import Fit, widened
from casid.model.effects.balances.periodic import periodic_disturbance
from casid.model.effects.catalogue import catalogue
from casid.model.effects.effect import Effect

Row = dict[str, Any]
WITHOUT = (*OF_SAMPLES, "unknown")


def oracles(problem: casid.Problem, hidden: Hidden) -> Row:
    """Names (kind, where) by the oracle with nominal parameters free (2) and known (1)."""
    fit = fit_with_true_noise(problem, hidden.record, hidden.sd, hidden.start)
    effects = _candidates(problem, fit, hidden)
    model, columns_of = problem.model, []
    for c in effects:
        model, own = c.extended(model, upper=0.0 if c.has_states else None)
        columns_of.append(own[: 2 if c.kind == "periodic_disturbance" else 1])
    wide = widened(fit, model)
    residual, columns = wide.columns(wide.start, 0)
    e, J = residual.ravel(), np.nan_to_num(columns.reshape(-1, columns.shape[-1]))
    position = {n: i for i, n in enumerate(wide.names)}
    tangent = J[:, [position[n] for n in fit.criterion.names]]
    initial = [n not in hidden.start for n in fit.criterion.names]
    counts = Counter((c.kind, c.where) for c in effects)
    signatures = [J[:, [position[n] for n in own]] for own in columns_of]
    grids = [counts[c.kind, c.where] for c in effects]
    signs = [c.sided == "positive" for c in effects]
    row: Row = {}
    for label, free in (("oracle_2", tangent), ("oracle_1", tangent[:, initial])):
        start = 0.0 if label == "oracle_2" else tangent @ _shift(fit, hidden)
        scores, _ = posterior(e + start, free, signatures, grids, signs)
        best = effects[int(np.argmax(scores))]
        row[label] = [best.kind, best.where]
    return row


def _shift(fit: Fit, hidden: Hidden) -> Any:
    """Fitted less true parameters, in the order of the unknowns; zero for initial states."""
    shift = [
        fit.values[n] - v if (v := hidden.start.get(n)) is not None else 0.0
        for n in fit.criterion.names
    ]
    return np.array(shift)


def _candidates(problem: casid.Problem, fit: Fit, hidden: Hidden) -> list[Effect]:
    """Every effect of the catalogue with a signature, of one parameter or with its others fixed."""
    window = (0.0, FITTED * hidden.case.duration)
    sizes = signals_of(problem, fit, hidden, window)
    found = catalogue(problem.model, sizes, problem.recorded, without=WITHOUT)
    found = [c for c in found if c.test == "score"]
    if "frequency" in hidden.truth and hidden.case.kind == "periodic_disturbance":
        w = hidden.truth["frequency"]
        found.append(periodic_disturbance(problem.model, hidden.where, w, window))
    return found
