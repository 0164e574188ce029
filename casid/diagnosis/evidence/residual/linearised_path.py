"""A simulation, linearised along its own trajectory.

A force in a balance moves the outputs by

    dx[k+1] = A_k dx[k] + B0_k f[k] + B1_k f[k+1],   dy[k] = C_k dx[k] + D_k f[k]            (1)

"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg.lapack import dtbtrs

from casid.arrays import Array
from casid.diagnosis.thresholds import FUNCTIONS, SCORES
from casid.estimation.noise.thresholds import REMOVAL
from casid.estimation.simulation.channels.known_rest import rest_before
from casid.estimation.simulation.channels.sensor_dynamics import late_columns
from casid.estimation.simulation.input_noise.input_noise import input_noise_sd
from casid.estimation.simulation.integration.simulator import rk4_sample
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulated_record import Simulated
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.declarations import Input


@dataclass(frozen=True, slots=True, eq=False)
class Changed:
    """What a unit of one parameter changes of a sample's step and of the outputs."""

    step: Array  # (N, nx)
    outputs: Array  # (N, ny)

    @property
    def is_nothing(self) -> bool:
        """True of a parameter of a sensor, which acts behind the model's equations."""
        return not (self.step.any() or self.outputs.any())


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Equation (1) along one record, for all balances of the model in order."""

    A: Array  # (N, nx, nx)
    B0: Array  # (N, nx, nb)
    B1: Array  # (N, nx, nb)
    C: Array  # (N, ny, nx)
    D: Array  # (N, ny, nb)
    inputs: Array  # (N, nx, nu): B0 + B1 of the model's own inputs
    feedthrough: Array  # (N, ny, nu)
    anew: Array = field(default_factory=lambda: np.zeros(0, dtype=int))  # states of their own

    def respond(self, balance: int, force: Array, ends: Array | None = None) -> Array:
        """Outputs (N, ny, m) to m forces (N, m) in one balance.

        Between samples straight lines join them. `ends` (N, m), if given, is where the line that
        begins at the sample before ends: a force of a held input leaps at the samples.
        """
        n, m = force.shape
        lines = force if ends is None else ends
        ahead = np.vstack([lines[1:], lines[-1:]])
        states = np.zeros((m, n, self.A.shape[1]))  # each column's in one piece, as solved
        push = states[:, 1:].transpose(1, 2, 0)
        push += self.B0[:-1, :, balance, None] * force[:-1, None, :]
        push += self.B1[:-1, :, balance, None] * ahead[:-1, None, :]
        return np.asarray(self._moved(states) + self.D[:, :, balance, None] * force[:, None, :])

    def respond_to(self, change: Changed, course: Array) -> Array:
        """Outputs (N, ny, m) to a parameter that changes by `course` (N, m)."""
        n, m = course.shape
        states = np.zeros((m, n, self.A.shape[1]))
        middle = 0.5 * (course[:-1] + course[1:])
        states[:, 1:] += (change.step[:-1, :, None] * middle[:, None, :]).transpose(2, 0, 1)
        return np.asarray(self._moved(states) + change.outputs[:, :, None] * course[:, None, :])

    def _moved(self, states: Array) -> Array:
        """C x (N, ny, m), with what pushes each of m columns (m, N, nx) from sample to sample."""
        m, n, nx = states.shape
        # x[k+1] - A[k] x[k] = push[k]: a triangular band.
        bands = np.zeros((2 * nx, n, nx))
        for i in range(nx):
            for j in range(nx):
                bands[nx + i - j, :-1, j] = -self.A[:-1, i, j]
        if nx:
            columns = states.reshape(m, -1).T
            columns, _ = dtbtrs(bands.reshape(2 * nx, -1), columns, uplo="L", diag="U")
            states = columns.T.reshape(m, n, nx)
        return np.asarray(np.einsum("kij,mkj->kim", self.C, states))


@dataclass(eq=False)
class Motion:
    """One record simulated, as it was recorded or with a draw of noise on its inputs."""

    linearised: Linearised
    experiment: int
    signals: Signals
    at: Simulated

    @functools.cached_property
    def path(self) -> Path:
        """The derivatives along it."""
        states = self.at.x[: self.signals.N]
        return self.linearised.path(self.experiment, states, self.signals)


class Linearised:
    """The simulation of a fitted model, linearised along its own trajectories.

    What it was simulated for is kept: the regressions of all places and noise models share it.
    """

    def __init__(self, criterion: SimulationError, x: Array) -> None:
        self.criterion, self.x = criterion, x
        self._functions: dict[float, Any] = {}
        self._changes: dict[float, Any] = {}
        self._motions: dict[tuple[bytes, int], list[list[Motion]]] = {}
        self._late: dict[int, Array] = {}

    def motions(self, sd: Array, seed: int) -> list[list[Motion]]:
        """Every record as it is and, where inputs are noisy, with a draw added and taken away.

        `sd` (nu,) is the white noise of the inputs; the draw is `REMOVAL.drawn_share` of it.
        """
        key = sd.tobytes(), seed
        if key not in self._motions:
            rng, criterion, x = np.random.default_rng(seed), self.criterion, self.x
            made = []
            for k, d in enumerate(criterion.data):
                own = [Motion(self, k, d, criterion.simulated(x, k))]
                if np.any(sd > 0):
                    here = input_noise_sd(criterion.data, k, sd)
                    w = REMOVAL.drawn_share * here * rng.standard_normal((d.N, len(sd)))
                    for sign in (1.0, -1.0):
                        noisy = replace(d, u=d.u + sign * w)
                        run = criterion.simulated(x, k, signals=noisy)
                        own.append(Motion(self, k, noisy, run))
                made.append(own)
            self._motions[key] = made
        return self._motions[key]

    def late_inputs(self, k: int) -> Array:
        """Change (N, ny, ...) of a residual by inputs that are `SCORES.between_samples` late."""
        if k not in self._late:
            criterion, d = self.criterion, self.criterion.data[k]
            late = SCORES.between_samples * np.gradient(d.u, axis=0)
            columns = [np.zeros((d.N, len(criterion.outputs), 0))]
            for i, entry in enumerate(criterion.model.inputs.values()):
                if entry.kind == "measured" and entry.hold == "foh":
                    moved = np.zeros_like(d.u)
                    moved[:, i] = late[:, i]
                    up, down = (
                        criterion.simulate(self.x, k, signals=replace(d, u=d.u + s * moved))[0]
                        for s in (1.0, -1.0)
                    )
                    moved_by = np.where(d.used, 0.5 * (down - up), 0.0)
                    columns.append(d.in_sizes(moved_by)[:, :, None])
            self._late[k] = np.concatenate(columns, axis=2)
        return self._late[k]

    def path(self, experiment: int, states: Array, signals: Signals) -> Path:
        """The derivatives of one sample's step and of the outputs at `states` (N, nx)."""
        criterion = self.criterion
        if signals.Ts not in self._functions:
            self._functions[signals.Ts] = self._derivatives(signals.Ts)
        function = self._functions[signals.Ts]
        p, _ = criterion.parameter_vector(self.x, experiment)
        n, nb = signals.N, len(criterion.model.balances)
        u = np.hstack([signals.u, np.zeros((n, nb))])
        ahead = np.vstack([u[1:], u[-1:]])
        found = function.map(n)(states.T, u.T, ahead.T, np.tile(p[:, None], (1, n)))
        a, b0, b1, c, d = (np.array(m).reshape(m.shape[0], n, -1).transpose(1, 0, 2) for m in found)
        own = u.shape[1] - nb
        anew = criterion.starts_anew(experiment)
        for step in (a, b0, b1):
            step[anew - 1] = 0.0  # into a state that no earlier one determines
        return Path(
            a,
            b0[:, :, own:],
            b1[:, :, own:],
            c,
            d[:, :, own:],
            (b0 + b1)[:, :, :own],
            d[:, :, :own],
            anew,
        )

    def _derivatives(self, Ts: float) -> Any:
        disturbed = self.criterion.model.copy()
        disturbed.stages = ()
        own = list(disturbed.inputs)
        for name, balance in self.criterion.model.balances.items():
            w = disturbed.add_input(Input(f"force in {name}", balance.unit, "unknown"))
            disturbed.add_term(name, w)
        e = disturbed.explicit()
        assert list(e.inputs[: len(own)]) == own
        ahead = ca.SX.sym("ahead", len(e.inputs))
        step = rk4_sample(disturbed, e, ahead, Ts, self.criterion.substeps)
        pairs = ((step, e.x), (step, e.u), (step, ahead), (e.h, e.x), (e.h, e.u))
        return ca.Function(
            "along", [e.x, e.u, ahead, e.p], [ca.densify(ca.jacobian(a, b)) for a, b in pairs]
        )

    def changed(self, motion: Motion, parameter: str) -> Changed:
        """The derivatives by a parameter along a record, constant in each step."""
        criterion, signals = self.criterion, motion.signals
        if signals.Ts not in self._changes:
            self._changes[signals.Ts] = self._derivatives_by_parameters(signals.Ts)
        p, _ = criterion.parameter_vector(self.x, motion.experiment)
        names = criterion.model.explicit().parameters
        unit = np.zeros(len(p))
        unit[names.index(parameter)] = 1.0
        n, u = signals.N, signals.u
        ahead = np.vstack([u[1:], u[-1:]])
        along = (np.tile(v[:, None], (1, n)) for v in (p, unit))
        step, outputs = self._changes[signals.Ts].map(n)(motion.at.x[:n].T, u.T, ahead.T, *along)
        by = np.array(step).T
        by[criterion.starts_anew(motion.experiment) - 1] = 0.0
        return Changed(by, np.array(outputs).T)

    def _derivatives_by_parameters(self, Ts: float) -> Any:
        model = self.criterion.model.copy()
        model.stages = ()
        e = model.explicit()
        ahead, unit = ca.SX.sym("ahead", len(e.inputs)), ca.SX.sym("unit", e.p.shape[0])
        step = rk4_sample(model, e, ahead, Ts, self.criterion.substeps)
        by = [ca.densify(ca.jtimes(of, e.p, unit)) for of in (step, e.h)]
        return ca.Function("by_parameter", [e.x, e.u, ahead, e.p, unit], by)

    def through_sensors(self, response: Array, y: Array, experiment: int) -> Array:
        """Apply what the model's sensors do to a response (N, ny, m), in place."""
        model, d = self.criterion.model, self.criterion.data[experiment]
        p, _ = self.criterion.parameter_vector(self.x, experiment)
        names, rest = model.explicit().parameters, rest_before(model)
        for stage in model.stages:
            if stage.is_of_input:
                continue
            i, value = self.criterion.outputs.index(stage.channel), p[names.index(stage.parameter)]
            rests = stage.channel in rest.outputs
            if stage.kind == "clip":
                response[np.abs(y[:, i]) >= FUNCTIONS.at_limit * value, i] = 0.0
            else:
                samples = float(value) / d.Ts
                late = late_columns(stage.kind, response[:, i], samples, at_rest=rests)
                response[:, i] = late
        return response
