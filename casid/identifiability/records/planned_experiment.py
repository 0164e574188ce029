"""The user's experiments at stated values under a stated noise, measured or only planned.

The information of a record depends on its inputs, on the values of the parameters and on the noise,
not on the measured outputs. Here these form the simulation-error criterion that the estimators
minimise, in units of the noise, so that its Gauss-Newton matrix is the information.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import TINY, Array
from casid.data.arguments import in_si, problem_of
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.record import Record
from casid.errors import DataError, ModelError, SolveError, nearest
from casid.estimation.estimate import Estimate
from casid.estimation.fit_statistics import rms
from casid.estimation.noise.input_noise_floor import input_noise_floor
from casid.estimation.simulation.minimization import divergence
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model

Experiments = Sequence[Experiment | Record] | Experiment | Record | None
MOST_SUBSTEPS = 16


@dataclass(frozen=True, slots=True)
class Noise:
    """White noise of the outputs and where its level comes from.

    Attributes
    ----------
    sd : output -> standard deviation, the output's SI unit.
    source : output -> origin of its level, as text.
    is_absolute : False where a level is unknown: all outputs then have noise of one unit, and only
        ratios of errors mean anything.
    unit : output -> the unit in which it is declared.
    """

    sd: Mapping[str, float]
    source: Mapping[str, str]
    is_absolute: bool
    unit: Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """A criterion in units of the noise, the point where it is evaluated, and that noise.

    Attributes
    ----------
    x : (n,) values of `criterion.names`, SI units.
    size : (n,) reference of relative errors: |x|, for an initial state at least the rms of the
        state over its records (an initial state of zero is not small); 0 where there is none.
    """

    problem: Problem
    criterion: SimulationError
    x: Array
    size: Array
    noise: Noise

    @property
    def scale(self) -> Array:
        """(n,) `size`, and where that is zero the start of a parameter, or 1."""
        scale = self.size.copy()
        for i in np.flatnonzero(scale == 0).tolist():
            declared = self.criterion.model.parameters.get(self.criterion.variables[i].source)
            scale[i] = (abs(declared.start) if declared else 0.0) or 1.0
        return scale

    @property
    def is_state(self) -> Array:
        """(n,) bool, True at initial states."""
        return np.isin(np.arange(len(self.criterion.variables)), self.criterion.initial_states)

    def unit(self, i: int) -> str:
        """SI unit of variable `i`."""
        model, source = self.criterion.model, self.criterion.variables[i].source
        if source in model.states:
            return model.states[source].unit
        return model.parameters[source].unit

    def declared(self, i: int) -> str:
        """The unit that variable `i` was declared in."""
        model, source = self.criterion.model, self.criterion.variables[i].source
        return model.declared_units.get(source, self.unit(i))

    def root(self) -> Array:
        """(n, n) triangular R with R'R the information; not squared, to keep small directions."""
        n = len(self.x)
        r: Array = np.zeros((0, n))
        for e in range(len(self.criterion.data)):
            _, j = self.criterion.columns(self.x, e)
            r = np.asarray(np.linalg.qr(np.vstack([r, j.reshape(-1, n)]), mode="r"))
        return np.vstack([r, np.zeros((max(n - len(r), 0), n))])


def plan(
    problem: Problem | Model,
    experiments: Experiments,
    *,
    at: Mapping[str, float] | Estimate | None = None,
    noise: Mapping[str, float] | None = None,
    own: Sequence[str] = (),
    substeps: int | None = None,
) -> Planned:
    """The experiments as a criterion in units of the noise, at the values `at`.

    Parameters
    ----------
    experiments : records with the model's inputs; outputs may be absent (a planned experiment).
    at : values by name, in the units that the model declares, of parameters ("k"), initial states
        ("phi(0)") and, with several experiments, "phi(0)@name"; what is not named has its start, or
        its known value.
    noise : output -> standard deviation of its white noise, in its unit; else that of the problem,
        else estimated from a measured output, else one unit for all.
    own : parameters of which every record has its own value.
    substeps : Runge-Kutta steps a sample; None doubles them until the information converges.

    Raises
    ------
    ModelError
        A name in `at` that the model does not have.
    DataError
        Inputs absent or incomplete, or a noise level that is no positive number.
    SolveError
        The simulation diverges at these values.
    """
    values = values_of(problem, at)
    noise = problem_of(problem).noise_in_si(noise or {})
    problem, chosen = in_si(problem, experiments)
    known = {
        n: v
        for n, v in values.items()
        if n in problem.model.parameters and problem.model.parameters[n].is_known
    }
    model = problem.model.with_known(**known) if known else problem.model
    absent = [[n for n in model.outputs if n not in e.record.channels] for e in chosen]
    start = {**_unmeasured_starts(model, chosen, absent), **values}
    chosen = [_with_outputs(model, e, names) for e, names in zip(chosen, absent, strict=True)]
    criterion = _resolved(model, chosen, own, substeps, start)
    _refuse_unknown_names(criterion, values, known)
    x = criterion.start
    level = _noise(problem, criterion, x, noise, absent, at_estimate=bool(values))
    criterion.weights = 1 / np.array([level.sd[n] for n in criterion.outputs])
    return Planned(problem, criterion, x, _sizes(criterion, x), level)


def values_of(
    problem: Problem | Model, at: Mapping[str, float] | Estimate | None
) -> dict[str, float]:
    """SI values by name, of a mapping in the units that the model declares or of an estimate."""
    if at is None:
        return {}
    if isinstance(at, Estimate):
        at = at.in_si()
        return {name: at[name] for name in at.names}
    model = problem if isinstance(problem, Model) else problem.model
    return model.in_si({str(name): float(value) for name, value in at.items()})


def _unmeasured_starts(
    model: Model, experiments: Sequence[Experiment], absent: Sequence[Sequence[str]]
) -> dict[str, float]:
    """Initial states of planned experiments: there is no measurement to start from."""
    start: dict[str, float] = {}
    for e, lacking in zip(experiments, absent, strict=True):
        label = f"@{e.name}" if len(experiments) > 1 else ""
        if lacking:
            start |= {f"{n}(0){label}": s.start for n, s in model.states.items()}
    return start


def _with_outputs(model: Model, experiment: Experiment, names: Sequence[str]) -> Experiment:
    """The experiment with zeros for outputs that it does not have yet."""
    record = experiment.record
    for name in names:
        record = record.with_channel(name, np.zeros(record.N), model.outputs[name][1])
    return replace(experiment, record=record) if names else experiment


def _resolved(
    model: Model,
    experiments: Sequence[Experiment],
    own: Sequence[str],
    substeps: int | None,
    start: Mapping[str, float],
) -> SimulationError:
    """The criterion with so many substeps that twice as many do not change the information."""

    def at(steps: int) -> tuple[SimulationError, Array]:
        criterion = SimulationError(model, experiments, own=own, substeps=steps, start=start)
        return criterion, _information(criterion)

    steps = substeps or 1
    criterion, information = at(steps)
    if not criterion.names:
        return criterion
    while substeps is None and steps < MOST_SUBSTEPS:
        finer, better = at(2 * steps)
        length = np.sqrt(np.maximum(np.diag(better), 0.0))
        size = np.outer(length, length)
        moved = np.abs(better - information) > 1e-3 * size + TINY
        if not moved.any():
            break
        steps, criterion, information = 2 * steps, finer, better
    return criterion


def _information(criterion: SimulationError) -> Array:
    if not criterion.names:
        return np.zeros((0, 0))
    evaluation = criterion.evaluate(criterion.start)
    if not np.all(np.isfinite(evaluation.hessian)):
        what, remedy = divergence(criterion, criterion.start)
        raise SolveError(
            f"{criterion.model.name}: {what}; {remedy}; or give other values with "
            "at={name: value}, or shorten the record with record.between(t0, t1)"
        )
    return evaluation.hessian


def _refuse_unknown_names(
    criterion: SimulationError, values: Mapping[str, float], known: Mapping[str, float]
) -> None:
    there = [*criterion.names, *criterion.model.parameters]
    for name in values:
        if name not in there and name not in known:
            raise ModelError(
                f"{criterion.model.name} has no {name!r} to give a value; it has "
                f"{', '.join(dict.fromkeys(there))}{nearest(name, there, is_listed=True)}"
            )


def _noise(
    problem: Problem,
    criterion: SimulationError,
    x: Array,
    given: Mapping[str, float] | None,
    absent: Sequence[Sequence[str]],
    *,
    at_estimate: bool,
) -> Noise:
    """The level given, else that of the problem, else estimated from the record, else unknown."""
    _refuse_noise(criterion, given or {})
    sd: dict[str, float] = {}
    source: dict[str, str] = {}
    unit = {n: criterion.model.unit_of(n) for n in criterion.outputs}
    for i, name in enumerate(criterion.outputs):
        measured = [e for e, lacking in enumerate(absent) if name not in lacking]
        if name in (given or {}):
            sd[name], source[name] = float((given or {})[name]), "as given"
        elif problem.noise.get(name, 0.0) > 0:
            sd[name], source[name] = float(problem.noise[name]), "as the problem states"
        elif measured:
            found, source[name] = _estimated_noise(criterion, x, measured, i, at_estimate)
            sd[name] = found
            if not found > 0:
                del sd[name]
    if len(sd) == len(criterion.outputs):
        return Noise(sd, source, True, unit)
    unknown = ", ".join(n for n in criterion.outputs if n not in sd)
    text = f"unknown for {unknown}: one unit on every output"
    one, texts = dict.fromkeys(criterion.outputs, 1.0), dict.fromkeys(criterion.outputs, text)
    return Noise(one, texts, False, unit)


def _estimated_noise(
    criterion: SimulationError, x: Array, measured: Sequence[int], column: int, at_estimate: bool
) -> tuple[float, str]:
    """The noise of a measured output: its residual at an estimate, else its quietest spectrum."""
    if at_estimate:
        parts = []
        for e in measured:
            d = criterion.data[e]
            error = d.y - criterion.simulate(x, e)[0]
            parts.append(error[d.used[:, column], column])
        residual = np.concatenate(parts)
        return float(rms(residual[:, None])[0]), "rms of the residual at these values"
    floors = []
    for e in measured:
        d = criterion.data[e]
        as_input = replace(d, u=d.y[:, [column]], y=np.zeros((d.N, 0)), used=d.used[:, [column]])
        floors.append(input_noise_floor([as_input], ["y"])["y"])
    return float(np.sqrt(np.mean(np.square(floors)))), "about, from its quietest frequencies"


def _refuse_noise(criterion: SimulationError, given: Mapping[str, float]) -> None:
    for name, value in given.items():
        if name not in criterion.outputs:
            raise DataError(
                f"noise of {name!r}: {criterion.model.name} has no such output; it has "
                f"{', '.join(criterion.outputs)}{nearest(name, criterion.outputs, is_listed=True)}"
            )
        if not (math.isfinite(value) and value > 0):
            raise DataError(
                f"noise of {name} = {value}; give a positive standard deviation in "
                f"{criterion.model.outputs[name][1]}, or leave it out"
            )


def _sizes(criterion: SimulationError, x: Array) -> Array:
    """(n,) |x|, of an initial state at least the rms of the state over the records; 0: no size."""
    size = np.abs(x)
    names = list(criterion.model.states)
    paths = [criterion.simulate(x, e)[1] for e in range(len(criterion.data))]
    moves = np.sqrt(np.mean(np.concatenate(paths) ** 2, axis=0))
    for i, v in enumerate(criterion.variables):
        if v.source in names:
            size[i] = max(size[i], float(moves[names.index(v.source)]))
    return size
