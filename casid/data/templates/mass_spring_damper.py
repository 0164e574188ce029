"""The template of a mass on a spring and a damper, along a line or about an axis."""

from __future__ import annotations

import numpy as np

from casid.data.templates.draft import Draft, in_unit
from casid.data.templates.file_channels import FileChannels
from casid.data.templates.roles import Role, same_quantity
from casid.data.templates.template import Body, Template
from casid.data.templates.weak_form import weak_form

_LINE = (
    Role("force", "input", ("N",), "force kraft f load last cmd"),
    Role(
        "position", "output", ("m",), "pos x weg displ auslenk dist s laser travel", "ref set soll"
    ),
    Role("velocity", "output", ("m/s",), "vel v speed geschw", "ref set soll wind"),
    Role("acceleration", "output", ("m/s^2",), "acc a besch"),
)
_AXIS = (
    Role("torque", "input", ("N m",), "torque moment cmd t m"),
    Role("angle", "output", ("rad",), "angle winkel pos roll phi theta encoder", "ref set soll"),
    Role("rate", "output", ("rad/s",), "rate gyro vel speed omega p w n rpm", "ref set soll"),
    Role("acceleration", "output", ("rad/s^2",), "acc alpha besch"),
)


def roles(file: FileChannels) -> tuple[Role, ...]:
    """Forces and lengths, or torques and angles, whichever the file has more of."""
    units = [c.unit for c in file.channels if c.unit is not None]

    def count(candidates: tuple[Role, ...]) -> int:
        return sum(any(same_quantity(u, r.units[0]) for u in units) for r in candidates)

    return _AXIS if count(_AXIS) > count(_LINE) else _LINE


def write(d: Draft) -> Body:
    """One degree of freedom; without a recorded force the inertia is taken as known."""
    turns = "angle" in d.roles
    force, x, v, a = d.roles
    d.require_one_of(x, v, a)
    length, push = ("rad", "N m") if turns else ("m", "N")
    inertia, mass, unit = ("J", "moment of inertia", "kg m^2") if turns else ("M", "mass", "kg")
    pushed, placed = d.has(force), d.has(x)
    start = _starts(d, inertia)
    rest = " - x_0" if placed else ""
    letter = "T" if turns else "F"
    return Body(
        equations=[f"{inertia} d2x/dt2 = {f'{letter} - ' if pushed else '-'}d dx/dt - k (x{rest})"],
        inputs=[d.input(force, letter, "acts on it") if pushed else ""],
        states=[
            f'x = m.state("x", "{length}")  # {x}',
            f'v = m.state("v", "{length}/s")  # {v}',
        ],
        parameters=[
            # A motion without a force determines k and d per unit of inertia.
            d.unknown(inertia, unit, start[inertia], mass)
            if pushed
            else d.known(inertia, unit, 1.0, mass),
            d.unknown("k", f"{push}/{length}", start["k"], "stiffness of the spring"),
            d.unknown("d", f"{push} s/{length}", start["d"], "damping", sign="zero", default=0.01),
            d.unknown(
                "x_0",
                d.unit(x),
                start["x_0"],
                "where the spring rests",
                sign="any",
                within=d.around(x),
            )
            if placed
            else "",
        ],
        relations=[
            "m.derivative(x, v)",
            f'm.balance(v, "{"torque" if turns else "force"}", inertia={inertia}, '
            f"terms=[{f'{letter}, ' if pushed else ''}-d * v, "
            f'-k * {"(x - x_0)" if placed else "x"}], unit="{push}")',
        ],
        outputs=[
            d.output(x, "x") if placed else "",
            d.output(v, "v") if d.has(v) else "",
            d.output(a, "m.der(v)") if d.has(a) else "",
        ],
    )


def _starts(d: Draft, inertia: str) -> dict[str, float | None]:
    """Inertia, k, d and x_0 of F = M x'' + d x' + k (x - x_0), or of a derivative of it."""
    force, *motions = d.roles
    raised = next(i for i, role in enumerate(motions) if d.has(role))  # derivatives of x recorded
    signal = d[motions[raised]]
    zero = float(signal.mean()) if raised == 0 else 0.0
    x, Ts = signal - zero, d.file.Ts
    # With F differentiated `raised` times, the recorded motion stands in the place of x.
    terms = [(x, 1), (x, 0)]
    if raised == 0:
        terms.append((np.ones_like(x), 0))
    M = d.value(inertia, 1.0)
    if d.has(force):
        found = weak_form((d[force], raised), [*terms, (x, 2)], Ts)
        M = M if found is None else float(found[-1])
    else:
        found = weak_form((-M * x, 2), terms, Ts)
    if found is None:
        return {inertia: None, "d": None, "k": None, "x_0": None}
    damping, k = float(found[0]), float(found[1])
    rest = None
    if raised == 0:
        rest = in_unit(zero - float(found[2]) / k if k else zero, d.unit(motions[0]))
    return {inertia: M, "d": damping, "k": k, "x_0": rest}


MASS_SPRING_DAMPER = Template("mass-spring-damper", "mass on a spring and a damper", roles, write)
