"""The set-up of an experiment: model, nominal values, noise, inputs and initial state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.data.problem import Problem
from casid.errors import DataError, ModelError, nearest
from casid.estimation.fitted.fitted_model import FittedModel, HasModel
from casid.estimation.simulation.records.signals import off_the_clock
from casid.experiment_design.excitation import Excitation
from casid.experiment_design.limits import Limits
from casid.model.model import Model

_TAKEN = "The design is for the extended model, with what the diagnosis found"
_LEFT_OUT = (
    "The design is for the model without what the diagnosis found, of which something acts on "
    "whole signals: that is computed beside the equations, which a design cannot differentiate"
)

Source: TypeAlias = "Problem | Model | FittedModel | HasModel"
"""What an experiment can be designed for: a problem, or the result of a fit or a diagnosis."""


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """A model about which an experiment is designed; numbers in SI.

    Attributes
    ----------
    values : of every parameter; `free` are those that are estimated from the new record.
    sizes : cause -> values of its parameters that a diagnosis found.
    noise : output -> standard deviation of its white noise, as far as it is known.
    Ts : sample time of the records at hand [s]; None without any.
    note : which causes of a diagnosis the model has, or lacks.
    """

    name: str
    model: Model
    values: Mapping[str, float]
    free: tuple[str, ...]
    sizes: Mapping[tuple[str, str], Mapping[str, float]] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    Ts: float | None = None
    effects: Sequence[Any] = ()
    note: str = ""
    acting: Model = field(init=False)

    def __post_init__(self) -> None:
        direct = self.model.direct() if self.model.eliminated_units else self.model
        object.__setattr__(self, "acting", direct)

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """Unmeasured inputs, which the model has eliminated."""
        return tuple(self.model.eliminated_units)


def nominal_of(source: Source, *, with_causes: bool = False) -> Nominal:
    """The model to design for, from a problem at its starts or from a result at its estimates.

    Parameters
    ----------
    with_causes : take the extended model of a diagnosis, with what it found, as parameters are to
        be estimated; causes are separated and detected in the model without them.

    Raises
    ------
    ModelError
        If it is none of them, or has unknown inputs.
    """
    if isinstance(source, Model):
        source = Problem(source.name, source)
    if isinstance(source, Problem):
        found = _of_problem(source)
    else:
        found = _of_result(source, with_causes=with_causes)
    model = found.model
    unknown = [n for n, u in model.inputs.items() if u.kind == "unknown"]
    if unknown:
        raise ModelError(
            f"{found.name}: the input {', '.join(unknown)} is not measured, and no record "
            "determines a model in which it stands. Eliminate it with a sensor that responds to "
            "it, model.eliminate(...), or declare what acts as a known input"
        )
    if model.stages:
        kinds = ", ".join(f"{s.kind} of {s.channel}" for s in model.stages)
        raise ModelError(
            f"{found.name}: {kinds} is computed beside the equations, which a design cannot "
            "differentiate; state it as a state of the model (a lag, a Pade approximation)"
        )
    return found


def _of_problem(problem: Problem) -> Nominal:
    model, given = problem.model, problem.in_si()
    parameters = model.parameters.values()
    values = {p.name: float(p.start if p.value is None else p.value) for p in parameters}
    free = tuple(p.name for p in parameters if not p.is_known)
    return Nominal(
        problem.name, model, values, free, noise=dict(given.noise), effects=problem.effects
    )


def _of_result(result: Any, *, with_causes: bool) -> Nominal:
    fitted = result if isinstance(result, FittedModel) else getattr(result, "model", None)
    if not isinstance(fitted, FittedModel):
        raise ModelError(
            f"{result!r} is nothing to design an experiment for; give a Problem, a Model, or the "
            "result of casid.identify or casid.diagnose"
        )
    base, note = fitted.baseline or fitted, ""
    model, estimated = base.model, set(base.covariance_names)
    if with_causes and fitted.causes:
        extended = off_the_clock(fitted.model)
        acting = _acting_parameters(extended)
        if extended.stages:
            note = f"{_LEFT_OUT}: {', '.join(c.words for c in fitted.causes)}."
        else:
            model, estimated = extended, set(fitted.covariance_names) & acting
            named = [c.words for c in fitted.causes if acting & set(c.parameters)]
            note = f"{_TAKEN}: {', '.join(named)}." if named else ""
    sizes = {
        (c.kind, c.where): {n: fitted.si_values[n] for n in c.parameters} for c in fitted.causes
    }
    return Nominal(
        fitted.name,
        model,
        {n: v for n, v in fitted.si_values.items() if n in model.parameters},
        tuple(n for n in model.parameters if n in estimated),
        sizes,
        _errors(result, fitted.model),
        fitted.Ts,
        note=note,
    )


def _acting_parameters(model: Model) -> set[str]:
    """The parameters of the equations off the clock, where the size of a jump does nothing."""
    e = model.explicit()
    entries = [model.inputs[n] for n in e.inputs]
    idle = [x.kind == "generated" and x.signal is None for x in entries]
    given = ca.vertcat(*[0 if off else e.u[i] for i, off in enumerate(idle)])
    equations = ca.vertcat(e.f, e.h)
    if any(idle):
        equations = ca.substitute(equations, e.u, given)
    return {s.name() for s in ca.symvar(equations)}


def _errors(result: Any, model: Model) -> dict[str, float]:
    """Noise of the outputs as a result has it, SI: its noise floor, or the RMS error of its fit.

    The RMS error is an upper bound, and so is the floor where noise of measured inputs is in it.
    """
    found: dict[str, float] = dict((getattr(result, "fitted", None) or {}).get("noise_floor", {}))
    by_record = getattr(getattr(result, "fit", None), "rmse", {})
    for name in model.outputs:
        errors = [e[name] for e in by_record.values() if name in e]
        if errors and name not in found:
            found[name] = float(np.sqrt(np.mean(np.square(errors))))
    return {n: float(v) / model.shown_size(n, 1.0) for n, v in found.items() if n in model.outputs}


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """The experiment but for the values of the decision variables; SI units.

    Attributes
    ----------
    designed : inputs that are chosen; the others are held at `constants`.
    rest : designed input -> its value where nothing is done.
    start : state -> initial value; those in `limits.release` are chosen.
    noise : (ny,) standard deviation of each output.
    base : inputs (N, nu) and displacements (nr,) that keep the limits where rest does not.
    """

    nominal: Nominal
    excitation: Excitation
    limits: Limits
    designed: tuple[str, ...]
    constants: Mapping[str, float]
    rest: Mapping[str, float]
    start: Mapping[str, float]
    noise: Array
    duration: float
    base: tuple[Array, Array] | None = None

    @property
    def Ts(self) -> float:
        """Sample time [s]."""
        return self.excitation.Ts

    @property
    def N(self) -> int:
        """Samples."""
        return self.excitation.N

    @property
    def released(self) -> tuple[str, ...]:
        """States whose initial value is chosen."""
        return tuple(self.limits.release)

    @property
    def at_rest(self) -> Array:
        """(nu,) the designed inputs where nothing is done."""
        return np.array([self.rest[n] for n in self.designed])

    @property
    def begun_at(self) -> tuple[Array, Array]:
        """Inputs (N, nu) and displacements (nr,) from which amplitudes are measured: the base."""
        if self.base is not None:
            return self.base
        start = np.array([self.start[n] for n in self.released])
        return np.tile(self.at_rest, (self.N, 1)), start

    def initial(self, model: Model, release: Array) -> Array:
        """(nx,) initial state of a model under the chosen displacements (nr,)."""
        chosen = dict(zip(self.released, np.ravel(release).tolist(), strict=True))
        return np.array(
            [chosen.get(n, self.start.get(n, s.start)) for n, s in model.states.items()]
        )

    def others(
        self, model: Model, t: Array, measured: Mapping[str, Array] | None = None
    ) -> dict[str, Array]:
        """Input -> (len(t),) of every input that is not designed."""
        out = dict(measured or {})
        for name, entry in model.inputs.items():
            if name in self.designed or name in out:
                continue
            if entry.kind == "generated":
                out[name] = np.zeros(len(t)) if entry.signal is None else entry.signal(t)
            else:
                out[name] = np.full(len(t), self.constants[name])
        return out

    def columns(
        self, model: Model, u: Array, Ts: float, measured: Mapping[str, Array] | None = None
    ) -> Array:
        """(N, inputs) of a model under the designed inputs `u` (N, nu).

        `measured` are channels (N,) that stand for unmeasured inputs.
        """
        others = self.others(model, Ts * np.arange(len(u)), measured or {})
        place = {n: i for i, n in enumerate(self.designed)}
        found = [u[:, place[n]] if n in place else others[n] for n in model.inputs]
        return np.column_stack(found) if found else np.zeros((len(u), 0))

    def finer(self, u: Array, times: int) -> Array:
        """(N times, nu) the same inputs at a multiple of the sampling rate."""
        if self.excitation.hold == "zoh":
            return np.repeat(u, times, axis=0)
        fine = np.arange(len(u) * times) / times
        return np.column_stack([np.interp(fine, np.arange(len(u)), c) for c in u.T]).reshape(
            len(fine), u.shape[1]
        )


def held(model: Model, designed: Sequence[str], hold: Any) -> Model:
    """A copy whose designed inputs are exactly known, and between samples what the shape says."""
    new = model.copy()
    for name in set(designed) & set(new.inputs):
        new.inputs[name] = replace(new.inputs[name], kind="known", hold=hold, blends=())
    return new


def noise_of(nominal: Nominal, given: Mapping[str, float] | None) -> Array:
    """(ny,) standard deviation of every output, SI.

    Raises
    ------
    DataError
        If one is not known, not positive, or named wrongly.
    """
    model, known = nominal.model, dict(nominal.noise)
    for name, sd in (given or {}).items():
        if name not in model.outputs:
            raise DataError(
                f"noise of {name!r}: {model.name} has no such output{nearest(name, model.outputs)}"
            )
        if not 0 < float(sd) < np.inf:
            raise DataError(
                f"noise of {name}: {sd:g}; give its standard deviation, a positive number in "
                f"{model.unit_of(name)}"
            )
        unit = 1.0 if model.takes_si else 1 / model.shown_size(name, 1.0)
        known[name] = float(sd) * unit
    for name in model.outputs:
        if not known.get(name, 0.0) > 0:
            raise DataError(
                f"the noise of output {name} is not known, and with it no experiment can be "
                f"judged; give its standard deviation in {model.unit_of(name)}, noise="
                f"{{{name!r}: ...}} (--noise {name}=...), or in the problem file"
            )
    return np.array([known[n] for n in model.outputs])


def start_of(model: Model, given: Mapping[str, float] | None, limits: Limits) -> dict[str, float]:
    """State -> initial value, SI: as given, else known, else the declared start.

    Where a displacement is released from, the start lies in its range.

    Raises
    ------
    DataError
        For a state that the model does not have, or a start outside its limit or release.
    """
    for name in given or {}:
        if name not in model.states:
            raise DataError(
                f"initial value of {name!r}: {model.name} has no such state"
                f"{nearest(name, model.states)}"
            )
    own = {n: s.start if s.initial is None else s.initial for n, s in model.states.items()}
    start = {**own, **model.in_si(dict(given or {}))}
    for name, (low, high) in limits.release.items():
        if name in (given or {}) and not low <= start[name] <= high:
            shown = [model.shown(name, v) for v in (start[name], low, high)]
            raise DataError(
                f"x0 of {name}: {shown[0]:g} {model.unit_of(name)} lies outside the {shown[1]:g} "
                f"to {shown[2]:g} from which it is released; give one of the two"
            )
        start[name] = min(max(start[name], low), high)
    for name, (low, high) in limits.signals.items():
        if name in start and name not in limits.release and not low <= start[name] <= high:
            low, high, value = (model.shown(name, v) for v in (low, high, start[name]))
            raise DataError(
                f"the experiment starts at {name} = {value:g}, outside its limit {low:g} to "
                f"{high:g} {model.unit_of(name)}; give another start, x0={{{name!r}: ...}} "
                f"(--x0 {name}=...), or widen the limit"
            )
    return start
