"""A fitted model as a CasADi function with named inputs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import casadi as ca

from casid.errors import ModelError, nearest
from casid.estimation.fitted.fitted_model import FittedModel
from casid.export.delayed_outputs import delayed
from casid.export.late_inputs import acting_late
from casid.export.naming import checked_path, written_by
from casid.export.plain_model import PlainModel, Symbols, expressions, plain_model
from casid.model.identifiers import identifier


def casadi_function(
    fitted: FittedModel, parameters: Sequence[str] = (), *, without_delays: bool = False
) -> Any:
    """The equations and the discrete step of the fit as one ``ca.Function``.

    Inputs: x (nx,), u (nu,), u_next (nu,) the inputs one sample later, t the time of the record's
    clock [s] (where the model depends on it), p (np,) the values of `parameters` in that order.
    Outputs: dx = f(x, u), y = h(x, u), x_next the state one sample later. All in SI units, in the
    order of the model's states, inputs and outputs.

    Where sensors are delayed, y is what they give at this sample; where inputs act late, u is what
    is given. The last input is then `past`, the memory of earlier outputs and inputs, zeros in the
    first step, and the last output `past_next`.

    Parameters
    ----------
    parameters : those that stay free, in the order of p; all others have their estimates.
    without_delays : leave out the delays of sensors and inputs.

    Raises
    ------
    ModelError
        If a name is no parameter of the equations, or an input is a function of the user's.
    """
    return function_of(_plain(fitted, without_delays=without_delays), parameters)


def function_of(plain: PlainModel, parameters: Sequence[str]) -> Any:
    """The `casadi_function` of a plain model."""
    unknown = [n for n in parameters if n not in plain.model.parameters]
    if unknown:
        raise ModelError(
            f"{plain.name} has no parameter {unknown[0]!r}"
            f"{nearest(unknown[0], plain.model.parameters)}"
        )
    idle = [n for n in parameters if n not in plain.parameters]
    if idle:
        raise ModelError(
            f"{plain.name}: {idle[0]} is in none of the equations, so it cannot stay free (the "
            "delay of a sensor is a number of samples, with which the function is built)"
        )
    found = expressions(plain)
    s = found.symbols
    free = ca.SX.sym("p", len(parameters))
    values = [
        free[list(parameters).index(n)] if n in parameters else ca.SX(plain.values[n])
        for n in plain.parameters
    ]
    results = [found.dx, found.y, found.x_next]
    if values:
        results = ca.substitute(results, [s.p], [ca.vertcat(*values)])
    arguments = [s.x, s.u, s.u_next, s.t, free]
    names = ["x", "u", "u_next", "t", "p"], ["dx", "y", "x_next"]
    if plain.memory_size:
        past = ca.SX.sym("past", plain.memory_size)
        results = _with_delays(plain, s, results, past)
        arguments.append(past)
        names[0].append("past")
        names[1].append("past_next")
    made = [ca.densify(each) for each in results]
    return ca.Function(identifier(plain.name), arguments, made, *names)


def _with_delays(plain: PlainModel, s: Symbols, results: Sequence[Any], past: Any) -> list[Any]:
    """dx, y and x_next of what acts late and is measured late, and the memory of what is past."""
    dx, y, x_next = results
    has_begun, of_outputs = past[-1], sum(d.kept for d in plain.sampled_delays)
    acting, given = acting_late(
        s.u, s.u_next, past[of_outputs:], has_begun, plain.sampled_dead_times
    )
    now, begin, end, later = acting
    (x_next,) = ca.substitute([x_next], [s.u, s.u_next], [begin, end])
    (y_next,) = ca.substitute([y], [s.x, s.u, s.t], [x_next, later, s.t + plain.Ts])
    dx, y = ca.substitute([dx, y], [s.u], [now])
    y, kept = delayed(y, y_next, past, has_begun, plain.sampled_delays)
    return [dx, y, x_next, ca.vertcat(*kept, *given, 1.0)]


def write_casadi(fitted: FittedModel, path: Path, *, without_delays: bool = False) -> Path:
    """Write the function to a file, and beside it what `call_values` gives, as JSON.

    ``casadi.Function.load`` reads the function.
    """
    plain = _plain(fitted, without_delays=without_delays)
    path = checked_path(path, "casadi")
    function_of(plain, ()).save(str(path))
    beside = path.with_name(f"{path.name}.json")
    beside.write_text(json.dumps(call_values(fitted, plain), indent=1) + "\n", encoding="utf-8")
    return path


def call_values(fitted: FittedModel, plain: PlainModel) -> dict[str, Any]:
    """What the function is called with, in its own order and SI units.

    Sample time Ts [s] of a step and time t0 of the first sample [s]; states with their units and
    where the first fitted record began, inputs and outputs with their units, the values that the
    parameters have in it, and how many zeros `past` begins with, where something is delayed.
    """
    initial = dict(zip(plain.states, plain.x0.tolist(), strict=True))
    values = dict(zip(plain.parameters, plain.p.tolist(), strict=True))
    return {
        "name": plain.name,
        "written_by": written_by(),
        "Ts": plain.Ts,
        "t0": fitted.records[0].t0,
        "x": [{"name": n, "unit": plain.unit(n), "initial": initial[n]} for n in plain.states],
        "u": [{"name": n, "unit": plain.unit(n)} for n in plain.inputs],
        "y": [{"name": n, "unit": plain.unit(n)} for n in plain.outputs],
        "parameters": [
            {"name": n, "unit": plain.unit(n), "value": values[n]} for n in plain.parameters
        ],
        "past": plain.memory_size,
        "notes": list(plain.notes),
    }


def _plain(fitted: FittedModel, *, without_delays: bool) -> PlainModel:
    return plain_model(fitted, what="a CasADi function", without_delays=without_delays)
