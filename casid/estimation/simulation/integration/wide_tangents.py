"""Sensitivities to hundreds of parameters, along a motion that is known.

A score test asks for the sensitivity to the size of every effect of the catalogue at once. As one
recursion over samples that is an expression of 10^5 operations, interpreted sample by sample. With
the motion known, the derivatives of every stage of every step are functions of known numbers: they
are evaluated for many samples at a time, put together to those of a whole sample,

    S[k+1] = Phi[k] S[k] + Gamma[k]                                                            (1)

and only (1) goes from sample to sample. It is the derivative of the very Runge-Kutta steps. Long
records go through the same steps as machine code, where there is a compiler.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.integration.compiled_tangents import (
    LEAST,
    CompiledTangents,
    Formula,
)
from casid.estimation.simulation.integration.stepping import with_constants
from casid.model.explicit_form import Explicit
from casid.time_limit import require_time

WIDE = 250
"""Tangents of all states from which on they are computed so: fewer are as fast as one step, and a
compiler has that step translated in a second."""

NUMBERS = 2_000_000
"""Of derivatives that are held at a time, 16 MB."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """A motion, sample by sample.

    Attributes
    ----------
    x, after : (N, nx) states at a sample, and one sample later.
    u, u_next : (N, nu) inputs there.
    places : (N, substeps, 3, 1 + banded) shares of the sample at which a step begins, has its
        middle and ends, each with the values of band-limited inputs.
    p : (np,) all parameters.
    """

    x: Array
    after: Array
    u: Array
    u_next: Array
    places: Array
    p: Array


_Point = tuple[Array, Array, Array, Array, Array]
"""States, inputs, inputs a sample later, parameters, place within a sample."""


class WideTangents:
    """Sensitivities of states and outputs to many parameters and to the initial state.

    Parameters
    ----------
    e : the equations; of its states only `felt` are differentiated.
    at : the inputs at `place`, an expression of those of the sample, of `u_next` and `place`.
    free : places of the parameters to differentiate in.
    late : places of the outputs that are wanted at the end of a sample, too.
    is_for_many : many records are to come, which are worth compiled steps however short they are.
    """

    def __init__(
        self,
        e: Explicit,
        at: Any,
        symbols: tuple[Any, Any],
        Ts: float,
        *,
        felt: Sequence[int],
        free: Sequence[int],
        late: Sequence[int],
        is_for_many: bool = False,
    ) -> None:
        self.least = 0 if is_for_many else LEAST
        self.Ts, self.n_felt, self.n_free = Ts, len(felt), len(free)
        u_next, place = symbols
        x, p = (ca.vertcat(*[v[i] for i in of]) for v, of in ((e.x, felt), (e.p, free)))
        given = [e.x, e.u, u_next, e.p, place]

        def slopes(name: str, value: Any, rows: Sequence[int]) -> _Slopes:
            chosen = ca.vertcat(ca.SX(0, 1), *[value[i] for i in rows])
            return _Slopes(name, given, value, ca.jacobian(chosen, x), ca.jacobian(chosen, p))

        f, h = (ca.Function("of", [e.x, e.u, e.p], [v]) for v in (e.f, e.h))
        self._rate = slopes("rate", f(e.x, at, e.p), felt)
        self._out = slopes("out", e.h, range(len(e.outputs)))
        self._late = slopes("late", h(e.x, at, e.p) if late else ca.SX(0, 1), late)

    def along(self, motion: Known, start: Array) -> tuple[Array, Array, Array]:
        """Tangents of the outputs (N, ny, nc), of the late ones, and of the last state (nf, nc).

        Parameters
        ----------
        start : (nf, nc) tangents of the first state; nc are parameters, then initial states.
        """
        N, columns = len(motion.x), start.shape[1]
        if N * motion.places.shape[1] >= self.least and self._compiled is not None:
            formulas = (self._rate, self._out, self._late)
            given = (motion.x, motion.after, motion.u, motion.u_next, motion.places)
            constants = [of.constants(motion.p) for of in formulas]
            require_time("simulation")
            return self._compiled.along(given, constants, self.Ts, start)
        dy = np.empty((N, self._out.rows, columns))
        late = np.empty((N, self._late.rows, columns))
        count = min(max(NUMBERS // (4 * self.n_felt * columns), 16), N)
        state = start
        for first in range(0, N, count):
            require_time("simulation")
            part = slice(first, min(first + count, N))
            states, state = self._states(motion, part, state)
            x, u, u_next = motion.x[part], motion.u[part], motion.u_next[part]
            places = motion.places[part]
            at = (x, u, u_next, motion.p, places[:, 0, 0])
            _, dy[part] = self._out.along(at, states[:-1])
            if self._late.rows:
                at = (motion.after[part], u, u_next, motion.p, places[:, -1, 2])
                _, late[part] = self._late.along(at, states[1:])
        return dy, late, state

    @functools.cached_property
    def _compiled(self) -> CompiledTangents | None:
        """The same as machine code; None where there is no compiler."""
        formulas = [of.compiled() for of in (self._rate, self._out, self._late)]
        return CompiledTangents.of(formulas)

    def _states(self, motion: Known, part: slice, state: Array) -> tuple[Array, Array]:
        """(n + 1, nf, nc) tangents of the states at samples, and those one sample later."""
        phi, gamma = self._samples(motion, part)
        states = np.empty((len(phi) + 1, *state.shape))
        states[0] = state
        for k in range(len(phi)):
            np.matmul(phi[k], states[k], out=states[k + 1])
            states[k + 1, :, : self.n_free] += gamma[k]
        return states, states[-1].copy()

    def _samples(self, motion: Known, part: slice) -> tuple[Array, Array]:
        """Phi (n, nf, nf) and Gamma (n, nf, np) of (1)."""
        x, places = motion.x[part], motion.places[part]
        u, u_next = motion.u[part], motion.u_next[part]
        n, nf = len(x), self.n_felt
        whole = np.zeros((n, nf, nf + self.n_free))
        whole[:, :, :nf] = np.eye(nf)
        for i in range(places.shape[1]):
            h = self.Ts * (places[:, i, 2, 0] - places[:, i, 0, 0])
            k, dk, mean, dmean = np.zeros_like(x), np.zeros(1), np.zeros(1), np.zeros(1)
            for reach, j, weight in ((0.0, 0, 1.0), (0.5, 1, 2.0), (0.5, 1, 2.0), (1.0, 2, 1.0)):
                at = x + reach * h[:, None] * k
                reached = whole + (reach * h[:, None, None]) * dk
                point = (at, u, u_next, motion.p, places[:, i, j])
                k, dk = self._rate.along(point, reached, first=nf)
                mean, dmean = mean + weight * k, dmean + weight * dk
            x = x + h[:, None] / 6 * mean
            whole = whole + h[:, None, None] / 6 * dmean
        return whole[:, :, :nf], whole[:, :, nf:]


class _Slopes:
    """An expression, and its derivatives in states and parameters, for many samples at once.

    Parameters
    ----------
    given : states, inputs, inputs a sample later, parameters, place within the sample.
    """

    def __init__(self, name: str, given: Sequence[Any], value: Any, a: Any, b: Any) -> None:
        self.rows, self.n_felt, self.n_free = a.shape[0], a.shape[1], b.shape[1]
        self._row, self._column = (
            np.array(each, dtype=int) for each in (b.sparsity().row(), b.sparsity().get_col())
        )
        self._ends = np.cumsum([value.numel(), a.numel()])
        slopes = ca.vertcat(ca.SX(0, 1), *b.nonzeros())
        of, own, self._constants = with_constants(ca.veccat(value, a, slopes), given[3])
        arguments = [*given[:3], own, given[4]]
        self._function = ca.Function(name, arguments, [ca.densify(of)])
        self._mapped: dict[int, tuple[Any, Any]] = {}

    def constants(self, p: Array) -> Array:
        """What the function takes in the place of all parameters `p` (np,)."""
        return np.asarray(self._constants(p), dtype=float).ravel()

    def compiled(self) -> Formula | None:
        """The same as machine code; None where there is no compiler."""
        places = (self._row, self._column)
        return Formula.of(self._function, int(self._ends[0]), self.rows, places)

    def at(self, point: _Point) -> tuple[Array, Array, Array]:
        """Value (n, ...), derivatives in states (n, rows, nf), those in parameters that are not 0.

        The last are (n, nz), at `_row` and `_column` of (rows, np).
        """
        x, u, u_next, p, place = point
        n = len(x)
        if n not in self._mapped:
            mapped = self._function.map("mapped", "serial", n, [3], [])
            self._mapped[n] = mapped.buffer()
        buffer, trigger = self._mapped[n]
        own = self.constants(p)
        given = [np.ascontiguousarray(each) for each in (x, u, u_next, own, place)]
        found = np.empty((n, self._function.numel_out(0)))
        for i, argument in enumerate(given):
            if argument.size:
                buffer.set_arg(i, argument.data)
        if found.size:
            buffer.set_res(0, found.data)
        trigger()
        value, a, slopes = np.split(found, self._ends, axis=1)
        return value, a.reshape(n, self.n_felt, self.rows).transpose(0, 2, 1), slopes

    def along(self, point: _Point, states: Array, *, first: int = 0) -> tuple[Array, Array]:
        """The value, and (n, rows, nc) its tangent along tangents of the states.

        Parameters
        ----------
        first : column of the first parameter.
        """
        value, a, slopes = self.at(point)
        out = np.matmul(a, states)
        out[:, self._row, first + self._column] += slopes
        return value, out
