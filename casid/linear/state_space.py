"""A linear system in state space: its poles, its frequency response, and how one is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.algebra.roots import Root
from casid.arrays import Array
from casid.errors import ModelError
from casid.linear.stability import LAST_STABLE, modulus_text, spectral_radius

_NUMBERS = 1_600_000  # numbers in the matrices that are solved at once


@dataclass(frozen=True, slots=True, eq=False)
class StateSpace:
    """x+ = A x + B e, s = C x + D e (dx/dt for x+ where Ts is 0).

    Attributes
    ----------
    A (n, n), B (n, ne), C (ns, n), D (ns, ne)
    signals : names of its outputs s.
    Ts : sample time [s]; 0 in continuous time, None where none is stated.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    signals: tuple[str, ...] = ()
    Ts: float | None = None

    def poles(self) -> tuple[Root, ...]:
        """Eigenvalues of A, largest first; hidden modes among them."""
        found = sorted(np.linalg.eigvals(self.A), key=lambda x: (-abs(x), -x.imag))
        variable = "s" if self.Ts == 0 else "q"
        return tuple(Root(complex(x), variable, self.Ts) for x in found)

    def response(self, z: Array) -> Array:
        """C (zI - A)^-1 B + D at the points z (M,), (M, ns, ne)."""
        eye = np.eye(len(self.A))
        block = max(1, _NUMBERS // max(1, self.A.size))
        parts = []
        for first in range(0, len(z), block):
            shifted = z[first : first + block, None, None] * eye - self.A
            right = np.broadcast_to(self.B, (len(shifted), *self.B.shape))
            parts.append(self.C @ np.linalg.solve(shifted, right) + self.D)
        return np.concatenate(parts)


def checked_state_space(
    system: Any, externals: Sequence[str], signals: Sequence[str] | None, Ts: float | None
) -> StateSpace:
    """A stable discrete state space as a user gives it, columns in the order of the externals.

    Raises
    ------
    ModelError
        If shapes, names or sample times disagree, or the system is of continuous time or unstable.
    """
    if hasattr(system, "isdtime"):
        if not system.isdtime(strict=True):
            raise ModelError(
                "the state space is of continuous time; sample it, control.sample_system(sys, Ts)"
            )
        labels = list(system.input_labels)
        if set(labels) == set(externals):
            system = system[:, [labels.index(name) for name in externals]]
        own = None if system.dt is True else float(system.dt)
        if own is not None and Ts is not None and not np.isclose(own, Ts, rtol=1e-9, atol=0):
            raise ModelError(f"the state space has sample time {own:g} s, Ts = {Ts:g} s; give one")
        Ts = own if own is not None else Ts
        signals = list(system.output_labels) if signals is None else signals
        system = (system.A, system.B, system.C, system.D)
    try:
        A, B, C, D = (np.atleast_2d(np.asarray(m, dtype=float)) for m in system)
    except (TypeError, ValueError):
        raise ModelError(
            "a state space is (A, B, C, D), four matrices of numbers, or a python-control one"
        ) from None
    nx, ne, ny = len(A), len(externals), len(C)
    wanted = {"A": (nx, nx), "B": (nx, ne), "C": (ny, nx), "D": (ny, ne)}
    for name, matrix in (("A", A), ("B", B), ("C", C), ("D", D)):
        if matrix.shape != wanted[name]:
            raise ModelError(
                f"{name} has shape {matrix.shape}, not {wanted[name]}, for {nx} states, "
                f"{ny} signals and the {ne} externals {', '.join(externals)}; give one column of B "
                "and D for each external"
            )
    if signals is None or len(signals) != ny:
        raise ModelError(
            f"{ny} outputs and {'no' if signals is None else len(signals)} names; give "
            "signals=[..], one name for each row of C"
        )
    if spectral_radius(A) >= LAST_STABLE:
        poles = np.linalg.eigvals(A)
        worst = poles[np.argmax(np.abs(poles))]
        raise ModelError(
            f"A has the eigenvalue {worst:.4g}, {modulus_text(abs(worst))}: the signals are not "
            "stationary and an estimate has no limit. Give the stable closed loop"
        )
    return StateSpace(A, B, C, D, tuple(signals), None if Ts is None else float(Ts))
