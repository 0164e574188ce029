"""The two sides of an inertia that vanishes within the bounds of a parameter.

An accelerometer in place of an unknown input takes a part of the inertia with it: of I dp/dt is
left (I - M l z) dp/dt. Where that is zero the sensor sits at the centre of percussion, and the
equations do not determine the derivative. No search of a minimum crosses that value. Beyond it,
where the sensor sits farther from the pivot, the model is unstable: a fit on the wrong side is a
poor one, and what a diagnosis then names stands for the inertia.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model
from casid.model.units import from_si

GRID = 201
"""Points between the bounds of a parameter at which the sign of an inertia is evaluated."""


@dataclass(frozen=True, slots=True)
class OtherSide:
    """The side of a vanishing inertia on which a parameter does not start.

    Attributes
    ----------
    parameter : whose value decides the side.
    zero : its value where the inertia vanishes, SI.
    start : a value on the other side, as far from `zero` as the start value where bounds admit, SI.
    """

    parameter: str
    zero: float
    start: float

    def text(self, model: Model) -> str:
        """What the user may do about it, in words."""
        pairs = " and ".join(f"{using} in place of {w}" for w, using in model.eliminations.items())
        unit = model.parameters[self.parameter].unit
        zero, start = (f"{float(from_si(v, unit)):.4g}" for v in (self.zero, self.start))
        is_below = self.start < self.zero
        begun, bound = ("above", "upper") if is_below else ("below", "lower")
        return (
            f"with {pairs} an inertia changes its sign at {self.parameter} = {zero} {unit}, within "
            f"the bounds: there an accelerometer sits at the centre of percussion. No fit crosses "
            f"that; {self.parameter} starts {begun} it. Where the truth may lie on the other side, "
            f"compare a fit with start={start}, {bound}={zero}; else exclude it by the bounds"
        )


def note_on_sides(problem: Problem, experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """The note on an inertia that changes its sign within the bounds of a parameter, or none."""
    if not problem.model.eliminations:
        return ()
    other = other_side(SimulationError(problem.model, experiments))
    return () if other is None else (other.text(problem.model),)


def other_side(criterion: SimulationError) -> OtherSide | None:
    """The nearest value of one unknown parameter beyond which an inertia has the other sign.

    None where no unknown input was eliminated, or no inertia vanishes within the bounds.
    """
    model = criterion.model
    e, size = model.explicit(), _leading_size(model)
    p, x0 = criterion.parameter_vector(criterion.start, 0)
    u = criterion.data[0].u.mean(axis=0)
    found: list[tuple[float, OtherSide]] = []
    for name in criterion.free:
        lower, upper = model.parameters[name].lower, model.parameters[name].upper
        if not np.isfinite(upper - lower):
            continue
        place, begun = e.parameters.index(name), float(p[e.parameters.index(name)])
        at = np.repeat(p[:, None], GRID, axis=1)
        at[place] = values = np.linspace(lower, upper, GRID)
        sizes = size(x0, u, at).full().ravel()
        for k in np.flatnonzero(sizes[1:] * sizes[:-1] < 0.0):
            zero = float(np.interp(0.0, *_rising(sizes[k : k + 2], values[k : k + 2])))
            bound = lower if begun > zero else upper
            near = min(abs(begun - zero), 0.5 * abs(bound - zero))
            start = zero + float(np.copysign(near, bound - zero))
            found.append((abs(zero - begun), OtherSide(name, zero, start)))
    return min(found, key=lambda f: f[0])[1] if found else None


def _rising(sizes: Array, values: Array) -> tuple[Array, Array]:
    """Sizes and values in the order in which the sizes rise."""
    order = np.argsort(sizes)
    return sizes[order], values[order]


def _leading_size(model: Model) -> Any:
    """The determinant of the equations in what they are solved for; zero where they lose one."""
    e = model.explicit()
    unknown = [model.symbol(w) for w in model.eliminations]
    z = ca.vertcat(*unknown, *[model.der(model.symbol(s)) for s in model.states])
    residuals = ca.vertcat(*[residual for _, residual, _ in model.equations()])
    return ca.Function("size", [e.x, e.u, e.p], [ca.det(ca.jacobian(residuals, z))])
