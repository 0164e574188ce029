"""A recursion over samples, each of several steps, interpreted by CasADi or as machine code."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.integration.band_limited import between_samples
from casid.estimation.simulation.integration.machine_code import MachineCode
from casid.time_limit import require_time

BLOCK = 200
"""Samples that one mapped CasADi function steps through."""

_NESTED = {"base": 4}
"""A mapped function is made of functions of four steps, those of four, and so on: to make one takes
half as long as with CasADi's own ten, to run it 3 % longer."""


@dataclass(frozen=True, slots=True, eq=False)
class StepSymbols:
    """The symbols of which a step is an expression.

    Attributes
    ----------
    kept : leading entries of the state that are kept of every sample.
    banded : columns of `u` that are band-limited between samples.
    within : shares of a sample at which the step begins, has its middle and ends, then the values
        of every band-limited input there.
    """

    kept: int
    banded: tuple[int, ...]
    u: Any
    u_next: Any
    p: Any
    within: Any


def with_constants(of: Any, p: Any) -> tuple[Any, Any, Any]:
    """An expression in symbols for what depends on `p` alone, those, and their values from `p`."""
    of, found, constants = ca.extract_parametric(of, p)
    left = ca.which_depends(of, p, 1, False)
    bare = [s for s, is_met in zip(ca.vertsplit(p), left, strict=True) if is_met]
    values = ca.Function("constants", [p], [ca.densify(ca.vertcat(*constants, *bare))])
    return of, ca.vertcat(*found, *bare), values


class Step:
    """A step as a function of state, inputs, inputs a sample later, parameters, place in a sample.

    It gives the next state, `out` at its beginning, which is wanted of the first step of a sample,
    and `late` at its end, which is wanted of the last.

    What depends on the parameters alone is computed once a run, by the same operations.
    """

    def __init__(
        self, name: str, symbols: StepSymbols, state: Any, after: Any, out: Any, late: Any
    ) -> None:
        self.n_state, self.n_out, self.n_late = after.numel(), out.numel(), late.numel()
        self.kept, self._banded = symbols.kept, symbols.banded
        p, ends = symbols.p, np.cumsum([0, self.n_state, self.n_out, self.n_late]).tolist()
        both, own, self._constants = with_constants(ca.veccat(after, out, late), p)
        results = [ca.densify(each) for each in ca.vertsplit(both, ends)]
        arguments = [state, symbols.u, symbols.u_next, own, symbols.within]
        self._function = ca.Function(name, arguments, results)
        self._block: tuple[int, Any, Any] | None = None
        self._easy_block: tuple[int, int, Any, Any] | None = None
        self.machine_code = MachineCode(self._function, symbols.kept, symbols.banded)

    def keeping_all(self) -> Step:
        """The same step, of which the whole state is kept of every sample."""
        new = copy.copy(self)
        new.kept = self.n_state
        new.machine_code = MachineCode(self._function, new.kept, self._banded)
        return new

    def constants(self, p: Array) -> Array:
        """Constants that the function takes in the place of all parameters `p` (np,)."""
        return np.asarray(self._constants(np.asarray(p, dtype=float)), dtype=float).ravel()

    def block(self, n: int) -> tuple[int, Any, Any]:
        """Length, buffer and trigger of the function mapped over `n` steps or more."""
        if self._block is None or self._block[0] < n:
            self._block = (n, *self._function.mapaccum("block", n, _NESTED).buffer())
        return self._block

    def easy_block(self, n: int, substeps: int, easy: float) -> tuple[int, Any, Any]:
        """A function of whole samples: two steps each where exact, `substeps` elsewhere.

        It takes state, inputs, inputs a sample later and parameters.
        """
        if self._easy_block is None or self._easy_block[0] < n or self._easy_block[1] != substeps:
            sample = self._sample(substeps, easy)
            self._easy_block = (n, substeps, *sample.mapaccum("block", n, _NESTED).buffer())
        return self._easy_block[0], *self._easy_block[2:]

    def _sample(self, substeps: int, easy: float) -> Any:
        """One sample as a function; the machine code takes the same steps in the same order."""
        step = self._function
        given = [ca.MX.sym(step.name_in(i), step.numel_in(i)) for i in range(4)]
        state = given[0]
        shares = np.arange(2 * substeps + 1) / (2 * substeps)
        run = step.mapaccum("run", substeps)
        repeated = [ca.repmat(each, 1, substeps) for each in given[1:]]
        ends, _, lates = run(state, *repeated, ca.DM(_triples(shares)).T)
        nothing = [ca.MX.sym("next", self.n_state), ca.MX.sym("late", self.n_late)]
        steps = ca.Function("steps", [*given, *nothing], [ends[:, -1], lates[:, -1]])
        whole = np.arange(3) / 2  # shares of the sample: beginning, middle and end of one step
        once, out, _ = step(*given, whole)
        half, _, _ = step(*given, whole / 2)
        twice, _, late = step(half, *given[1:], (1 + whole) / 2)
        two = ca.Function("two", [*given, *nothing], nothing)
        # Sensitivities too: at rest a step that is far too long leaves the states where they are.
        size = ca.fmax(ca.fabs(state), ca.fabs(twice))
        is_exact = ca.fabs(twice - once) <= easy * size
        chosen = ca.Function.if_else("chosen", two, steps)
        end, late = chosen(ca.sum1(is_exact) == self.n_state, *given, twice, late)
        return ca.Function("sample", given, [end, out, late])


class Stepping:
    """How steps run through samples: columns of the inputs, and steps a sample.

    Parameters
    ----------
    columns : of the inputs, those of `u` and `u_next` of a step.
    banded : which of them are band-limited between samples.
    substeps : steps a sample.
    easy : the share of the state to which one step of a sample and two of half of it agree where
        the two are taken in the place of all; 0: nowhere. Dry friction needs many steps where it
        reverses, and nowhere else.
    """

    def __init__(
        self, columns: int, banded: Sequence[int], substeps: int, *, easy: float = 0.0
    ) -> None:
        self.columns, self.banded, self.substeps = columns, tuple(banded), substeps
        self._shares = np.arange(2 * substeps + 1) / (2 * substeps)
        self.easy = 0.0 if banded else easy

    def with_courses(self, u: Array) -> Array:
        """Inputs (N, columns) of a whole record, beside them the courses of band-limited ones.

        A part of a record takes a part of what this returns: the course of a band-limited input
        between samples depends on samples outside the part.
        """
        if not self.banded or u.shape[1] > self.columns:
            return u
        inside = between_samples(u[:, list(self.banded)], 2 * self.substeps)
        return np.hstack([u, inside.reshape(len(u), -1)])

    def next(self, u: Array, after: Array | None = None) -> Array:
        """The inputs one sample later; the last is held unless the one after it is given."""
        last = (u[-1:] if after is None else after[None])[:, : self.columns]
        return np.concatenate([u[1:, : self.columns], last])

    def run(
        self, step: Step, start: Array, u: Array, after: Array, p: Array
    ) -> tuple[Array, Array, Array]:
        """The states kept after each sample (N, kept), the outputs (N, ...) and the last state.

        Blocks keep the mapped functions few and small; CasADi reads and writes the arrays in place.
        Sensitivities of states are as many as those of outputs and more, and serve the next step
        alone: they are not kept.
        """
        require_time("simulation")
        n_state, n_out, n_late = step.n_state, step.n_out, step.n_late
        states, outputs = np.empty((len(u), step.kept)), np.empty((len(u), n_out + n_late))
        state = np.ascontiguousarray(start, dtype=float)
        u, after = np.ascontiguousarray(u), np.ascontiguousarray(after)
        if (steps := step.machine_code.before(len(u) * self.substeps)) is not None:
            state = state.copy()
            constants = step.constants(p)
            steps(state, u, after, constants, self._shares, states, outputs, self.easy)
            return states, outputs, state
        fine = 1 if self.easy else self.substeps
        wanted = min(max(BLOCK // fine, 1), max(len(u), 1)) * fine
        size, buffer, trigger = (
            step.easy_block(wanted, self.substeps, self.easy) if self.easy else step.block(wanted)
        )
        samples = size // fine
        inside = np.empty((size, n_state))
        given, last_given = np.empty((size, n_out)), np.empty((size, n_late))
        repeated = np.tile(step.constants(p), (size, 1))
        for first in range(0, len(u), samples):
            last = min(first + samples, len(u))
            n = (last - first) * fine
            require_time("simulation")
            # The last block goes on with its last inputs: another function would take longer.
            around = [_lengthened(each[first:last], samples) for each in (u, after)]
            columns = [np.repeat(each[:, : self.columns], fine, axis=0) for each in around]
            arguments = [state, *columns, repeated]
            if not self.easy:
                places = self.places(*around)
                arguments.append(places.reshape(len(places) * fine, -1))
            for i, argument in enumerate(arguments):
                if argument.size:
                    buffer.set_arg(i, argument.data)
            for i, result in enumerate((inside, given, last_given)):
                if result.size:
                    buffer.set_res(i, result.data)
            trigger()
            states[first:last] = inside[fine - 1 : n : fine, : step.kept]
            outputs[first:last, :n_out] = given[:n:fine]
            outputs[first:last, n_out:] = last_given[fine - 1 : n : fine]
            state = inside[n - 1].copy()
        return states, outputs, state

    def places(self, u: Array, after: Array) -> Array:
        """Place of every step within its sample, (N, substeps, 1 + banded, 3)."""
        out = np.empty((len(u), self.substeps, 1 + len(self.banded), 3))
        out[:, :, 0] = _triples(self._shares)
        for b, column in enumerate(self.banded):
            begin, end = u[:, column], after[:, column]
            first = self.columns + b * (2 * self.substeps - 1)
            inner = u[:, first : first + 2 * self.substeps - 1]
            course = np.column_stack([begin, inner, begin + (end - begin)])
            for j in range(3):
                out[:, :, 1 + b, j] = course[:, j : j + 2 * self.substeps : 2]
        return out


def _triples(shares: Array) -> Array:
    """(steps, 3) beginning, middle and end of every step."""
    return np.column_stack([shares[j : j + len(shares) - 2 : 2] for j in range(3)])


def _lengthened(u: Array, samples: int) -> Array:
    """Inputs (n, ...) as many `samples` long, the last one held."""
    return u if len(u) == samples else np.pad(u, ((0, samples - len(u)), (0, 0)), mode="edge")
