"""Linear systems with process and measurement noise, and their exact sampling.

    x[t+1] = A x[t] + B u[t] + w[t],    y[t] = C x[t] + D u[t] + v[t],                      (1)
    cov [w; v] = [Q S; S' R], white.

Source: (2.25)-(2.28) of Linder (2017).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.linalg import expm

from casid.arrays import Array
from casid.data.record import Record
from casid.errors import ModelError


@dataclass(frozen=True, slots=True, eq=False)
class NoisySystem:
    """System (1), sampled.

    Parameters
    ----------
    A (nx, nx), B (nx, nu), C (ny, nx), D (ny, nu)
    Q (nx, nx), R (ny, ny), S (nx, ny) : covariances of w and v, and E[w v'] (default zero).
    Ts : sample time [s].
    states, outputs, inputs : names, for messages and for python-control.

    Raises
    ------
    ModelError
        For shapes that do not fit, or a noise covariance that is not symmetric or not positive
        semidefinite.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    Q: Array
    R: Array
    S: Array = field(default_factory=lambda: np.zeros((0, 0)))
    Ts: float = 1.0
    states: Sequence[str] = ()
    outputs: Sequence[str] = ()
    inputs: Sequence[str] = ()

    def __post_init__(self) -> None:
        n, ny = len(np.atleast_2d(self.A)), len(np.atleast_2d(self.C))
        if not np.size(self.S):
            object.__setattr__(self, "S", np.zeros((n, ny)))
        nu = np.atleast_2d(self.B).shape[1]
        shapes = {
            "A": (n, n),
            "B": (n, nu),
            "C": (ny, n),
            "D": (ny, nu),
            "Q": (n, n),
            "S": (n, ny),
            "R": (ny, ny),
        }
        for name, shape in shapes.items():
            value = np.atleast_2d(np.asarray(getattr(self, name), dtype=float))
            if value.shape != shape:
                raise ModelError(
                    f"noisy system: {name} is {value.shape}, but {n} states, {ny} outputs and {nu} "
                    f"inputs need {shape}; check how it was built"
                )
            if not np.all(np.isfinite(value)):
                raise ModelError(
                    f"noisy system: {name} holds entries that are not finite; check the parameters "
                    "it was computed from"
                )
            object.__setattr__(self, name, value)
        joint = np.block([[self.Q, self.S], [self.S.T, self.R]])
        size = np.sqrt(np.maximum(np.diag(joint), 0.0))
        unit = joint / np.outer(np.where(size > 0, size, 1.0), np.where(size > 0, size, 1.0))
        if not np.allclose(unit, unit.T, atol=1e-9):
            raise ModelError(
                "noisy system: the covariance [Q S; S' R] is not symmetric; give Q and R as "
                "0.5 * (Q + Q.T)"
            )
        smallest = float(np.linalg.eigvalsh(unit)[0]) if len(unit) else 0.0
        if smallest < -1e-9 or float(np.min(np.diag(joint), initial=0.0)) < 0.0:
            raise ModelError(
                f"noisy system: the covariance [Q S; S' R] is not positive semidefinite (smallest "
                f"eigenvalue {smallest:.2g} after scaling); build it as G G' from the noise gains"
            )

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return int(self.B.shape[1])

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return len(self.C)

    def state_name(self, i: int) -> str:
        """The name of a state, or its number."""
        return str(self.states[i]) if self.states else f"x{i + 1}"

    def output_name(self, i: int) -> str:
        """The name of an output, or its number."""
        return str(self.outputs[i]) if self.outputs else f"y{i + 1}"

    def input_name(self, i: int) -> str:
        """The name of an input, or its number."""
        return str(self.inputs[i]) if self.inputs else f"u{i + 1}"

    def signals(self, y: Any, u: Any = None) -> tuple[Array, Array]:
        """Outputs (N, ny) and inputs (N, nu), default zero, from arrays of one axis or two.

        Raises
        ------
        ModelError
            If the shapes are not those of the system, or a record is given for arrays.
        """
        for name, given, count, of in (
            ("y", y, self.ny, self.output_name),
            ("u", u, self.nu, self.input_name),
        ):
            if isinstance(given, Record | Mapping):
                channels = ", ".join(f"record[{of(i)!r}]" for i in range(count))
                raise ModelError(
                    f"{name} is a {type(given).__name__}; give an array (N, {count}), "
                    f"{name}=np.column_stack([{channels}])"
                )
        y = np.asarray(y, dtype=float)
        y = y[:, None] if y.ndim == 1 else y
        N = len(y) if y.ndim else 1
        u = np.zeros((N, self.nu)) if u is None else np.asarray(u, dtype=float)
        u = u[:, None] if u.ndim == 1 else u
        if y.ndim != 2 or y.shape[1] != self.ny or u.shape != (N, self.nu):
            raise ModelError(
                f"signals are y {y.shape} and u {u.shape}, but the system has {self.ny} outputs "
                f"and {self.nu} inputs; give y (N, {self.ny}) and u (N, {self.nu})"
            )
        return y, u


# -- sampling -----------------------------------------------------------------------------------


def sample_system(
    A: Array, B: Array, C: Array, D: Array, Ts: float, hold: Sequence[str]
) -> tuple[Array, Array, Array, Array, Array]:
    """Exact sampling of dx/dt = A x + B u, y = C x + D u: (Ad, Bd, C, Dd, shift).

    Inputs are held (``"zoh"``) or joined by straight lines (``"foh"``). For ``foh`` the state of
    the sampled system is x - shift u, which keeps form (1): x[t+1] = Ad x + B0 u[t] + B1 u[t+1].
    Stacks of matrices (..., rows, columns) are allowed, and complex ones (complex-step
    derivatives).
    """
    n, nu = B.shape[-2:]
    block = np.zeros((*B.shape[:-2], n + 2 * nu, n + 2 * nu), dtype=np.result_type(A, B, float))
    block[..., :n, :n], block[..., :n, n : n + nu] = A * Ts, B * Ts
    block[..., n : n + nu, n + nu :] = np.eye(nu)
    power = expm(block)
    Ad, held, ramp = (
        power[..., :n, :n],
        power[..., :n, n : n + nu],
        power[..., :n, n + nu :],
    )
    straight = np.array([h == "foh" for h in hold], dtype=float)
    shift = ramp * straight  # what u[t+1] does to x[t+1]
    return Ad, Ad @ shift + held - shift, C, D + C @ shift, shift


def sample_noise(A: Array, W: Array, Ts: float) -> Array:
    """Covariance over one sample of dx/dt = A x + white noise of intensity W: (..., nx, nx).

    Q = int_0^Ts e^(A s) W e^(A' s) ds. Over a step h in which nothing changes much by one matrix
    exponential (C. F. van Loan, IEEE Trans. Autom. Control 23 (1978) 395-404); then doubled,
    Q(2h) = Q(h) + e^(A h) Q(h) e^(A' h), which adds and never subtracts: van Loan's formula alone
    holds e^(-A Ts), and loses all digits where a mode decays fast within a sample.
    Stacks and complex matrices as in `sample_system`.
    """
    n = A.shape[-1]
    shape = np.broadcast_shapes(A.shape, W.shape)[:-2]
    norm = float(np.max(np.sum(np.abs(A), axis=-1), initial=0.0)) * Ts
    doublings = max(0, int(np.ceil(np.log2(norm)))) if np.isfinite(norm) and norm > 0 else 0
    h = Ts / 2.0**doublings
    block = np.zeros((*shape, 2 * n, 2 * n), dtype=np.result_type(A, W, float))
    block[..., :n, :n], block[..., :n, n:] = -A * h, W * h
    block[..., n:, n:] = A.swapaxes(-1, -2) * h
    power = expm(block)
    F = power[..., n:, n:].swapaxes(-1, -2)
    Q = F @ power[..., :n, n:]
    for _ in range(doublings):
        Q = Q + F @ Q @ F.swapaxes(-1, -2)
        F = F @ F
    return np.asarray((Q + Q.swapaxes(-1, -2)) / 2)
