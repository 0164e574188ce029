"""The template for any system: every output follows the inputs with a lag of its own."""

from __future__ import annotations

import re

import numpy as np

from casid.data.templates.draft import Draft, in_unit
from casid.data.templates.file_channels import FileChannel, FileChannels
from casid.data.templates.roles import Role
from casid.data.templates.template import Body, Template
from casid.data.templates.weak_form import weak_form
from casid.model.units import parse_unit, si_unit, unit_quotient

_PRODUCT = re.compile(r"[\s*·⋅.]")
"""Between the factors of a unit."""

_DRIVE = Role(
    "input",
    "input",
    ("N", "N m", "V", "W", "m^3/s", "W/m^2", "kg/s"),
    "cmd command soll set setpoint ref u input in force kraft torque moment volt spannung power "
    "leistung heat heiz valve ventil pump throttle steer ruder rudder duty pwm inflow zufluss "
    "ambient aussen out outside solar strahlung wind stell",
    "measured ist out response",
)


def roles(file: FileChannels) -> tuple[Role, ...]:
    """A role for every column that moves: signals of commands and drives are inputs."""
    moving = [c for c in file.channels if not c.is_constant]
    inputs = [c for c in moving if is_input(c)]
    if len(inputs) == len(moving):
        inputs = inputs[:-1]  # something has to be explained
    return tuple(
        Role(
            c.name,
            "input" if c in inputs else "output",
            (si_unit(c.unit or "1"),),
            "",
            column=c.column,
        )
        for c in moving
    )


_SAMPLES = 20
"""Samples of the time constant of an output of which the record says none: a simulation is stable
with it, and it is resolved."""


def is_input(channel: FileChannel) -> bool:
    """True if a column's name, unit or signal is one of what drives a system."""
    return _DRIVE.score(channel) > 0 or channel.is_held


def write(d: Draft) -> Body:
    """A first-order lag for every output, with a gain from every input and a resting value."""
    inputs = [name for name, role in d.roles.items() if role.side == "input"]
    outputs = [name for name, role in d.roles.items() if role.side == "output"]
    parameters, relations = [], []
    for y in outputs:
        start = _starts(d, y, inputs)
        what, default = f"time constant of {y}", float(f"{_SAMPLES * d.file.Ts:.2g}")
        parameters.append(d.unknown(f"tau_{y}", "s", start["tau"], what, default=default))
        parameters += [
            d.unknown(
                f"g_{y}_{u}",
                gain_unit(d.unit(y), d.unit(u)),
                _in_gain_unit(start[u], d.unit(y), d.unit(u)),
                f"gain from {u} to {y}",
                sign="any",
                default=0.0,
            )
            for u in inputs
        ]
        rest = None if start["rest"] is None else in_unit(start["rest"], d.unit(y))
        what = f"where {y} rests" + (" without input" if inputs else "")
        mean = float(f"{in_unit(float(d[y].mean()), d.unit(y)):.4g}")
        parameters.append(d.unknown(f"{y}_0", d.unit(y), rest, what, sign="any", default=mean))
        driven = "".join(f" + g_{y}_{u} * {u}" for u in inputs)
        relations.append(f"m.derivative({y}, ({y}_0{driven} - {y}) / tau_{y})")
    total = " + ".join(["y_0", *(f"g_{u} {u}" for u in inputs)])
    return Body(
        equations=[
            f"tau dy/dt = {total} - y    for every output y",
        ],
        advice="These are placeholders: put the equations of your system in their place. A motion "
        "of second order has a state for its rate, m.derivative(x, v), and a balance such as "
        'm.balance(v, "force", inertia=M, terms=[F, -d * v, -k * x]).',
        inputs=[d.input(u, u, "") for u in inputs],
        states=[f'{y} = m.state("{y}", "{d.unit(y)}", start={d.first(y):.4g})' for y in outputs],
        parameters=parameters,
        relations=relations,
        outputs=[d.output(y, y) for y in outputs],
    )


def gain_unit(output: str, input: str) -> str:
    """The unit of an output per unit of an input, in the words of both where they are short."""
    above, below = (_difference(unit) for unit in (output, input))
    if "/" in above or "/" in below or _PRODUCT.search(above):
        return unit_quotient(si_unit(above), si_unit(below))
    if below == "1":
        return above
    return f"{above}/({below})" if _PRODUCT.search(below) else f"{above}/{below}"


def _difference(unit: str) -> str:
    """The unit of a difference: of temperatures it is the kelvin."""
    return si_unit(unit) if parse_unit(unit).offset else unit


def _in_gain_unit(gain: float | None, output: str, input: str) -> float | None:
    return None if gain is None else in_unit(gain, gain_unit(output, input))


def _starts(d: Draft, y: str, inputs: list[str]) -> dict[str, float | None]:
    """Time constant, gains and resting value of tau dy/dt = y_0 + g u - y."""
    values = d[y]
    means = {u: float(d[u].mean()) for u in inputs}
    zero = float(values.mean())
    driven = [(d[u] - means[u], 0) for u in inputs]
    terms = [(values - zero, 0), (np.ones_like(values), 0), *driven]
    found = weak_form((values - zero, 1), terms, d.file.Ts)
    if found is None or found[0] >= 0:
        return dict.fromkeys(("tau", "rest", *inputs))
    tau = -1.0 / float(found[0])
    gains = {u: tau * float(c) for u, c in zip(inputs, found[2:], strict=True)}
    rest = zero + tau * float(found[1]) - sum(gains[u] * means[u] for u in inputs)
    return {"tau": tau, "rest": rest, **gains}


FREE = Template("free", "system", roles, write)
