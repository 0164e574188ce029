"""A fitted model, linearised, as a state space of python-control."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import ModelError, nearest
from casid.estimation.fitted.driving import warn_of
from casid.estimation.fitted.fitted_model import FittedModel
from casid.export.casadi_function import function_of
from casid.export.naming import checked_path, written_by
from casid.export.plain_model import PlainModel, plain_model
from casid.model.identifiers import docstring_text, quoted

_MAX_ORDER = 10  # as MATLAB advises: the coefficients of higher orders spread over too many decades


def control_system(
    fitted: FittedModel,
    at: Mapping[str, float] | None = None,
    *,
    time: float | None = None,
    pade: int | None = None,
    without_delays: bool = False,
) -> Any:
    """The model linearised at an operating point, as ``control.StateSpace`` of continuous time.

    With the deviations z = x - x0, v = u - u0, w = y - y0 from the operating point,
    dz/dt = A z + B v, w = C z + D v; states, inputs and outputs have the model's names and are in
    SI units. Where the point is no equilibrium, dx/dt has the constant f(x0, u0) besides, which a
    state space cannot hold. A model without inputs gets one that does nothing, `none`, as
    python-control requires one.

    Parameters
    ----------
    at : state or input -> its value at the operating point, in its unit; what is not named has
        its value in `FittedModel.operating_point`.
    time : on the record's clock [s], for a model whose parameters depend on it; default the
        beginning of the first fitted record.
    pade : order of the Pade approximation of every delay of a sensor or an input, which adds as
        many states.
        Its gain is 1 at all frequencies; its phase is right up to about `pade` divided by the
        delay in rad/s (Golub and Van Loan 1996, 11.3).
    without_delays : leave out these delays.

    Raises
    ------
    ModelError
        If a name is no state or input, the model has no slope there, or an output or an input is
        delayed and no order is given.

    Warns
    -----
    UserWarning
        Of slopes that are those of the smoothing of a friction.
    """
    system, notes = _linearised(fitted, at, time, pade, without_delays=without_delays)
    warn_of(*notes)
    return system


def _linearised(
    fitted: FittedModel,
    at: Mapping[str, float] | None,
    time: float | None,
    pade: int | None,
    *,
    without_delays: bool,
) -> tuple[Any, list[str]]:
    """The state space, and what its user should know."""
    plain = plain_model(fitted, what="a state space", without_delays=without_delays)
    delays = {**plain.delays, **plain.dead_times}
    if delays and pade is None:
        late = ", ".join(f"{n} by {d:.4g} s" for n, d in delays.items())
        who = "sensors" if plain.delays else "inputs"
        raise ModelError(
            f"{plain.name}: {who} are delayed ({late}), and no state space has a delay; "
            "approximate it by pade=3 (--pade 3), or leave it out by without_delays=True "
            "(--without-delays)"
        )
    if pade is not None and not 1 <= pade <= _MAX_ORDER:
        raise ModelError(f"{plain.name}: pade = {pade!r}; give an order from 1 to {_MAX_ORDER}")
    begin = fitted.records[0].t0 if time is None else time
    point = fitted.model.in_si(_point(fitted, at))
    A, B, C, D = _matrices(plain, point, begin)
    notes = _slopes_of_smoothing(fitted, plain, point, begin, A)
    inputs = list(plain.inputs)
    if not inputs:
        B, D, inputs = np.zeros((len(A), 1)), np.zeros((len(C), 1)), ["none"]
    states = list(plain.states)
    for place, name in enumerate(plain.outputs):
        if name in plain.delays:
            A, B, C, D = _delayed(A, B, C, D, place, plain.delays[name], pade or 1)
            states += [f"{name} delay {i + 1}" for i in range(pade or 1)]
    for place, name in enumerate(plain.inputs):
        if name in plain.dead_times:
            A, B, C, D = _acting_late(A, B, C, D, place, plain.dead_times[name], pade or 1)
            states += [f"{name} delay {i + 1}" for i in range(pade or 1)]
    import control

    system = control.StateSpace(
        A,
        B,
        C,
        D,
        states=states,
        inputs=inputs,
        outputs=list(plain.outputs),
        name=plain.name,
    )
    return system, notes


def _slopes_of_smoothing(
    fitted: FittedModel, plain: PlainModel, point: Mapping[str, float], time: float, A: Array
) -> list[str]:
    """What says that slopes are those of the smoothing of a friction, a sentence for each cause."""
    notes = []
    for cause in fitted.causes:
        if "speed" not in cause.constants or not cause.parameters:
            continue
        frictionless = replace(plain, values={**plain.values, cause.parameters[0]: 0.0})
        due = np.abs(A - _matrices(frictionless, point, time)[0])
        if not np.allclose(due, 0.0):
            speed = plain.states[int(np.argmax(due.max(axis=0)))]
            notes.append(
                f"{cause.words[:1].upper()}{cause.words[1:]} is smoothed about rest, and here the "
                "slopes are those of the smoothing, far stiffer than any motion that slides: for "
                f'that take a point at which it slides, to_control({{"{speed}": value}}) '
                f"(--at {speed}=VALUE)."
            )
    return notes


def _delayed(
    A: Array, B: Array, C: Array, D: Array, place: int, delay: float, order: int
) -> tuple[Array, Array, Array, Array]:
    """A state space whose output at `place` passes a Pade approximation of a delay [s]."""
    a, b, c, d = _pade(delay, order)
    late = np.zeros((len(C), order))
    late[place] = c[0]
    scale = np.ones((len(C), 1))
    scale[place] = d[0, 0]
    return (
        np.block([[A, np.zeros((len(A), order))], [b @ C[[place]], a]]),
        np.vstack([B, b @ D[[place]]]),
        np.hstack([scale * C, late]),
        scale * D,
    )


def _acting_late(
    A: Array, B: Array, C: Array, D: Array, place: int, delay: float, order: int
) -> tuple[Array, Array, Array, Array]:
    """A state space whose input at `place` passes a Pade approximation of a delay [s]."""
    a, b, c, d = _pade(delay, order)
    given = np.zeros((order, B.shape[1]))
    given[:, [place]] = b
    scale = np.ones((1, B.shape[1]))
    scale[0, place] = d[0, 0]
    return (
        np.block([[A, B[:, [place]] @ c], [np.zeros((order, len(A))), a]]),
        np.vstack([B * scale, given]),
        np.hstack([C, D[:, [place]] @ c]),
        D * scale,
    )


def _pade(delay: float, order: int) -> list[Array]:
    """A state space of a Pade approximation of a delay [s].

    That of one second, whose coefficients have one size, with its time stretched.
    """
    import control

    unit = control.tf2ss(*control.pade(1.0, order))
    a, b, c, d = (np.asarray(getattr(unit, letter)) for letter in "ABCD")
    return [a / delay, b / delay, c, d]


def _point(fitted: FittedModel, at: Mapping[str, float] | None) -> dict[str, float]:
    """State or input -> its value where the model is linearised, in its unit; 0 SI if not named."""
    generated = {n for n, u in fitted.model.inputs.items() if u.kind == "generated"}
    own = {n: v for n, v in fitted.operating_point.items() if n not in generated}
    return {**own, **(at or {})}


def _matrices(plain: PlainModel, at: Mapping[str, float], time: float) -> list[Array]:
    names = [*plain.states, *plain.inputs]
    for name in at:
        if name not in names:
            raise ModelError(
                f"{plain.name} has no state or input {name!r} to linearise at; it has "
                f"{', '.join(names)}{nearest(name, names, is_listed=True)}"
            )
    function = function_of(replace(plain, delays={}, dead_times={}), ())
    x, u, u_next, t, p = function.sx_in()
    dx, y, _ = function.call([x, u, u_next, t, p])
    slopes = ca.Function(
        "slopes", [x, u, t], [ca.densify(ca.jacobian(e, v)) for e in (dx, y) for v in (x, u)]
    )
    point = [[float(at.get(n, 0.0)) for n in names] for names in (plain.states, plain.inputs)]
    sizes = [(a, b) for a in (x.numel(), y.numel()) for b in (x.numel(), u.numel())]
    values = slopes.call([*(ca.DM(v) for v in point), time])
    found = [np.array(m, dtype=float).reshape(s) for m, s in zip(values, sizes, strict=True)]
    if not all(np.isfinite(m).all() for m in found):
        where = ", ".join(f"{n} = {at.get(n, 0.0):g}" for n in names)
        raise ModelError(
            f"{plain.name} has no finite slope at {where}; linearise at another point, "
            "to_control({name: value}) (--at NAME=VALUE)"
        )
    return found


def write_control(
    fitted: FittedModel,
    path: Path,
    at: Mapping[str, float] | None = None,
    *,
    pade: int | None = None,
    without_delays: bool = False,
    say: Callable[[str], None] | None = None,
) -> Path:
    """Write a Python file (.py) that makes the state space, `system`; `say` takes its notes."""
    system, notes = _linearised(fitted, at, None, pade, without_delays=without_delays)
    for note in notes:
        (say or warn_of)(f"note: {note}" if say else note)
    path = checked_path(path, "control")
    name = docstring_text(fitted.name)
    units = fitted.model.unit_of
    point = ", ".join(f"{n} = {v:g} {units(n)}" for n, v in _point(fitted, at).items() if v)
    point = point or "all states and inputs zero"
    late = "" if pade is None else f", delays by Pade approximations of order {pade}"
    title = f"{name}, linearised at {point}{late}; matrices in SI units."
    wrapped = [line for note in notes for line in ("", *textwrap.wrap(note, 100))]
    end = ["", *wrapped[1:], '"""'] if notes else []
    lines = [
        f'"""{title} Written by {written_by()}.' + ("" if notes else '"""'),
        *end,
        "",
        "import control",
        "import numpy as np",
        "",
        *(f"{letter} = {_matrix(getattr(system, letter))}" for letter in "ABCD"),
        "system = control.StateSpace(",
        "    A,",
        "    B,",
        "    C,",
        "    D,",
        *(
            f"    {what}={_texts(getattr(system, f'{what[:-1]}_labels'))},"
            for what in ("states", "inputs", "outputs")
        ),
        f"    name={quoted(system.name)},",
        ")",
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _matrix(values: Array) -> str:
    if values.size == 0:
        return f"np.zeros({values.shape})"
    rows = ", ".join(f"[{', '.join(repr(float(v)) for v in row)}]" for row in values)
    return f"np.array([{rows}])"


def _texts(values: list[str]) -> str:
    return f"[{', '.join(map(quoted, values))}]"
