"""Simulation of a model whose parameters all have values, as a fit simulates it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.channels.known_rest import KnownRest, rest_before
from casid.estimation.simulation.channels.sensor_dynamics import (
    Before,
    prepared_inputs,
    through_sensor,
)
from casid.estimation.simulation.integration.simulator import Simulator
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.records.signals import Signals
from casid.model.model import Model


class KnownSimulation:
    """A model at one sample time, with every stage of its sensors and actuators.

    Parameters
    ----------
    Ts : sample time [s].
    substeps : Runge-Kutta steps a sample.
    """

    def __init__(self, model: Model, Ts: float, substeps: int = 1) -> None:
        self.model = model
        self.simulator = Simulator(model, Ts, substeps=substeps)

    def run(
        self, u: Array, values: Mapping[str, float], nodes: Array, cuts: Array | None = None
    ) -> tuple[Array, Array]:
        """Outputs (N, ny) and states (N, nx) under inputs u (N, nu).

        Parameters
        ----------
        values : of every parameter.
        nodes : (segments, nx) state at the start of each segment.
        cuts : (segments,) the sample that each segment starts at; one segment needs none.

        Values that overflow come back as inf or NaN.
        """
        simulator, model = self.simulator, self.model
        of_inputs = [s for s in model.stages if s.is_of_input]
        rest = self._rest_before(nodes[0])
        if of_inputs:
            u = prepared_inputs(model, u, values, simulator.Ts, of_inputs, rest.inputs)
        u = simulator.with_courses(u)
        # What a stage does is in the column; its parameter multiplies the tangent alone.
        held = {**values, **{name: 0.0 for s in of_inputs for name in s.parameters}}
        p = np.array([held[name] for name in simulator.equations.parameters], dtype=float)
        y, x = np.empty((len(u), simulator.ny)), np.empty((len(u), simulator.nx))
        before = np.empty((len(u), len(simulator.stepping)))
        starts = [0] if cuts is None else np.asarray(cuts).tolist()
        with np.errstate(all="ignore"):
            for x0, first, last in zip(nodes, starts, [*starts[1:], len(u)], strict=True):
                run = simulator.simulate(u[first:last], p, x0)
                assert run.before is not None
                y[first:last], x[first:last], before[first:last] = run.y, run.x[:-1], run.before
            outputs = list(model.outputs)
            steps = {i: Before(before[:, k]) for k, i in enumerate(simulator.stepping)}
            for stage in model.stages:
                if not stage.is_of_input:
                    i, value = outputs.index(stage.channel), values[stage.parameter]
                    stepped = None if stage.kind == "clip" else steps.pop(i, None)
                    rests = stage.channel in rest.outputs
                    through_sensor(
                        stage.kind, y[:, i], None, value, simulator.Ts, -1, stepped, at_rest=rests
                    )
        return y, x

    def _rest_before(self, x0: Array) -> KnownRest:
        """The rest that a simulation from the state x0 (nx,) begins in, if it is the model's."""
        states = self.model.states.values()
        if any(s.initial not in (None, x) for s, x in zip(states, x0.tolist(), strict=True)):
            return KnownRest()
        return rest_before(self.model)


def outputs_by(fit: Fit, d: Signals, place: int) -> Callable[[Array, Array], Array]:
    """The outputs (n, ny) of inputs (n, nu) from a state (nx,), at the values of a fit.

    Parameters
    ----------
    d : a record, for its sample time and the values known for it.
    place : among the records fitted, of the one whose own values it has.
    """
    criterion = fit.criterion
    model = criterion.model
    simulation = KnownSimulation(model, d.Ts, criterion.substeps)
    values = {n: criterion.value_of(n, fit.x, place) for n in model.parameters} | dict(d.known)

    def outputs(u: Array, x0: Array) -> Array:
        """The simulation, without its states."""
        return simulation.run(u, values, x0[np.newaxis])[0]

    return outputs
