"""Linear systems with known and unknown inputs.

    dx/dt = A x + B u_K + E u_U,    y = C x + D u_K + F u_U                                 (1)

in continuous time, x[t+1] for dx/dt in discrete time: (3.69) of Linder (2017).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.data.record import Record
from casid.errors import DataError, ModelError, nearest
from casid.linear.filtering.noisy_system import sample_system
from casid.model.units import same_dimension


@dataclass(frozen=True, slots=True, eq=False)
class UnknownInputSystem:
    """System (1).

    Parameters
    ----------
    A (nx, nx), B (nx, nk), E (nx, nu), C (ny, nx), D (ny, nk), F (ny, nu)
    Ts : sample time [s] of a discrete-time system, 0 in continuous time.
    states, known, unknown, outputs : names, by default x1.., k1.., u1.., y1..
    units : name of a signal -> its SI unit, as far as they are known.
    holds : known input -> "zoh" or "foh", what it does between samples; default "foh".

    Raises
    ------
    ModelError
        For shapes that do not fit, entries that are not finite, names that are not distinct, or
        no unknown input.
    """

    A: Array
    B: Array
    E: Array
    C: Array
    D: Array
    F: Array
    Ts: float = 0.0
    states: tuple[str, ...] = ()
    known: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    holds: Mapping[str, str] = field(default_factory=dict)
    name: str = "system"

    def __post_init__(self) -> None:
        for letter in "ABECDF":
            value = np.atleast_2d(np.array(getattr(self, letter), dtype=float))
            object.__setattr__(self, letter, value)
        n, ny = len(self.A), len(self.C)
        nk, nu = self.B.shape[1], self.E.shape[1]
        shapes = {"A": (n, n), "B": (n, nk), "E": (n, nu)}
        shapes |= {"C": (ny, n), "D": (ny, nk), "F": (ny, nu)}
        for letter, shape in shapes.items():
            value = getattr(self, letter)
            if value.shape != shape:
                raise ModelError(
                    f"{self.name}: {letter} is {value.shape}, but {n} states, {nk} known and {nu} "
                    f"unknown inputs and {ny} outputs need {shape}; give zeros where nothing acts"
                )
            if not np.all(np.isfinite(value)):
                raise ModelError(
                    f"{self.name}: {letter} holds entries that are not finite; check the values "
                    "it was computed from"
                )
        if nu == 0:
            raise ModelError(
                f"{self.name} has no unknown input; name one with unknown='...', or use an "
                "ordinary observer (casid.linear.filtering.kalman)"
            )
        if not (np.isfinite(self.Ts) and self.Ts >= 0):
            raise ModelError(
                f"{self.name}: Ts = {self.Ts!r}; give the sample time in seconds, 0 for continuous"
            )
        for role, letter, count in (
            ("states", "x", n),
            ("known", "k", nk),
            ("unknown", "u", nu),
            ("outputs", "y", ny),
        ):
            given = tuple(getattr(self, role)) or tuple(f"{letter}{i + 1}" for i in range(count))
            if len(given) != count or len(set(given)) != count:
                raise ModelError(
                    f"{self.name}: {role} are {', '.join(given)}; give {count} different names"
                )
            object.__setattr__(self, role, given)

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def nu(self) -> int:
        """Number of unknown inputs."""
        return int(self.E.shape[1])

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.C)

    @property
    def is_discrete(self) -> bool:
        """True for a sampled system."""
        return self.Ts > 0

    def is_unstable(self, pole: complex) -> bool:
        """Whether a pole or zero does not lie in the open stability region."""
        return bool(abs(pole) >= 1 - 1e-9 if self.is_discrete else pole.real >= -1e-9)

    def sampled(self, Ts: float) -> UnknownInputSystem:
        """The system at its samples, exact where unknown inputs are held over each sample.

        Known inputs are held or joined by straight lines, as `holds` has it (default straight).
        For straight lines the state of the result is x - shift u_K (see `sample_system`), which
        makes no difference to outputs and unknown inputs.

        Raises
        ------
        ModelError
            If the system is discrete already, or Ts is not positive.
        """
        if self.is_discrete:
            raise ModelError(
                f"{self.name} is sampled already, with Ts = {self.Ts:g} s; resample the record to "
                "that time, or give the continuous system"
            )
        if not (np.isfinite(Ts) and Ts > 0):
            raise ModelError(f"{self.name}: Ts = {Ts!r}; give a positive sample time in seconds")
        hold = [self.holds.get(k, "foh") for k in self.known] + ["zoh"] * self.nu
        A, B, C, D, _ = sample_system(
            self.A, np.hstack([self.B, self.E]), self.C, np.hstack([self.D, self.F]), Ts, hold
        )
        nk = len(self.known)
        return replace(
            self, A=A, B=B[:, :nk], E=B[:, nk:], C=C, D=D[:, :nk], F=D[:, nk:], Ts=float(Ts)
        )

    def signals(self, record: Record) -> tuple[Array, Array]:
        """Outputs (N, ny) and known inputs (N, nk) of a record, NaN where samples are missing.

        Raises
        ------
        DataError
            For a channel that is lacking or has another dimension than the model's signal, a known
            input with missing samples, or another sample time.
        """
        if self.is_discrete and abs(record.Ts - self.Ts) > 1e-6 * self.Ts:
            raise DataError(
                f"{record.name}: Ts = {record.Ts:g} s, but {self.name} is sampled with "
                f"{self.Ts:g} s; resample the record, or sample the model with that time"
            )
        for name in (*self.outputs, *self.known):
            if name not in record:
                raise DataError(
                    f"{record.name}: no channel {name!r}, which {self.name} needs as "
                    f"{'an output' if name in self.outputs else 'a known input'}"
                    f"{nearest(name, record.names)}; rename it with record.rename"
                )
            unit = self.units.get(name)
            if unit is not None and not same_dimension(unit, record.units[name]):
                raise DataError(
                    f"{record.name}: {name} is in {record.units[name]}, {self.name} has it in "
                    f"{unit}; check the channel, or the model's unit"
                )
        for name in self.known:
            if record.is_missing(name).any():
                raise DataError(
                    f"{record.name}: known input {name} has missing samples; fill them with "
                    f"record.filled({name!r}), or cut them with record.between"
                )
        y = [np.where(record.is_missing(n), np.nan, record[n]) for n in self.outputs]
        u = [record[n] for n in self.known]
        return np.column_stack(y), np.column_stack(u) if u else np.zeros((record.N, 0))

    def complete_signals(self, record: Record) -> tuple[Array, Array]:
        """`signals` of a record that has every sample of every output.

        Raises
        ------
        DataError
            As `signals`, or for a missing sample.
        """
        y, u = self.signals(record)
        if not np.all(np.isfinite(y)):
            t, i = (int(v) for v in np.argwhere(~np.isfinite(y))[0])
            raise DataError(
                f"{record.name}: {self.outputs[i]} is missing at sample {t}, and every sample is "
                "needed: cut with record.between, join with record.filled, or use reconstruct_input"
            )
        return y, u

    def noise_levels(self, noise: Mapping[str, float]) -> Array:
        """(ny,) standard deviations of the outputs' noise.

        Raises
        ------
        ModelError
            If a name is no output, or an output has no positive one.
        """
        self.require_outputs(noise)
        lacking = [o for o in self.outputs if not noise.get(o, 0.0) > 0]
        if lacking:
            raise ModelError(
                f"{self.name}: no noise of {', '.join(lacking)}; give a positive standard "
                "deviation for every output (its resolution / sqrt(12) at least)"
            )
        return np.array([float(noise[o]) for o in self.outputs])

    def require_outputs(self, noise: Mapping[str, float]) -> None:
        """Refuse noise of what is no output; raises ModelError."""
        for name in noise:
            if name not in self.outputs:
                raise ModelError(f"noise names {name!r}, no output{nearest(name, self.outputs)}")

    def to_control(self) -> Any:
        """A ``control.StateSpace`` from [known, unknown] to the outputs, with names."""
        import control

        return control.StateSpace(
            self.A,
            np.hstack([self.B, self.E]),
            self.C,
            np.hstack([self.D, self.F]),
            self.Ts,
            states=list(self.states),
            inputs=[*self.known, *self.unknown],
            outputs=list(self.outputs),
            name=self.name,
        )

    def __repr__(self) -> str:
        clock = f"Ts = {self.Ts:g} s" if self.is_discrete else "continuous"
        return (
            f"<UnknownInputSystem {self.name}: {self.nx} states, known "
            f"{', '.join(self.known) or 'nothing'}, unknown {', '.join(self.unknown)}, outputs "
            f"{', '.join(self.outputs)}, {clock}>"
        )
