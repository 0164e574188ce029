"""Simulation with forward sensitivities: RK4 and its tangent in one mapped CasADi step.

The sensitivities of a fixed-step Runge-Kutta simulation obey (nv columns, one a parameter or
initial state)

    S[k+1] = A[k] S[k] + B[k],   A = dx[k+1]/dx[k],  B = dx[k+1]/dtheta                      (1)

with A and B the exact derivatives of the step, so the gradient is that of the simulation as it is
computed, not to the continuous system (Hairer, Norsett, Wanner 1993, II.6).
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.integration.stepping import Step, Stepping, StepSymbols
from casid.estimation.simulation.integration.wide_tangents import WIDE, Known, WideTangents
from casid.estimation.simulation.thresholds import STEPS
from casid.model.declarations import Stage
from casid.model.explicit_form import Explicit
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A simulated experiment, with sensitivities where requested."""

    y: Array  # (N, ny)
    x: Array  # (N + 1, nx), x[N] is at the sample after the last
    dy: Array | None = None  # (N, ny, nv): d y / d (free parameters, initial state)
    dx_end: Array | None = None  # (nx, nv): d x[N] / d (...)
    before: Array | None = None  # (N, nj) at the end of each sample, before held inputs step
    dbefore: Array | None = None  # (N, nj, nv)


def rk4_sample(
    model: Model, e: Explicit, u_next: Any, Ts: float, substeps: int, between: Any = None
) -> Any:
    """One sample of Runge-Kutta 4 as an expression.

    Parameters
    ----------
    between : values of the inputs of `band_limited` within the sample, one input after another, at
        1/(2 substeps), 2/(2 substeps), ... of it; by default on the straight line.
    """
    f = ca.Function("f", [e.x, e.u, e.p], [e.f])
    parts, banded = 2 * substeps, len(band_limited(model))
    at = []
    for i in range(parts + 1):
        is_inside = between is not None and 0 < i < parts
        course = [between[b * (parts - 1) + i - 1] for b in range(banded)] if is_inside else None
        at.append(ca.vertcat(*inputs_within(model, e, u_next, i / parts, course)))
    x = e.x
    for i in range(substeps):
        x = rk4_step(f, x, e.p, at[2 * i : 2 * i + 3], Ts / substeps)
    return x


def rk4_step(f: Any, x: Any, p: Any, inputs: Sequence[Any], h: Any) -> Any:
    """One step of length `h` [s]; `inputs` at its beginning, its middle and its end."""
    left, mid, right = inputs
    k1 = f(x, left, p)
    k2 = f(x + h / 2 * k1, mid, p)
    k3 = f(x + h / 2 * k2, mid, p)
    k4 = f(x + h * k3, right, p)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def band_limited(model: Model) -> list[str]:
    """Inputs whose course within a sample depends on samples further away."""
    return [name for name, entry in model.inputs.items() if "bandlimited" in entry.holds]


def inputs_within(
    model: Model, e: Explicit, u_next: Any, share: Any, course: Sequence[Any] | None
) -> Iterator[Any]:
    """Every input at a share of a sample; `course` of the band-limited ones, None: on the line.

    One that acts late or lags is a line that begins and ends where its companion columns say; what
    blends would do to it is that of its samples, which is exact once they are settled.
    """
    lines = any(stage.makes_lines for stage in model.stages)
    banded = band_limited(model)
    for i, name in enumerate(e.inputs):
        entry, ends = model.inputs[name], Stage.line_of(name)
        u, line = e.u[i], e.u[i] + share * (u_next[i] - e.u[i])
        acts = {"zoh": u, "foh": line}
        if name in banded:
            acts["bandlimited"] = line if course is None else course[banded.index(name)]
        value, settled = acts[entry.hold], None
        if lines and ends[0] in e.inputs:
            begin, end = (e.u[e.inputs.index(n)] for n in ends)
            value = begin + share * (end - begin)
            settled = model.acting_hold(name)
        for blend in entry.blends:
            b = e.p[e.parameters.index(blend.parameter)]
            done = 1.0 if blend.toward == settled else 0.0
            value += (b - done) * (acts[blend.toward] - acts[entry.hold])
        yield value


def stepping_outputs(model: Model, e: Explicit, *, uneven: bool = False) -> tuple[int, ...]:
    """Places of outputs behind a delay or lag that step where a held input does.

    What such a sensor gives at a sample is what came before the step. Of a record whose samples
    were taken between the instants of its clock (`uneven`) every output that steps counts: there
    it is what it was before the step, or behind it.
    """
    held = [
        e.u[i]
        for i, name in enumerate(e.inputs)
        if "zoh" in model.inputs[name].holds and Stage.line_of(name)[0] not in e.inputs
    ]
    late = {s.channel for s in model.stages if s.kind in ("delay", "lag")}
    found = [i for i, name in enumerate(e.outputs) if uneven or name in late] if held else []
    return tuple(i for i in found if any(ca.which_depends(e.h[i], ca.vertcat(*held))))


class Simulator:
    """Simulates one model at one sample time, differentiated in chosen parameters.

    Parameters
    ----------
    model : the model; its inputs in declared order are the columns of `u`.
    Ts : sample time [s].
    free : names of the parameters to differentiate in; all initial states follow them.
    substeps : Runge-Kutta steps per sample.
    pinned : values that parameters always have here. A state that no output then depends on
        is simulated without sensitivities, and they are zero in what is returned.
    uneven : whether outputs were read between the samples.

    Attributes
    ----------
    is_for_many : whether many records are to come; to be set before the first.
    """

    is_for_many = False

    def __init__(
        self,
        model: Model,
        Ts: float,
        free: Sequence[str] = (),
        *,
        substeps: int = 1,
        pinned: Mapping[str, float] | None = None,
        uneven: bool = False,
    ) -> None:
        self.model, self.Ts, self.free, self.substeps = model, Ts, tuple(free), substeps
        self.equations = model.explicit()
        e = self.equations
        self.nx, self.nu, self.ny = len(e.states), len(e.inputs), len(e.outputs)
        self.nv = len(self.free) + self.nx
        felt = _felt(e, pinned or {})
        self._felt = [i for i, name in enumerate(e.states) if name in felt]
        banded = tuple(list(model.inputs).index(name) for name in band_limited(model))
        easy = STEPS.easy if substeps >= STEPS.many else 0.0
        self._stepping = Stepping(self.nu, banded, substeps, easy=easy)
        within = ca.SX.sym("within", 3 * (1 + len(banded)))
        u_next = ca.SX.sym("u_next", self.nu)
        symbols = StepSymbols(self.nx, banded, e.u, u_next, e.p, within)
        at = [
            ca.vertcat(
                *inputs_within(model, e, u_next, within[i], ca.vertsplit(within[3 + i :: 3]))
            )
            for i in range(3)
        ]
        f = ca.Function("f", [e.x, e.u, e.p], [e.f])
        x_next = rk4_step(f, e.x, e.p, at, Ts * (within[2] - within[0]))
        self.stepping = stepping_outputs(model, e, uneven=uneven)
        h = ca.Function("h", [e.x, e.u, e.p], [e.h])
        at_end = h(x_next, at[2], e.p)
        self._symbols, self._x_next = symbols, x_next
        self._before = ca.vertcat(*[at_end[i] for i in self.stepping])

    def with_courses(self, u: Array) -> Array:
        """Inputs (N, nu) of a whole record, beside them what band-limited ones do between samples.

        A part of a record is simulated with a part of what this returns: the course of a
        band-limited input depends on samples outside the part.
        """
        return self._stepping.with_courses(u)

    @functools.cached_property
    def _plain_step(self) -> Step:
        e = self.equations
        return Step("step", self._symbols, e.x, self._x_next, e.h, self._before)

    @functools.cached_property
    def _tangent_step(self) -> Step:
        e, x_next, before = self.equations, self._x_next, self._before
        columns = [e.parameters.index(name) for name in self.free]
        p_free = ca.vertcat(*[e.p[i] for i in columns])
        nf = len(self._felt)
        felt = ca.vertcat(*[e.x[i] for i in self._felt])
        felt_next = ca.vertcat(*[x_next[i] for i in self._felt])
        s = ca.SX.sym("S", nf, len(columns) + nf)

        def tangent(of: Any) -> Any:
            direct = ca.SX(of.numel(), nf)
            if columns:
                direct = ca.horzcat(ca.jacobian(of, p_free), direct)
            return ca.jacobian(of, felt) @ s + direct

        return Step(
            "tangent",
            self._symbols,
            ca.vertcat(e.x, ca.vec(s)),
            ca.vertcat(x_next, ca.vec(tangent(felt_next))),
            ca.vertcat(e.h, ca.vec(tangent(e.h))),
            ca.vertcat(before, ca.vec(tangent(before))),
        )

    def simulate(self, u: Array, p: Array, x0: Array) -> Trajectory:
        """Simulate N samples from `x0` (nx,) under `u` (N, nu) with all parameters `p` (np,).

        `u` may be as `with_courses` returned it. Values that overflow come back as inf or NaN: the
        caller reports what diverged.
        """
        u = self.with_courses(u)
        after = self._stepping.next(u)
        x, y, before = self._motion(np.ravel(x0), u, after, p)
        return Trajectory(y, np.vstack([np.reshape(x0, (1, self.nx)), x]), before=before)

    def _motion(self, x0: Array, u: Array, after: Array, p: Array) -> tuple[Array, Array, Array]:
        """States after every sample, outputs, and what is late, by the step that is quickest."""
        plain, tangent = self._plain_step, self.__dict__.get("_tangent_step")
        samples, ny = len(u) * self.substeps, self.ny
        if tangent is not None and not self._stepping.easy:  # that judges tangents as well
            if tangent.machine_code.stands_in_for(plain.machine_code, samples):
                start = np.concatenate([x0, np.zeros(tangent.n_state - len(x0))])
                x, y, _ = self._stepping.run(tangent, start, u, after, p)
                return x, y[:, :ny], y[:, tangent.n_out : tangent.n_out + len(self.stepping)]
        x, y, _ = self._stepping.run(plain, x0, u, after, p)
        return x, y[:, :ny], y[:, ny:]

    def sensitivities(
        self, u: Array, p: Array, x0: Array, *, after: Array | None = None
    ) -> Trajectory:
        """The simulation, with dy (N, ny, nv) in (free parameters, initial state).

        `after` (nu,) is the input one sample after the last, where it is known: x[N] needs it.
        """
        u = self.with_courses(u)
        if self._wide is not None:
            return self._wide_sensitivities(u, p, np.ravel(x0), self._stepping.next(u, after))
        nx, nv, ny, nf = self.nx, self.nv, self.ny, len(self._felt)
        nj, columns = len(self.stepping), nv - nx + nf
        start = np.zeros((columns, nf))
        start[nv - nx :, :] = np.eye(nf)
        xs, yd, end = self._stepping.run(
            self._tangent_step,
            np.concatenate([np.ravel(x0), start.ravel()]),
            u,
            self._stepping.next(u, after),
            p,
        )
        y, dy, before, dbefore = np.split(yd, np.cumsum([ny, columns * ny, nj]).tolist(), axis=1)
        return Trajectory(
            y=y,
            x=np.vstack([np.reshape(x0, (1, nx)), xs]),
            dy=self._widened(dy, ny),
            dx_end=self._ended(end[nx:].reshape(-1, nf)),
            before=before,
            dbefore=self._widened(dbefore, nj),
        )

    def state_tangents(self, u: Array, p: Array, x0: Array) -> tuple[Array, Array] | None:
        """States (N, nx) at the samples, and their tangents (N, nx, nv) as in `sensitivities`.

        None of a model with so many parameters that its tangents are not kept, and of one with
        states that no output depends on, whose tangents are not known.
        """
        nx, nv, nf = self.nx, self.nv, len(self._felt)
        if self._wide is not None or nf < nx:
            return None
        u = self.with_courses(u)
        start = np.zeros((nv, nf))
        start[nv - nx :, :] = np.eye(nf)
        begun = np.concatenate([np.ravel(x0), start.ravel()])
        step, after = self._kept_tangent_step, self._stepping.next(u)
        found = np.vstack([begun, self._stepping.run(step, begun, u, after, p)[0][:-1]])
        return found[:, :nx], found[:, nx:].reshape(len(u), nv, nx).transpose(0, 2, 1)

    @functools.cached_property
    def _kept_tangent_step(self) -> Step:
        """The step of which the tangents are kept of every sample."""
        return self._tangent_step.keeping_all()

    @functools.cached_property
    def _wide(self) -> WideTangents | None:
        """Sensitivities to so many parameters that one step with all tangents would be slow."""
        if len(self._felt) * len(self._columns()) < WIDE or self._stepping.easy:
            return None
        e, banded = self.equations, len(self._stepping.banded)
        place = ca.SX.sym("place", 1 + banded)
        course = ca.vertsplit(place[1:])
        at = ca.vertcat(*inputs_within(self.model, e, self._symbols.u_next, place[0], course))
        return WideTangents(
            e,
            at,
            (self._symbols.u_next, place),
            self.Ts,
            felt=self._felt,
            free=[e.parameters.index(name) for name in self.free],
            late=self.stepping,
            is_for_many=self.is_for_many,
        )

    def _wide_sensitivities(self, u: Array, p: Array, x0: Array, after: Array) -> Trajectory:
        assert self._wide is not None
        xs, y, _ = self._stepping.run(self._plain_step, x0, u, after, p)
        x = np.vstack([x0, xs])
        places = self._stepping.places(u, after).transpose(0, 1, 3, 2)
        motion = Known(x[:-1], xs, u[:, : self.nu], after, places, np.asarray(p, dtype=float))
        start = np.zeros((len(self._felt), len(self._columns())))
        start[:, len(self.free) :] = np.eye(len(self._felt))
        dy, late, end = self._wide.along(motion, start)
        return Trajectory(
            y=y[:, : self.ny],
            x=x,
            dy=self._placed(dy),
            dx_end=self._ended(end.T),
            before=y[:, self.ny :],
            dbefore=self._placed(late),
        )

    def _widened(self, flat: Array, ny: int) -> Array:
        """Sensitivities as (N, ny, nv), of each sample in one row."""
        dy = flat.reshape(len(flat), len(self._columns()), ny)
        return self._placed(dy.transpose(0, 2, 1))

    def _placed(self, dy: Array) -> Array:
        """(N, ny, nv), zeros for initial states that no output depends on."""
        if len(self._felt) == self.nx:
            return dy
        out = np.zeros((*dy.shape[:2], self.nv))
        out[:, :, self._columns()] = dy
        return out

    def _ended(self, s: Array) -> Array:
        """The last state's sensitivities as (nx, nv), with zeros where there are none."""
        out = np.zeros((self.nx, self.nv))
        out[np.ix_(self._felt, self._columns())] = s.T
        return out

    def _columns(self) -> list[int]:
        """Places of the sensitivities that are not zero among (free parameters, initial states)."""
        n = self.nv - self.nx
        return [*range(n), *(n + i for i in self._felt)]


def placed(
    out: Array | None, dy: Array, index: Array, part: slice, shape: tuple[int, int, int]
) -> Array:
    """Columns of `dy` in rows `part` of `out`, each where `index` says, -1 for nowhere.

    `out` is made, of `shape`, where it is None, or is `dy` itself where all are in their places.
    """
    if out is None:  # not before: the simulation takes as much room for itself
        if dy.shape == shape and np.array_equal(index, np.arange(shape[2])):
            return dy
        out = np.zeros(shape)
    keep, into = index >= 0, out[part]
    for first in range(0, len(dy), 1 << 13):  # some rows at a time
        rows = slice(first, first + (1 << 13))
        into[rows, :, index[keep]] = dy[rows][:, :, keep]
    return out


def _felt(e: Explicit, pinned: Mapping[str, float]) -> set[str]:
    """States that some output depends on, through other states or directly.

    Judged at random points, as terms may cancel that no structure shows to.
    """
    if not pinned:
        return set(e.states)
    slopes = ca.Function("slopes", [e.x, e.u, e.p], [ca.jacobian(ca.vertcat(e.h, e.f), e.x)])
    rng = np.random.default_rng(5)
    depends = np.zeros((len(e.outputs) + len(e.states), len(e.states)), dtype=bool)
    for _ in range(3):
        p = [
            pinned.get(name, v)
            for name, v in zip(e.parameters, rng.uniform(0.2, 1.7, e.p.numel()), strict=True)
        ]
        at = np.array(
            slopes(rng.uniform(0.2, 1.7, e.x.numel()), rng.uniform(0.2, 1.7, e.u.numel()), p)
        )
        depends |= ~(np.abs(at) < 1e-10)  # not a number counts as felt
    ny = len(e.outputs)
    felt = np.asarray(depends[:ny].any(axis=0))
    for _ in e.states:
        felt = np.asarray(felt | depends[ny:][felt].any(axis=0))
    return {name for name, is_felt in zip(e.states, felt, strict=True) if is_felt}
