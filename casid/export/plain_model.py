"""A fitted model as equations alone: dx/dt = f(x, u, p, t), y = h(x, u, p, t), all in SI units.

What sensors and actuators do to whole columns becomes part of the equations where that is possible:
a limit is a minimum and a maximum, a first-order lag a state. A delay is no equation; that of a
sensor or of a command stays apart. A delay or lag in the record of an input is not part of the
equations: their input is what acted on the system.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args

import casadi as ca
import numpy as np

from casid.errors import ModelError
from casid.estimation.fitted.fitted_model import FittedModel
from casid.estimation.simulation.channels.known_rest import KnownRest, rest_before
from casid.estimation.simulation.integration.simulator import (
    band_limited,
    rk4_sample,
    stepping_outputs,
)
from casid.export.delayed_outputs import SampledDelay, sampled_delays
from casid.export.late_inputs import DeadTime, sampled_dead_times
from casid.model.clock_signals import ClockSignal
from casid.model.declarations import Stage
from casid.model.dimensional_analysis import carrying_unit
from casid.model.model import Model

_NEAR = 0.1  # samples, the lag with which an actuator follows that is not at its largest rate
_STABLE = 2.0  # longest Runge-Kutta step over a time constant, below the limit of stability, 2.78


@dataclass(frozen=True, slots=True, eq=False)
class PlainModel:
    """The equations of a fitted model, and what they are simulated with.

    Attributes
    ----------
    name : of the fitted model.
    model : without stages; its generated inputs are functions of the clock.
    values : every parameter, SI.
    initial : every state at the beginning of the first fitted record, SI.
    Ts, substeps : sample time [s] and Runge-Kutta steps a sample.
    delays : output -> delay of its sensor [s]; the model's output is what arrives at the sensor.
    dead_times : input -> how much later it acts [s]; the model's input is what acts.
    rest : inputs and outputs before the first sample, of a model that begins in a known rest.
    notes : what a user of the equations should know.
    """

    name: str
    model: Model
    values: Mapping[str, float]
    initial: Mapping[str, float]
    Ts: float
    substeps: int
    delays: Mapping[str, float]
    dead_times: Mapping[str, float]
    rest: KnownRest
    notes: tuple[str, ...]

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(self.model.states)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the recorded inputs."""
        return tuple(n for n, u in self.model.inputs.items() if u.kind != "generated")

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return tuple(self.model.outputs)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that the equations need."""
        e = self.model.explicit()
        needed = {s.name() for s in ca.symvar(ca.veccat(e.f, e.h))}
        needed |= {b.parameter for u in self.model.inputs.values() for b in u.blends}
        return tuple(n for n in self.model.parameters if n in needed)

    def unit(self, name: str) -> str:
        """The SI unit of a state, input, output or parameter."""
        model = self.model
        if name in model.outputs:
            return str(model.outputs[name][1])
        return model.symbol_units[name]

    @property
    def x0(self) -> np.ndarray[Any, Any]:
        """(nx,) initial states."""
        return np.array([self.initial[s] for s in self.states])

    @property
    def p(self) -> np.ndarray[Any, Any]:
        """(np,) values of `parameters`."""
        return np.array([self.values[n] for n in self.parameters])

    @property
    def sampled_delays(self) -> list[SampledDelay]:
        """The delays of outputs, in samples."""
        return sampled_delays(self.outputs, self.delays, self.Ts, self.rest.outputs)

    @property
    def sampled_dead_times(self) -> list[DeadTime]:
        """The dead times of inputs, in samples."""
        holds = {n: self.model.acting_hold(n) for n in self.inputs}
        return sampled_dead_times(self.inputs, self.dead_times, holds, self.Ts, self.rest.inputs)

    @property
    def memory_size(self) -> int:
        """How many numbers a step keeps: past outputs and inputs, and if there are any."""
        kept = [d.kept for d in self.sampled_delays] + [d.kept for d in self.sampled_dead_times]
        return sum(kept) + 1 if kept else 0

    def shares(self) -> list[float]:
        """The share of each input's rise within a sample that follows a straight line.

        1 for an input joined by straight lines or band-limited, 0 for a held one.
        """
        part = {"zoh": 0.0, "foh": 1.0, "bandlimited": 1.0}
        out = []
        for name in self.inputs:
            entry = self.model.inputs[name]
            own = part[entry.hold]
            moved = (self.values[b.parameter] * (part[b.toward] - own) for b in entry.blends)
            out.append(own + sum(moved))
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Symbols:
    """The symbols that the functions of a plain model are made of."""

    x: Any
    u: Any
    u_next: Any
    p: Any
    t: Any


@dataclass(frozen=True, slots=True, eq=False)
class Expressions:
    """dx/dt, the outputs and the states one sample later, as SX of `symbols`."""

    symbols: Symbols
    dx: Any
    y: Any
    x_next: Any


def expressions(plain: PlainModel) -> Expressions:
    """The equations and the Runge-Kutta step of a plain model."""
    model = plain.model.copy()
    for name in plain.dead_times:  # whose line a step is given
        model.inputs[name] = replace(model.inputs[name], hold="foh", blends=())
    e = model.explicit()
    t = ca.SX.sym("t")
    u_next = ca.SX.sym("u_next", e.u.numel())
    after = rk4_sample(model, e, u_next, plain.Ts, plain.substeps)
    now, later, place = [], [], []
    for i, name in enumerate(e.inputs):
        entry = model.inputs[name]
        if entry.kind == "generated":
            assert isinstance(entry.signal, get_args(ClockSignal))
            now.append((e.u[i], entry.signal.expression(t, plain.Ts)))
            later.append((u_next[i], entry.signal.expression(t + plain.Ts, plain.Ts)))
        else:
            place.append(i)
    kept = [e.parameters.index(n) for n in plain.parameters]
    rest = [i for i in range(e.p.numel()) if i not in kept]
    fixed = [(e.p[i], ca.SX(plain.values[e.parameters[i]])) for i in rest]
    old, new = zip(*now, *later, *fixed, strict=True) if [*now, *later, *fixed] else ((), ())
    found = [ca.densify(v) for v in (e.f, e.h, after)]
    if old:
        found = ca.substitute(found, list(old), list(new))
    symbols = Symbols(e.x, _rows(e.u, place), _rows(u_next, place), _rows(e.p, kept), t)
    return Expressions(symbols, *found)


def _rows(column: Any, rows: Sequence[int]) -> Any:
    return ca.vertcat(*[column[i] for i in rows]) if rows else ca.SX(0, 1)


def plain_model(fitted: FittedModel, *, what: str, without_delays: bool = False) -> PlainModel:
    """The equations of a fitted model, the delays of its outputs apart.

    Parameters
    ----------
    what : the export, for messages ("C").
    without_delays : leave out the delays of sensors and inputs, with a note.

    Raises
    ------
    ModelError
        If an input is unknown, or a function of the user's own.
    """
    fitted = fitted.without_noise()
    model, values, initial = fitted.model.copy(), fitted.si_values, fitted.si_initial_states
    for name, entry in model.inputs.items():
        if entry.kind == "unknown":
            raise ModelError(
                f"{fitted.name}: the input {name} is unknown; eliminate it before the model is "
                "fitted and exported"
            )
    notes = [
        f"The input {name} is band-limited between its samples, which takes samples to come: a "
        "step of a sample joins them by straight lines."
        for name in band_limited(model)
    ]
    steps = _Stages(model, values, initial, fitted.Ts, rest_before(fitted.model))
    for stage in fitted.model.stages:
        steps.take(stage)
    for name, entry in list(model.inputs.items()):
        if entry.kind == "generated" and not isinstance(entry.signal, get_args(ClockSignal)):
            raise ModelError(
                f"{fitted.name}: the input {name!r} is a Python function of time, which {what} "
                "cannot hold; make it of casid.StepAt, casid.RampOver or casid.TimeSince"
            )
    shortest = min(steps.lags, default=math.inf)
    substeps = max(fitted.settings.substeps, math.ceil(fitted.Ts / (_STABLE * shortest)))
    left_out = steps.without_delays() if without_delays else []
    outputs = list(fitted.model.outputs)
    stepping = [outputs[i] for i in stepping_outputs(fitted.model, fitted.model.explicit())]
    blurred = [
        f"The output {n} steps with a held input, and its sensor is delayed: in a step of a sample "
        "the delayed output rises to the new value within one sample, where casid has it step."
        for n in stepping
        if n in steps.delays and not without_delays
    ]
    return PlainModel(
        name=fitted.name,
        model=model,
        values=values,
        initial=initial,
        Ts=fitted.Ts,
        substeps=substeps,
        delays={} if without_delays else steps.delays,
        dead_times={} if without_delays else steps.dead_times,
        rest=steps.rest,
        notes=(*notes, *steps.notes, *left_out, *blurred),
    )


class _Stages:
    """Takes the stages of a model into its equations, one by one, in place."""

    def __init__(
        self,
        model: Model,
        values: dict[str, float],
        initial: dict[str, float],
        Ts: float,
        rest: KnownRest,
    ) -> None:
        self.model, self.values, self.initial, self.Ts = model, values, initial, Ts
        self.rest = rest
        self.delays: dict[str, float] = {}
        self.dead_times: dict[str, float] = {}
        self.lags: list[float] = []
        self.notes: list[str] = []
        model.stages = ()

    def take(self, stage: Stage) -> None:
        """Take one stage."""
        value = self.values[stage.parameter]
        if stage.is_of_input:
            for own in (*stage.carriers, stage.channel):
                for name in (*stage.carriers, *Stage.line_of(own)):
                    self._drop(name)
        if stage.kind == "clip":
            self._clip(stage)
        elif value <= 0.0:
            return  # it does nothing
        elif stage.kind == "delay":
            self.delays[stage.channel] = self.delays.get(stage.channel, 0.0) + value
        elif stage.kind in ("lag", "filter"):
            self._lag_output(stage)
        elif stage.kind == "late_input":
            self.dead_times[stage.channel] = value
        elif stage.kind == "lag_input":
            self._lag_input(stage)
        elif stage.kind == "rate_input":
            self._limit_rate(stage)
        elif stage.kind == "play_input":
            raise ModelError(
                f"{self.model.name}: the command {stage.channel} acts through play, which has a "
                "memory that no equation of an exported model holds; export --as problem, or leave "
                f"the play out, model.with_known({stage.parameter}=0)"
            )
        else:
            did = "delayed by" if stage.kind == "delay_input" else "lagging with"
            self.notes.append(
                f"The record of the input {stage.channel} was {did} {value:.6g} s; here "
                f"{stage.channel} is what acted, without that."
            )

    def without_delays(self) -> list[str]:
        """Notes on the delays, for equations that are used without them."""
        sensors = [
            f"The sensor of {n} is delayed by {d:.6g} s, which is not in the equations."
            for n, d in self.delays.items()
        ]
        return sensors + [
            f"The input {n} acts {d:.6g} s late, which is not in the equations: give them the "
            "input of that time ago."
            for n, d in self.dead_times.items()
        ]

    def _drop(self, name: str) -> None:
        """Take out an input that carries tangents alone: it is zero in a simulation."""
        if name in self.model.inputs:
            self.model.substitute_symbol(name, 0)
            del self.model.inputs[name]

    def _clip(self, stage: Stage) -> None:
        expression, unit = self.model.outputs[stage.channel]
        limit = self.model.symbol(stage.parameter)
        clipped = ca.fmin(ca.fmax(expression, -limit), limit)
        self.model.replace_output(stage.channel, clipped, unit)

    def _lag_output(self, stage: Stage) -> None:
        """A state that follows the output; it begins at rest with what it follows."""
        model = self.model
        expression, unit = model.outputs[stage.channel]
        e = model.explicit()
        start = ca.Function("y", [e.x, e.u, e.p], [e.h[e.outputs.index(stage.channel)]])
        x0 = [self.initial[s] for s in e.states]
        p = [self.values[n] for n in e.parameters]
        sensed = self._state(
            f"{stage.channel}_sensed", unit, float(start(x0, [0] * e.u.numel(), p))
        )
        model.derivative(sensed, (expression - sensed) / model.symbol(stage.parameter))
        model.replace_output(stage.channel, sensed, unit)
        self.lags.append(self.values[stage.parameter])

    def _lag_input(self, stage: Stage) -> None:
        model, channel = self.model, stage.channel
        acting = self._actuator(f"{channel}_acting", channel)
        command = model.symbol(channel)
        model.substitute_symbol(channel, acting)
        model.derivative(acting, (command - acting) / model.symbol(stage.parameter))
        self.lags.append(self.values[stage.parameter])

    def _limit_rate(self, stage: Stage) -> None:
        """A state that goes to the command at the largest rate, and slower where it is near."""
        if not self.values[stage.share]:
            return
        model, channel = self.model, stage.channel
        position = self._actuator(f"{channel}_moved", channel)
        command, most = model.symbol(channel), model.symbol(stage.parameter)
        model.substitute_symbol(channel, position)
        near = _NEAR * self.Ts
        speed = (command - position) / carrying_unit(near)
        model.derivative(position, ca.fmin(ca.fmax(speed, -most), most))
        self.lags.append(near)
        self.notes.append(
            f"Where the actuator of {channel} is near the command it follows with a lag of "
            f"{near:.3g} s, a tenth of a sample."
        )

    def _actuator(self, name: str, channel: str) -> Any:
        """The state of the actuator of a command, which begins in the rest of the model."""
        start = self.rest.inputs.get(channel)
        state = self._state(name, self.model.inputs[channel].unit, start or 0.0)
        if start is None:
            self.notes.append(
                f"The actuator's state {state.name()} begins at 0; begin it at the first value of "
                f"{channel} for an actuator at rest there."
            )
        return state

    def _state(self, name: str, unit: str, start: float) -> Any:
        name = self.model.free_name(name)
        self.initial[name] = start
        return self.model.state(name, unit, start=start, initial=start)
