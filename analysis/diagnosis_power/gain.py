"""The gain of an oracle: the right effect, known in kind, place and instant, fitted by casid.

The oracle's extension and the baseline are fitted to the same part of the record by the same
criterion as the diagnosis uses, and judged on the same held-out end.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import casid
from analysis.diagnosis_power.cases import Hidden
from analysis.diagnosis_power.energy import FITTED
from casid.data.experiment import Experiment
from casid.estimation.holdout import held_out_error, split_records
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.balances.periodic import periodic_disturbance
from casid.model.effects.catalogue import catalogue
from casid.model.effects.effect import Effect, Sizes, Spread
from casid.model.effects.parameter_effects import parameter_jump

Row = dict[str, Any]

WITHOUT_GAIN = {"outliers", "saturation"}
"""Kinds whose gain is measured on unaffected samples, where there is little to gain."""


def oracle(problem: casid.Problem, hidden: Hidden) -> Row:
    """Held-out rms of the baseline and of the model with the hidden effect, output units."""
    split = split_records([Experiment(hidden.record, {}, hidden.record.name)], 1.0 - FITTED)
    settings = FitSettings(starts=1)
    start = dict(hidden.start)
    base = fit_model(
        problem.model, split.fitted, settings, start=start, check_rank=False, throw=False
    )
    best: Fit | None = None
    for effect in _effects(problem, base, hidden):
        for size in _sizes(hidden, effect):
            model, names = effect.extended(
                problem.model,
                starts={effect.parameters[0].name: size},
                upper=3.0 * abs(size) + 0.1 if effect.kind == "time_delay" else None,
            )
            values = {k: v for k, v in base.values.items() if k not in names}
            try:
                fit = fit_model(
                    model, split.fitted, settings, start=values, check_rank=False, throw=False
                )
            except casid.CasidError:
                continue
            if best is None or fit.solution.value < best.solution.value:
                best = fit
    row = {"baseline": _rms(base, held_out_error(base, split))}
    if best is not None:
        row["oracle"] = _rms(best, held_out_error(best, split))
    return row


def _rms(fit: Fit, error: Any) -> float:
    return float(np.sqrt(np.nanmean(error[:, 0] ** 2)) / fit.criterion.weights[0])


def _effects(problem: casid.Problem, base: Fit, hidden: Hidden) -> list[Effect]:
    """The hidden effect in casid's own words, in every variant that may be meant."""
    kind, where = hidden.case.kind, hidden.where
    if kind == "parameter_jump":
        return [parameter_jump(problem.model, where, hidden.truth["t_jump"])]
    window = (0.0, FITTED * hidden.case.duration)
    if kind == "periodic_disturbance":
        return [periodic_disturbance(problem.model, where, hidden.truth["frequency"], window)]
    sizes = signals_of(problem, base, hidden, window)
    found = [e for e in catalogue(problem.model, sizes, problem.recorded) if e.kind == kind]
    if kind == "missing_mode":
        omega = 2 * np.pi * hidden.truth["frequency"]
        return [e for e in found if 0.4 < _mode(e) / omega < 2.5]
    if kind == "extra_input":
        found = [e for e in found if e.where == where]
    return [e for e in found if e.where == where or kind == "cross_axis"]


def _mode(effect: Effect) -> float:
    return effect.parameters[1].start


def _sizes(hidden: Hidden, effect: Effect) -> list[float]:
    """Where the effect's own parameter may start: sizes of the simulator are relative in part."""
    size = hidden.truth["size"]
    if effect.kind in ("parameter_jump", "parameter_drift", "scheduled_parameter"):
        value = hidden.start.get(effect.where.partition("~")[0], 1.0)
        return [size] if effect.where == "m" else [size * value]
    return [size]


def signals_of(
    problem: casid.Problem, base: Fit, hidden: Hidden, window: tuple[float, float]
) -> Sizes:
    """Sizes of a record's signals, from which the catalogue's ranges follow."""
    simulated = base.criterion.simulated(base.x, 0)
    record: Mapping[str, Any] = hidden.record.channels
    spreads = {
        c: Spread(float(np.mean(record[c])), float(np.min(record[c])), float(np.max(record[c])))
        for c in problem.recorded
    }
    states = list(problem.model.states)
    return Sizes(
        rates={n: float(np.std(simulated.x[:, i])) for i, n in enumerate(states)},
        largest={n: float(np.max(np.abs(record[n]))) for n in base.criterion.outputs},
        window=window,
        longest_delay=0.3,
        channels=spreads,
        ranges={
            n: (float(simulated.x[:, i].min()), float(simulated.x[:, i].max()))
            for i, n in enumerate(states)
        },
    )
