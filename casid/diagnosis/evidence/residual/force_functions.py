"""Functions of what is known (states, inputs, recorded channels, time) that a force may follow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.diagnosis.thresholds import FUNCTIONS
from casid.estimation.feedback import slope
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulated_record import Simulated
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.model import Model

Table = Mapping[str, Array]  # variable -> (N,) of one record

TIME = "time"
"""Name of the variable that runs on from record to record."""

_SLOPE_OF = "slope of "


def slope_of(name: str) -> str:
    """Name of the variable that is the slope of another; a delayed input carries its own so."""
    return _SLOPE_OF + name


def is_slope(name: str) -> bool:
    """True of a variable that is the slope of another."""
    return name.startswith(_SLOPE_OF)


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Some functions of one variable, or of a variable times functions of another."""

    names: tuple[str, ...]  # (), (variable,) or (carrier, what its coefficient depends on)
    columns: Callable[[Table], Array]  # table of one record -> (N, m)


def variables_of(
    criterion: SimulationError,
    experiments: Sequence[Experiment],
    recorded: Mapping[str, str],
    experiment: int,
    at: Simulated,
    signals: Signals,
) -> dict[str, Array]:
    """Variables of one record that a missing force may depend on: name -> (N,)."""
    model = criterion.model
    out = {name: at.x[: signals.N, i] for i, name in enumerate(model.states)}
    for i, name in enumerate(model.inputs):
        if not is_slope(name):
            out[name] = signals.u[:, i]
            # In closed loop the next command is made of the noise of the next sample.
            is_held = "zoh" in model.inputs[name].holds
            out[slope_of(name)] = slope(signals.u[:, i], signals.Ts, backward=is_held)
    for name in recorded:
        out.setdefault(name, np.asarray(experiments[experiment].record[name]))
    before = sum(d.N * d.Ts for d in criterion.data[:experiment])
    out[TIME] = before + signals.Ts * np.arange(signals.N)
    return out


def units_of(model: Model, recorded: Mapping[str, str]) -> dict[str, str]:
    """Units of the variables of `variables_of`, and of outputs and their slopes."""
    out = {name: state.unit for name, state in model.states.items()}
    out |= {name: entry.unit for name, entry in model.inputs.items()}
    out |= {name: unit for name, unit in recorded.items() if name not in out}
    out |= {name: unit for name, (_, unit) in model.outputs.items()}
    out |= {slope_of(name): f"({unit})/s" for name, unit in list(out.items())}
    out[TIME] = "s"
    return out


def has_both_signs(values: Array) -> bool:
    """True where a variable spends time on both sides of zero: oddness then means something."""
    low, high = np.quantile(values, [FUNCTIONS.tail, 1.0 - FUNCTIONS.tail])
    return bool(min(-low, high) > FUNCTIONS.both_signs * max(-low, high))


def knots_of(name: str, values: Array, count: int) -> Array:
    """Where piecewise linear functions of a variable bend; symmetric where it has both signs."""
    if name == TIME:
        return np.linspace(values.min(), values.max(), 2 * count + 1)
    if has_both_signs(values):
        size = np.abs(values)
        levels = np.append(
            np.linspace(*FUNCTIONS.levels, count), 1.0
        )  # the ends determine the growth best
        half = np.unique(np.quantile(size, levels))
        half = half[half > 0.0]  # one that rests at zero for long has quantiles there
        return np.concatenate([-half[::-1], [0.0], half])
    return np.asarray(np.unique(np.quantile(values, np.linspace(*FUNCTIONS.ends, count + 2))))


def hats(values: Array, knots: Array) -> Array:
    """Piecewise linear functions, one at each knot and zero at the others, (N, K).

    Beyond the ends they go on: a line is in their span, so that what a parameter absorbs is seen
    to be absorbed.
    """
    i = np.clip(np.searchsorted(knots, values, "right") - 1, 0, len(knots) - 2)
    share = (values - knots[i]) / (knots[i + 1] - knots[i])
    out = np.zeros((len(values), len(knots)))
    rows = np.arange(len(values))
    out[rows, i] = 1.0 - share
    out[rows, i + 1] = share
    return out


def splines(values: Array, knots: Array) -> Array:
    """Cubic splines, one at each knot and zero at the others, (N, K); cubics are in their span."""
    if len(knots) < FUNCTIONS.fewest_knots:
        return hats(values, knots)
    return np.asarray(CubicSpline(knots, np.eye(len(knots)))(values))
