"""What is needed to simulate a problem or a fitted model with a file of inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.record import Record
from casid.errors import DataError, SolveError
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.fitted.from_fit import channels_of
from casid.estimation.fitted.parts import FittedRecord, SimulationSettings
from casid.estimation.simulation.thresholds import STEPS
from casid.model.model import Model


def recorded_inputs(model: Model) -> list[str]:
    """The inputs that a record has to hold."""
    return [n for n, u in model.inputs.items() if u.kind != "generated"]


def inputs_alone(problem: Problem) -> Problem:
    """The problem of reading the inputs: a file of them needs no outputs.

    A model without inputs keeps its outputs, from which a file's clock is read.
    """
    inputs = recorded_inputs(problem.model)
    if not inputs:
        return problem
    model = problem.model.copy()
    model.outputs = {}
    derived = {n: d for n, d in problem.derived.items() if n in inputs}
    sources = {source for d in derived.values() for source in d.sources}
    channels = {n: c for n, c in problem.channels.items() if n in inputs or n in sources}
    return replace(
        problem,
        model=model,
        channels=channels,
        derived=derived,
        recorded={},
        noise={},
        effects=(),
        example=None,
        simulate=None,
    )


def problem_of(fitted: FittedModel) -> Problem:
    """A problem that reads what a fitted model is simulated with."""
    signals = {*fitted.model.inputs, *fitted.model.outputs}
    cases = {r.name.partition(":")[0]: r.known for r in fitted.records if ":" in r.name}
    model = fitted.model
    return Problem(
        fitted.name,
        model,
        channels={n: c for n, c in fitted.channels.columns.items() if n in signals},
        time=fitted.channels.time or None,
        form=fitted.channels.form,
        load_cases={case: model.in_declared_units(known) for case, known in cases.items()},
    )


def starting_model(
    problem: Problem, experiment: Experiment, known: Mapping[str, float] | None = None
) -> FittedModel:
    """The model of a problem before any fit: parameters known or at their starts.

    Initial states are the known ones, or their starts. Runge-Kutta steps are doubled until they
    change no output by more than a millionth of its range under the inputs of `experiment`, as far
    as a fit would (`STEPS.last`).

    Parameters
    ----------
    known : parameter -> value, SI, over those of the model.

    Raises
    ------
    SolveError
        If the simulation diverges.
    """
    model, record = problem.model, experiment.record
    values = model.nominal_values
    x0 = [s.nominal for s in model.states.values()]
    made = FittedModel(
        name=problem.name,
        model=model.with_si_values({**values, **(known or {})}),
        records=(FittedRecord("starts", record.Ts, record.t0, record.N, {}, np.array([x0])),),
        covariance_names=(),
        covariance=np.zeros((0, 0)),
        channels=channels_of(problem),
    )
    before: Record | None = None
    substeps = 1
    while True:
        finer = replace(made, settings=SimulationSettings(substeps))
        try:
            after = finer.simulate(experiment, on_clock=True)
        except SolveError:  # too long a step diverges where a shorter one does not
            if substeps >= STEPS.last:
                raise
        else:
            if before is not None and all(_agree(before, after, n) for n in model.outputs):
                return made
            made, before = finer, after
        if substeps >= STEPS.last:
            return made
        substeps *= 2


def _agree(before: Record, after: Record, name: str) -> bool:
    spread = float(np.ptp(after[name])) or float(np.max(np.abs(after[name]))) or 1.0
    return float(np.max(np.abs(after[name] - before[name]))) <= 1e-6 * spread


def clock(fitted: FittedModel, duration: float | None = None) -> Record:
    """A record of nothing but time, for a model without inputs; by default that of the first fit.

    Raises
    ------
    DataError
        If the model has inputs, or the duration [s] is no positive number of samples.
    """
    needed = recorded_inputs(fitted.model)
    if needed:
        raise DataError(
            f"{fitted.name} is driven by {', '.join(needed)}; name a file with a column for each"
        )
    own = fitted.records[0]
    seconds = own.N * own.Ts if duration is None else duration
    if not (np.isfinite(seconds) and seconds >= 2 * own.Ts):
        raise DataError(f"a duration of {seconds:g} s: give at least two samples of {own.Ts:g} s")
    N = round(seconds / own.Ts)
    t = np.asarray(own.t0 + own.Ts * np.arange(N), dtype=np.float64)
    return Record({"t": t}, {"t": "s"}, own.Ts, own.t0, "simulated")
