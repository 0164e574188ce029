"""The equations of a fitted model in each experiment, for the analysis of identifiability.

The expressions are those that the estimators simulate, `Model.explicit`; a record adds its load
case, and inputs that are zero or constant in it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from casid.algebra.symbolic import exact
from casid.arrays import Array
from casid.errors import DataError, ModelError
from casid.identifiability.equations.system import System
from casid.identifiability.equations.zeros import with_zeros
from casid.model.declarations import Stage
from casid.model.model import Model

if TYPE_CHECKING:
    from casid.data.experiment import Experiment
    from casid.data.problem import Problem


@dataclass(frozen=True, slots=True, eq=False)
class Translation:
    """Systems, one an experiment, and notes on what they leave out of the model and the records."""

    systems: tuple[System, ...]
    notes: tuple[str, ...]


def system_of(
    model: Model,
    *,
    known: Mapping[str, float] | None = None,
    generic: bool = False,
    direct: bool = False,
) -> System:
    """A model as the system whose identifiability is assessed.

    Parameters
    ----------
    model : its unknown parameters are the unknowns, also those in no equation, and its known ones
        are constants; measured, known and generated inputs are known, and so are outputs
        that replace an eliminated unknown input. States with `initial` have that initial value,
        exactly.
    known : values of parameters over those of the model, SI.
    generic : known parameters are some known numbers and not the values they have, except a value
        of exactly 0: a load that is absent stays absent. Else they have their values, exactly
        (`System.at`), and what coincides in the numbers coincides in the answer.
    direct : undo eliminations first (`Model.direct`): unknown inputs are there, and measured.

    Returns
    -------
    System
        Without the model's stages (delays, lags, clipping) and what its inputs do between samples,
        which have no exact algebra here: a parameter in these alone is not assessed (`left_out`).

    Raises
    ------
    ModelError
        If `known` names no parameter or is not finite, or known values make a denominator zero.
    """
    for name, value in (known or {}).items():
        if not math.isfinite(value):
            raise ModelError(f"{model.name}: {name} = {value} is known, but not finite; correct it")
    model = model.with_known(**(known or {}))
    model = model.direct() if direct else model
    e = model.explicit()
    columns = ((e.states, e.x), (e.inputs, e.u), (e.parameters, e.p))
    symbols = {n: column[i] for names, column in columns for i, n in enumerate(names)}
    slopes, dropped = _slopes(model), _in_stages_alone(model)
    fixed = {
        p.name: p.value
        for p in model.parameters.values()
        if p.value is not None and p.name not in dropped
    }
    kinds = {name: entry.kind for name, entry in model.inputs.items()}
    system = System(
        name=model.name,
        states=e.states,
        parameters=tuple(p for p in e.parameters if p not in fixed and p not in dropped),
        outputs=e.outputs,
        symbols={n: s for n, s in symbols.items() if n not in slopes | dropped},
        f=_without(e.f, slopes, e),
        h=_without(e.h, slopes, e),
        constants=tuple(fixed),
        inputs=tuple(u for u in e.inputs if kinds[u] != "unknown" and u not in slopes),
        unknown_inputs=tuple(u for u in e.inputs if kinds[u] == "unknown"),
        initial_values={
            s.name: exact(s.initial) for s in model.states.values() if s.initial is not None
        },
        units=_units(model),
    )
    zeros = {p: v for p, v in fixed.items() if v == 0.0}
    at = {} if generic else {p: exact(v) for p, v in fixed.items() if v != 0.0}
    return with_zeros(system.where(at=at), list(zeros))


def translated(
    problem: Problem | Model,
    experiments: Sequence[Experiment],
    *,
    generic: bool = False,
    direct: bool = False,
    use_samples: bool = True,
) -> Translation:
    """Each experiment's system: its load case known, inputs as they are in its record.

    Parameters
    ----------
    problem : a problem or its model.
    experiments : one or more; each system has its experiment's name.
    generic, direct : as in `system_of`.
    use_samples : find inputs that are zero or constant in all samples.

    Notes
    -----
    A value that is unknown or different in other load cases is a constant of its own: ``m`` of the
    experiment ``calibration`` is ``m_calibration``.

    An input that is exactly 0 in all samples is replaced by 0; one that is exactly constant becomes
    a known constant of that value. Samples marked missing do not count; a generated input is
    evaluated on the record's clock.

    Raises
    ------
    DataError
        If there is no experiment, or a record lacks an input of the model. Outputs may be absent
        from a record that is planned; a note says so.
    ModelError
        As `system_of`.
    """
    if not experiments:
        raise DataError("no experiment to analyse; give one or more, or use system_of(model)")
    model = problem if isinstance(problem, Model) else problem.model
    acting = model.direct() if direct else model
    systems: list[System] = []
    notes = list(left_out(acting))
    for experiment in experiments:
        system = system_of(acting, known=experiment.known, generic=generic)
        system = system.renamed(_own_names(model, experiment, experiments))
        if use_samples:
            system, found = _with_samples(acting, system, experiment)
            notes += [f"{experiment.name}: {note}" for note in found]
        systems.append(system.where(name=experiment.name))
    return Translation(tuple(systems), tuple(notes))


def _with_samples(model: Model, system: System, experiment: Experiment) -> tuple[System, list[str]]:
    """The system with inputs that are zero or constant in the record, and notes on them."""
    zero, constant = _unexcited(model, system, experiment)
    planned = [y for y in system.outputs if y not in experiment.record.channels]
    notes = [f"{', '.join(planned)} is not recorded, and assumed measured"] if planned else []
    notes += [f"input {n} is 0 in all samples, and assumed 0" for n in zero]
    notes += [
        f"input {n} is the same in all samples, and assumed a known constant" for n in constant
    ]
    system = with_zeros(system.where(name=experiment.name), zero)
    reduced = system.where(
        inputs=tuple(u for u in system.inputs if u not in constant),
        constants=(*system.constants, *constant),
        at={**system.at, **constant},
    )
    return reduced, notes


def _own_names(
    model: Model, experiment: Experiment, experiments: Sequence[Experiment]
) -> dict[str, str]:
    """Own names of values that are known in this load case, and not so in others."""
    own = {}
    for n, value in experiment.known.items():
        if n not in model.parameters:
            continue
        if any(e.known.get(n, model.parameters[n].value) != value for e in experiments):
            own[n] = f"{n}_{experiment.name}"
    return own


def left_out(model: Model) -> tuple[str, ...]:
    """What the system of a model leaves out, a sentence for each stage and each blend of holds."""
    gone = _in_stages_alone(model)
    parts = [(f"the {_CALLED[s.kind]} of {s.channel}", s.parameter) for s in model.stages]
    carried = {name for s in model.stages if s.is_of_input for name in s.carriers}
    parts += [
        (f"what {name} does between its samples", blend.parameter)
        for name, entry in model.inputs.items()
        for blend in entry.blends
        if name not in carried
    ]
    return tuple(
        f"{what} is left out" + (f", and {name} is not assessed" if name in gone else "")
        for what, name in parts
    )


_CALLED = {
    "delay": "delay",
    "delay_input": "delay",
    "lag": "sensor's lag",
    "filter": "digital filter",
    "lead_input": "sensor's lag",
    "late_input": "dead time",
    "lag_input": "actuator's lag",
    "play_input": "actuator's play",
    "rate_input": "actuator's largest rate",
    "clip": "clipping",
}
"""Name of what a stage does."""


# -- inside --------------------------------------------------------------------------------------


def _slopes(model: Model) -> frozenset[str]:
    """Generated inputs that carry no signal: the tangents of input stages, and ends of samples."""
    stages = [s for s in model.stages if s.is_of_input]
    carried = {name for s in stages for name in s.carriers}
    channels = (*carried, *(s.channel for s in stages))
    ends = {end for name in channels for end in Stage.line_of(name)}
    return frozenset(n for n in model.inputs if n in carried | ends)


def _in_stages_alone(model: Model) -> frozenset[str]:
    """Parameters of stages and blends that occur in no equation when slopes are zero."""
    e = model.explicit()
    both = _without(ca.vertcat(e.f, e.h), _slopes(model), e)
    inside = {s.name() for s in ca.symvar(both)}
    blends = {b.parameter for u in model.inputs.values() for b in u.blends}
    return frozenset({n for s in model.stages for n in s.parameters} | blends) - inside


def _without(expression: Any, inputs: frozenset[str], e: Any) -> Any:
    """An expression in which the named inputs are zero."""
    for i, name in enumerate(e.inputs):
        if name in inputs:
            expression = ca.substitute(expression, e.u[i], ca.SX(0))
    return expression


def _units(model: Model) -> dict[str, str]:
    units = {name: unit for name, (_, unit) in model.outputs.items()}
    for entries in (model.states, model.inputs, model.parameters):
        units |= {name: entry.unit for name, entry in entries.items()}
    return units


def _unexcited(
    model: Model, system: System, experiment: Experiment
) -> tuple[list[str], dict[str, Fraction]]:
    """Known inputs of a system that are zero, and that are constant, in all of a record."""
    record = experiment.record
    for name in system.inputs:
        generated = name in model.inputs and model.inputs[name].kind == "generated"
        if not generated and name not in record.channels:
            raise DataError(
                f"{experiment.name}: no channel {name!r} for {model.name}; it has "
                f"{', '.join(record.channels)}. Rename or map one of them to {name!r}"
            )
    zero: list[str] = []
    constant: dict[str, Fraction] = {}
    for name in system.inputs:
        entry = model.inputs[name]
        if entry.kind != "generated":
            mask = record.missing.get(name)
            values: Array = record[name] if mask is None else record[name][~mask]
        elif entry.signal is not None:
            values = np.asarray(entry.signal(record.t))
        else:
            continue
        if values.size and np.all(values == values[0]):
            if values[0] == 0.0:
                zero.append(name)
            else:
                constant[name] = exact(float(values[0]))
    return zero, constant
