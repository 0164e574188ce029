"""Limits of an experiment: ranges of inputs, outputs and states, slew rates, energies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, isfinite, isnan
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import DataError, nearest
from casid.model.explicit_form import Explicit
from casid.model.model import Model
from casid.model.units import difference_to_si, parse_unit, to_si

Range = Sequence[Any]
"""(lower, upper) in the declared unit, or (lower, upper, unit)."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What an experiment must not exceed, in SI units.

    Attributes
    ----------
    inputs, signals : name -> (lower, upper); signals are outputs and states.
    slew : input -> largest |du/dt|.
    energy : input -> largest integral of (u - rest)^2 over the record.
    release : state -> (lower, upper) of an initial displacement that may be chosen.
    units : name -> unit that its limit was given in.
    """

    inputs: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    signals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    slew: Mapping[str, float] = field(default_factory=dict)
    energy: Mapping[str, float] = field(default_factory=dict)
    release: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def widths(self) -> Array:
        """(n,) scale of each limited signal: its width, or the size of the finite end."""
        return np.array([_width(low, high) for low, high in self.signals.values()])


def _width(low: float, high: float) -> float:
    if isfinite(low) and isfinite(high):
        return high - low
    return abs(low if isfinite(low) else high) or 1.0


def limits_of(
    model: Model,
    ranges: Mapping[str, Range] | None,
    *,
    slew: Mapping[str, float] | None = None,
    max_energy: Mapping[str, float] | None = None,
    release: Mapping[str, Range] | None = None,
) -> Limits:
    """Limits as a caller gives them, checked and in SI units.

    Raises
    ------
    DataError
        For names that the model does not have, limits that contradict each other, or an input
        without both ends.
    """
    inputs: dict[str, tuple[float, float]] = {}
    signals: dict[str, tuple[float, float]] = {}
    known = [*model.inputs, *model.outputs, *model.states]
    for name, given in (ranges or {}).items():
        if name not in known:
            raise DataError(
                f"limit of {name!r}: {model.name} has no such input, output or state"
                f"{nearest(name, known)}"
            )
        (inputs if name in model.inputs else signals)[name] = _range(model, name, given, "limit")
    for name, (low, high) in inputs.items():
        if not (isfinite(low) and isfinite(high)):
            raise DataError(f"limit of {name}: an input needs both ends, for example {name}=-5:5")
    released = {}
    for name, given in (release or {}).items():
        if name not in model.states:
            raise DataError(
                f"release of {name!r}: {model.name} has no such state{nearest(name, model.states)}"
            )
        low, high = released[name] = _range(model, name, given, "release")
        if not (isfinite(low) and isfinite(high)):
            raise DataError(f"release of {name}: give both ends, for example {name}=-0.2:0.2")
    return Limits(
        inputs,
        signals,
        _positive(model, inputs, slew, "slew limit"),
        _positive(model, inputs, max_energy, "energy limit", power=2),
        released,
        {n: str(v[2]) for n, v in (ranges or {}).items() if len(v) > 2},
    )


def _range(model: Model, name: str, given: Range, what: str) -> tuple[float, float]:
    """One range in SI units."""
    try:
        low, high, *unit = given
        low = -inf if low is None else float(low)
        high = inf if high is None else float(high)
    except (TypeError, ValueError) as error:
        raise DataError(
            f"{what} of {name}: {given!r} is no range; give (lower, upper) or (lower, upper, unit)"
        ) from error
    own = model.unit_of(name)
    text = str(unit[0]) if unit else own
    if parse_unit(text).dimension != parse_unit(own).dimension:
        raise DataError(f"{what} of {name}: {text!r} is no unit of it; {name} is in {own}")
    if isnan(low) or isnan(high) or not low < high:
        raise DataError(
            f"{what} of {name}: {low:g} to {high:g} {text} leaves no room; the lower end has to "
            "lie below the upper one"
        )
    in_si = model.takes_si and not unit
    low, high = (v if in_si else float(to_si(v, text)) for v in (low, high))
    return low, high


def _positive(
    model: Model,
    inputs: Mapping[str, tuple[float, float]],
    given: Mapping[str, float] | None,
    what: str,
    power: int = 1,
) -> dict[str, float]:
    """Positive numbers by input, in SI; the unit enters to a power."""
    out = {}
    for name, value in (given or {}).items():
        if name not in inputs:
            raise DataError(
                f"{what} of {name!r}: it belongs to an input with a limit{nearest(name, inputs)}"
            )
        if not 0 < value < inf:
            raise DataError(f"{what} of {name}: {value:g}; give a positive number")
        unit = 1.0 if model.takes_si else float(difference_to_si(1.0, model.unit_of(name)))
        out[name] = float(value) * unit**power
    return out


def signal_function(e: Explicit, names: Sequence[str]) -> Any:
    """(x, u, p) -> limited outputs and states (n,), in the order of `names`."""
    columns = [e.h[e.outputs.index(n)] if n in e.outputs else e.x[e.states.index(n)] for n in names]
    return ca.Function("limited", [e.x, e.u, e.p], [ca.vertcat(*columns)])
