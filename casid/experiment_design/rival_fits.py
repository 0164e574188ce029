"""Rivals fitted to what a truth would show: how well a wrong model imitates the right one."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.record import Record
from casid.errors import CasidError
from casid.estimation.nlp.solver import Solver
from casid.estimation.simulation.minimization import minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.experiment_design.hypotheses import Hypothesis
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.setup import Setup
from casid.model.model import Model


def record_of(
    prediction: Prediction,
    u: Array,
    y: Array,
    rival: Model,
    measured: Mapping[str, Array] | None = None,
    name: str = "designed",
) -> Record:
    """Outputs `y` (N, ny) with the inputs, as a record for the model of a rival.

    `measured` are channels (N,) that stand for unmeasured inputs.
    """
    setup = prediction.setup
    columns = setup.columns(rival, u, setup.Ts, measured)
    recorded = [
        (k, n) for k, (n, entry) in enumerate(rival.inputs.items()) if entry.kind != "generated"
    ]
    channels = {n: columns[:, k] for k, n in recorded}
    units = {n: rival.inputs[n].unit for _, n in recorded}
    channels |= {n: y[:, k] for k, n in enumerate(rival.outputs)}
    units |= {n: unit for n, (_, unit) in rival.outputs.items()}
    return Record(channels, units, Ts=setup.Ts, name=name)


def imitation(
    prediction: Prediction, truth: int, rival: Hypothesis, u: Array, release: Array
) -> tuple[float, Hypothesis]:
    """Energy (1) of `hypotheses`, and the rival at its minimiser."""
    y = prediction.course(truth, u, release).y
    measured = prediction.measured(truth, u, release)
    record = record_of(prediction, u, y, rival.model, measured)
    fitted = fitted_to(prediction, rival, record, release)
    if fitted is None:
        return np.inf, rival
    return fitted


def fitted_to(
    prediction: Prediction, rival: Hypothesis, record: Record, release: Array
) -> tuple[float, Hypothesis] | None:
    """Twice the smallest weighted error of a hypothesis on a record, and its values there.

    None where the fit fails.
    """
    setup = prediction.setup
    model = model_to_fit(setup, rival, release)
    start: Mapping[str, float] = {f"{n}(0)": model.states[n].start for n in rival.free_states}
    with suppress(CasidError):
        criterion = SimulationError(
            model,
            [Experiment(record, {}, record.name)],
            weights=1 / setup.noise,
            substeps=prediction.substeps,
            start=start,
        )
        fit = minimize_simulation_error(
            criterion, solver=Solver("ipopt", 60), check_rank=False, retry="none"
        )
        found = {n: v for n, v in fit.values.items() if n in rival.free}
        held = [n for n in found if n in fit.solution.active]
        return 2 * float(fit.solution.value), rival.at(found, held)
    return None


def model_to_fit(setup: Setup, h: Hypothesis, release: Array) -> Model:
    """The model of a hypothesis in SI, its free parameters unknown and begun at its values."""
    model = h.model.with_si_values(h.values).taking_si()
    for name in h.free:
        p = model.parameters[name]
        inside = float(np.clip(p.value if p.value is not None else p.start, p.lower, p.upper))
        model.parameters[name] = replace(p, value=None, start=inside)
    for name, value in zip(model.states, setup.initial(model, release).tolist(), strict=True):
        model.states[name] = replace(model.states[name], start=value)
    return model
