"""Observers whose error is decoupled from the unknown input: (3.72) of Linder (2017), simulated.

With z = x - G2 y - B2 u_K no derivative of y or u_K is needed:

    dz/dt = Abar z + (B1 + Abar B2) u_K + (G1 + Abar G2) y + K (Py y - Cbar xhat - Dbar u_K)
    xhat  = z + G2 y + B2 u_K                                                               (1)

and x - xhat obeys dx/dt = (Abar - K Cbar) x whatever the unknown input does. Discrete time alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.data.record import Record
from casid.errors import DataError, ModelError, nearest
from casid.linear.filtering.kalman import steady_state
from casid.linear.filtering.noisy_system import NoisySystem, sample_system
from casid.linear.filtering.recursion import recursion
from casid.linear.subspaces import TOLERANCE, row_space, size
from casid.unknown_inputs.observers.equivalent_model import Existence, pole_text, require_existence
from casid.unknown_inputs.observers.system_reader import unknown_input_system
from casid.unknown_inputs.observers.unknown_input_system import UnknownInputSystem


@dataclass(frozen=True, slots=True, eq=False)
class DecoupledObserver:
    """Observer (1).

    Attributes
    ----------
    K (nx, ny) : gain.
    covariance : (nx, nx) of x - xhat in the steady state, or None where no noise was given.
    """

    found: Existence
    K: Array
    covariance: Array | None = None

    @property
    def system(self) -> UnknownInputSystem:
        """The system that is observed."""
        return self.found.model.system

    @property
    def A_error(self) -> Array:
        """Abar - K Cbar, which the error x - xhat obeys."""
        return np.asarray(self.found.model.A - self.K @ self.found.model.C)

    @property
    def poles(self) -> Array:
        """(nx,) eigenvalues of Abar - K Cbar."""
        return np.asarray(np.linalg.eigvals(self.A_error))

    @property
    def matrices(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D of (1), from [u_K; y] to xhat."""
        m = self.found.model
        into = self.A_error  # K acts on xhat = z + B2 u_K + G2 y
        B = np.hstack([m.B1 + into @ m.B2 - self.K @ m.D, m.G1 + into @ m.G2 + self.K @ m.P_y])
        return into, B, np.eye(self.system.nx), np.hstack([m.B2, m.G2])

    def to_control(self) -> Any:
        """A ``control.StateSpace`` from known inputs and outputs to the estimated states."""
        import control

        s = self.system
        return control.StateSpace(
            *self.matrices,
            s.Ts,
            inputs=[*s.known, *s.outputs],
            outputs=list(s.states),
            name=f"observer of {s.name}",
        )

    def run(
        self,
        record: Record,
        *,
        x0: Mapping[str, float] | None = None,
        hold: str = "foh",
    ) -> ObservedStates:
        """The states of a record.

        Parameters
        ----------
        record : with a channel for every output and known input of the system.
        x0 : state -> estimate at the first sample; 0 for what is not given.
        hold : what the outputs do between samples, for a continuous-time observer, whose equation
            is sampled exactly: "foh" straight lines, "zoh" held. Real signals do neither: the
            error then has a part of the order Ts^2. A discrete-time observer has no such error
            (`UnknownInputSystem.sampled`) where the unknown input is held.

        Raises
        ------
        DataError
            For channels that are lacking, in another dimension, or have missing samples, another
            sample time, or a name in x0 that is no state.
        """
        s = self.system
        y, u = s.complete_signals(record)
        start = np.zeros(s.nx)
        for name, value in (x0 or {}).items():
            if name not in s.states:
                raise DataError(f"{s.name} has no state {name!r}{nearest(name, s.states)}")
            start[s.states.index(name)] = value
        A, B, C, D = self.matrices
        v = np.hstack([u, y])
        z = start - D @ v[0]
        if not s.is_discrete:
            if hold not in ("zoh", "foh"):
                raise DataError(f"hold = {hold!r}; give 'foh' or 'zoh'")
            holds = [s.holds.get(k, "foh") for k in s.known] + [hold] * s.ny
            A, B, C, D, shift = sample_system(A, B, C, D, record.Ts, holds)
            z = z - shift @ v[0]
        x = recursion(A, v @ B.T, z)[:-1] @ C.T + v @ D.T
        return ObservedStates(s.states, record.t, x, self.covariance, record.name)

    def __repr__(self) -> str:
        s = self.system
        slowest = max(self.poles, key=abs if s.is_discrete else lambda p: p.real)
        return (
            f"<DecoupledObserver of {s.name}: {s.nx} states free of {', '.join(s.unknown)}, "
            f"slowest pole {pole_text(slowest, s)}>"
        )


@dataclass(frozen=True, slots=True, eq=False)
class ObservedStates:
    """States (N, nx) of a record, as an observer has them."""

    states: tuple[str, ...]
    t: Array
    x: Array
    covariance: Array | None
    record: str

    def __getitem__(self, state: str) -> Array:
        """(N,) estimate of a state."""
        return np.asarray(self.x[:, self._index(state)])

    def std_error(self, state: str) -> float:
        """Standard deviation of a state's estimate in the steady state, of the stated noise.

        Raises
        ------
        ModelError
            If the observer was designed without noise.
        """
        if self.covariance is None:
            raise ModelError(
                "no noise was given, so no standard deviation is known; design the observer with "
                "noise={output: standard deviation}"
            )
        i = self._index(state)
        return float(np.sqrt(self.covariance[i, i]))

    def _index(self, state: str) -> int:
        if state not in self.states:
            raise DataError(f"no state {state!r}{nearest(state, self.states)}")
        return self.states.index(state)

    def __repr__(self) -> str:
        return f"<ObservedStates of {self.record}: {', '.join(self.states)}, N = {len(self.t)}>"


def decoupled_observer(
    system: Any,
    unknown: Sequence[str] | str | None = None,
    *,
    poles: Sequence[complex] | None = None,
    noise: Mapping[str, float] | None = None,
    process: Array | None = None,
    values: Mapping[str, float] | None = None,
    tolerance: float = TOLERANCE,
) -> DecoupledObserver:
    """An observer whose error is decoupled from the unknown input.

    Parameters
    ----------
    system, unknown, values : as in `unknown_input_system`.
    poles : of the error, in s or z; as many as states that (Abar, Cbar) observes. Poles of the
        others are the (stable) zeros, which no gain moves.
    noise : output -> standard deviation of its white noise, instead of poles: the gain of least
        variance, from the steady-state Riccati equation. Discrete-time systems alone: white noise
        in continuous time has no finite variance, and G2 y would pass it on.
    process : (nx, nx) covariance of white noise on the states of each sample, with `noise`.
    tolerance : see `equivalent_model`.

    Raises
    ------
    ModelError
        If there is no such observer: with the transmission zero that forbids it, or the input that
        acts on no output soon enough. For both or neither of poles and noise, poles of a wrong
        number, not closed under conjugation or not stable, or noise in continuous time.
    """
    s = unknown_input_system(system, unknown, values=values)
    found = require_existence(s, tolerance=tolerance)
    if (poles is None) == (noise is None):
        raise ModelError(
            f"{s.name}: give either poles=[...] ({s.nx - found.hidden.shape[1]} of them) or "
            "noise={output: standard deviation}, which chooses them"
        )
    if poles is not None:
        return DecoupledObserver(found, _placed(found, np.asarray(poles, dtype=complex)))
    return _least_variance(found, noise or {}, process)


def _placed(found: Existence, poles: Array) -> Array:
    from scipy.signal import place_poles

    m, s = found.model, found.model.system
    V = found.hidden
    observed = row_space(np.eye(s.nx) - V @ V.T, 0.5).T  # the orthogonal complement
    m_poles = observed.shape[1]
    if len(poles) != m_poles:
        fixed = ", ".join(pole_text(p, s) for p in found.fixed_poles)
        raise ModelError(
            f"{s.name}: {len(poles)} poles given, but {m_poles} can be placed"
            + (f"; {fixed} are zeros and stay where they are" if fixed else "")
            + f"; give {m_poles}"
        )
    if any(s.is_unstable(p) for p in poles):
        raise ModelError(
            f"{s.name}: the poles {', '.join(pole_text(p, s) for p in poles)} are not all stable; "
            f"give {'|z| < 1' if s.is_discrete else 'negative real parts'}"
        )
    if m_poles == 0:
        return np.zeros((s.nx, s.ny))
    A = observed.T @ m.A @ observed
    U = row_space(m.C.T, TOLERANCE * size(m.C))  # what ybar spans: Cbar is rank-deficient
    C = U @ m.C @ observed
    real = poles.real if not np.any(poles.imag) else poles
    try:
        gain = place_poles(A.T, C.T, real).gain_matrix.T
    except ValueError as error:
        raise ModelError(
            f"{s.name}: the poles cannot be placed ({error}); give complex ones in conjugate "
            f"pairs, and no pole more than {len(C)} times"
        ) from error
    return np.asarray(observed @ gain @ U)


def _least_variance(
    found: Existence, noise: Mapping[str, float], process: Array | None
) -> DecoupledObserver:
    """The gain of least variance: noise v of y enters (1) through G1, G2 and K.

    z - zhat obeys e[t+1] = (Abar - K Cbar) e + (I - G2 C) w - Gz v - K (Py - Cbar G2) v with
    Gz = G1 + Abar G2; the part of ybar that made G2 holds nothing more, and is left out.
    """
    m, s = found.model, found.model.system
    if not s.is_discrete:
        raise ModelError(
            f"{s.name} is in continuous time, where white noise through G2 y has no finite "
            "variance; sample it first, system.sampled(Ts), or give poles"
        )
    R = np.diag(s.noise_levels(noise) ** 2)
    W = np.zeros((s.nx, s.nx)) if process is None else np.atleast_2d(np.asarray(process, float))
    if W.shape != (s.nx, s.nx):
        raise ModelError(f"{s.name}: process is {W.shape}; give ({s.nx}, {s.nx})")
    keep = np.eye(s.nx) - m.G2 @ s.C
    G_z = m.G1 + m.A @ m.G2
    through = m.P_y - m.C @ m.G2
    U = row_space(through.T, 1e-7)
    Q = keep @ W @ keep.T + G_z @ R @ G_z.T
    S = -G_z @ R @ (U @ through).T
    noisy = NoisySystem(
        m.A,
        np.zeros((s.nx, 0)),
        U @ m.C,
        np.zeros((len(U), 0)),
        Q,
        U @ through @ R @ through.T @ U.T,
        S,
        s.Ts,
        s.states,
    )
    if len(U) == 0:  # y is used up by the elimination: nothing is left to correct with
        from scipy.linalg import solve_discrete_lyapunov

        P: Array = np.asarray(solve_discrete_lyapunov(m.A, Q))
        K: Array = np.zeros((s.nx, s.ny))
    else:
        predictor = steady_state(noisy)
        P, K = predictor.P, predictor.K @ U
    return DecoupledObserver(found, K, P + m.G2 @ R @ m.G2.T)
