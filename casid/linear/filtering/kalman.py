"""One-step predictors of linear systems with process and measurement noise (Kalman filters).

    xhat[t+1] = A xhat[t] + B u[t] + K (y[t] - yhat[t]),    yhat[t] = C xhat[t] + D u[t]    (1)

Steady-state predictor (2.29)-(2.34) and time-varying one (2.35) of Linder (2017); the formulas are
those of Anderson and Moore, Optimal Filtering, 1979, ch. 4 and 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from casid.arrays import TINY, Array
from casid.errors import ModelError
from casid.linear.filtering.noisy_system import NoisySystem
from casid.linear.filtering.recursion import recursion
from casid.linear.stability import spectral_radius

ON_CIRCLE = 1e-8
"""Modes this near to the unit circle count as lying on it."""


# -- the steady state ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Predictor:
    """The steady-state one-step predictor in innovations form, Linder 2017, (2.29)-(2.34).

    Attributes
    ----------
    K : (nx, ny) gain, P : (nx, nx) covariance of x[t] given y[..t-1], F : (ny, ny) covariance of
    the innovation y - yhat.
    """

    system: NoisySystem
    K: Array
    P: Array
    F: Array

    @property
    def A_closed(self) -> Array:
        """A - K C, whose eigenvalues lie inside the unit circle."""
        return np.asarray(self.system.A - self.K @ self.system.C)

    @property
    def poles(self) -> Array:
        """(nx,) eigenvalues of A - K C."""
        return np.asarray(linalg.eigvals(self.A_closed))

    def __repr__(self) -> str:
        s = self.system
        slowest = spectral_radius(self.A_closed)
        return (
            f"<Predictor of {', '.join(s.output_name(i) for i in range(s.ny))}: {s.nx} states, "
            f"{s.nu} inputs, Ts = {s.Ts:g} s, slowest pole {slowest:.4g}>"
        )

    def to_control(self) -> Any:
        """Innovations form as a python-control StateSpace, from [u; innovation] to y.

        (2.32) of Linder (2017). Signals have the channels' names, as far as the system has them.
        """
        import control

        s = self.system
        return control.StateSpace(
            s.A,
            np.hstack([s.B, self.K]),
            s.C,
            np.hstack([s.D, np.eye(s.ny)]),
            s.Ts,
            inputs=[s.input_name(i) for i in range(s.nu)]
            + [f"innovation {s.output_name(i)}" for i in range(s.ny)],
            outputs=[s.output_name(i) for i in range(s.ny)],
            states=[s.state_name(i) for i in range(s.nx)],
        )

    def run(self, y: Array, u: Array | None = None, x0: Array | None = None) -> Filtered:
        """Innovations of y (N, ny), u (N, nu) with this gain from the first sample on.

        `x0` (nx,) is the predicted state at the first sample, default zero. A record is refused:
        the message names which of its channels make y and u.
        """
        s = self.system
        y, u = s.signals(y, u)
        x0 = np.zeros(s.nx) if x0 is None else np.asarray(x0, dtype=float).ravel()
        x = recursion(self.A_closed, u @ (s.B - self.K @ s.D).T + y @ self.K.T, x0)
        e = y - x[:-1] @ s.C.T - u @ s.D.T
        covariances = np.broadcast_to(self.F, (len(y), s.ny, s.ny))
        return Filtered(e, covariances, x, self.P, 0, log_likelihood(e, covariances))


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """What a predictor makes of a record."""

    innovations: Array  # (N, ny), zero where a sample is missing
    covariances: Array  # (N, ny, ny)
    x: Array  # (N + 1, nx) predicted states; the last belongs to the sample after the record
    P: Array  # (nx, nx) covariance of the last
    converged_at: int | None  # sample from which on the gain is the steady-state one; None: never
    log_likelihood: float

    @property
    def whitened(self) -> Array:
        """(N, ny) innovations of unit covariance."""
        lower = np.linalg.cholesky(self.covariances)
        return np.asarray(np.linalg.solve(lower, self.innovations[:, :, None])[:, :, 0])


def steady_state(system: NoisySystem, near: Array | None = None) -> Predictor:
    """The steady-state predictor, from the Riccati equation, Linder 2017, (2.31).

    Parameters
    ----------
    near : (nx, nx) covariance of a similar system: where its gain stabilises this one, Newton's
        method (Kleinman 1968; Hewer 1971) starts there, several times faster.

    Raises
    ------
    ModelError
        If R is singular, a mode that does not decay is not observable, or a mode on the
        unit circle is not moved by the noise: the message names it.

    Notes
    -----
    `scipy.linalg.solve_discrete_are`, then a Newton step that removes its rounding error.
    """
    s = system
    _refuse_singular_noise(s)
    if s.nx == 0:  # nothing to predict with
        return Predictor(s, np.zeros((0, s.ny)), np.zeros((0, 0)), s.R)
    if near is not None:
        found = _newton(s, near)
        if found is not None:
            return found
    try:
        P = linalg.solve_discrete_are(s.A.T, s.C.T, s.Q, s.R, s=s.S)
        _, K = _gain(s, P)
        if spectral_radius(s.A - K @ s.C) >= 1.0:
            raise linalg.LinAlgError("the predictor is not stable")
        P = _covariance_of(s, K)
    except (linalg.LinAlgError, ValueError) as error:
        raise ModelError(why_no_steady_state(s) or _unexplained(error)) from error
    reason = why_no_steady_state(s)
    if reason:
        raise ModelError(reason)
    F, K = _gain(s, P)
    return Predictor(s, K, P, F)


def _newton(s: NoisySystem, P: Array) -> Predictor | None:
    """Newton's method for the Riccati equation; None where it does not settle at once."""
    F, K = _gain(s, P)
    if not np.all(np.isfinite(K)) or spectral_radius(s.A - K @ s.C) >= 1 - ON_CIRCLE:
        return None
    for _ in range(12):
        new = _covariance_of(s, K)
        change = float(np.max(np.abs(new - P) / covariance_scale(new, new), initial=0.0))
        P = new
        F, K = _gain(s, P)
        if change < 1e-7:  # squared by the step just taken
            return Predictor(s, K, P, F)
    return None


def _covariance_of(s: NoisySystem, K: Array) -> Array:
    """The covariance that a predictor with gain K really has, by its Lyapunov equation."""
    P = _lyapunov(s.A - K @ s.C, joseph_noise(s, K)[None])[0]
    return np.asarray((P + P.T) / 2)


def _lyapunov(F: Array, W: Array) -> Array:
    """X = F X F' + W for a stack of W (m, n, n)."""
    n, m = len(F), len(W)
    if n > 12:  # the direct system has n^2 unknowns
        return np.array([linalg.solve_discrete_lyapunov(F, w) for w in W]).reshape(m, n, n)
    system = np.eye(n * n) - np.kron(F, F)
    return np.asarray(np.linalg.solve(system, W.reshape(m, n * n).T).T.reshape(m, n, n))


def joseph_noise(s: NoisySystem, K: Array) -> Array:
    """Q - S K' - K S' + K R K': what the noise adds to the error of a predictor with gain K."""
    cross = s.S @ K.T
    return np.asarray(s.Q - cross - cross.T + K @ s.R @ K.T)


def _gain(s: NoisySystem, P: Array) -> tuple[Array, Array]:
    """Innovation covariance C P C' + R and gain (2.30)."""
    PC = P @ s.C.T
    F = s.C @ PC + s.R
    F = (F + F.T) / 2
    return F, np.linalg.solve(F, (s.A @ PC + s.S).T).T


def step(s: NoisySystem, P: Array) -> tuple[Array, Array, Array]:
    """One step of (2.35): innovation covariance and gain at P, and P one sample later."""
    F, K = _gain(s, P)
    after = s.A @ P @ s.A.T + s.Q - K @ F @ K.T
    return F, K, (after + after.T) / 2


def _refuse_singular_noise(s: NoisySystem) -> None:
    size = np.sqrt(np.diag(s.R))
    quiet = [s.output_name(i) for i in np.flatnonzero(size == 0.0).tolist()]
    if quiet:
        raise ModelError(
            f"R is singular: output {', '.join(quiet)} has no measurement noise; give it a small "
            "one (its resolution / sqrt(12), say), or make it an input"
        )
    values, vectors = np.linalg.eigh(s.R / np.outer(size, size))
    if s.ny and values[0] < 1e-13:
        mixed = [s.output_name(i) for i in np.flatnonzero(np.abs(vectors[:, 0]) > 0.1).tolist()]
        raise ModelError(
            f"R is singular: the noise of {' and '.join(mixed)} is the same up to a factor; leave "
            "one of the outputs out, or give each a noise of its own"
        )


def why_no_steady_state(s: NoisySystem) -> str:
    """What keeps the Riccati equation from a stabilising solution; empty where nothing does."""
    for value, vector in _modes(s.A):
        if abs(value) < 1 - ON_CIRCLE:
            continue
        seen = np.linalg.norm(s.C @ vector) / max(float(np.linalg.norm(s.C)), TINY)
        if seen < 1e-9:
            return (
                f"not detectable: {_mode(s, value, vector)} does not decay and is not observable; "
                "measure it, fix its initial value as a known input, or leave the state out"
            )
    inverse = np.linalg.inv(s.R)
    A = s.A - s.S @ inverse @ s.C
    Q = s.Q - s.S @ inverse @ s.S.T
    for value, left in _modes(A.T):
        if abs(abs(value) - 1) > ON_CIRCLE:
            continue
        moved = abs(left.conj() @ Q @ left) / max(float(np.linalg.norm(Q)), TINY)
        if moved < 1e-14:
            return (
                f"no steady state: {_mode(s, value, left)} lies on the unit circle and no noise "
                "moves it, so its gain tends to zero; give it process noise, or use time_varying "
                "with the covariance of its initial value"
            )
    return ""


def _unexplained(error: Exception) -> str:
    return (
        f"the Riccati equation has no stabilising solution here ({error}); check the scaling of "
        "Q, S and R against each other, or use time_varying"
    )


def _modes(A: Array) -> list[tuple[complex, Array]]:
    values, vectors = np.linalg.eig(A)
    return [(complex(value), vectors[:, i]) for i, value in enumerate(values.tolist())]


def _mode(s: NoisySystem, value: complex, vector: Array) -> str:
    """A mode in words: the states it lives in, and where its pole lies."""
    share = np.abs(vector) / max(float(np.max(np.abs(vector))), TINY)
    names = [s.state_name(i) for i in np.flatnonzero(share > 0.1).tolist()]
    pole = f"{value.real:.6g}" + (f"{value.imag:+.6g}j" if abs(value.imag) > 1e-12 else "")
    return f"the mode at z = {pole} (in {', '.join(names)})"


# -- the time-varying predictor -----------------------------------------------------------------


def time_varying(
    system: NoisySystem,
    y: Array,
    u: Array | None = None,
    *,
    x0: Array | None = None,
    P0: Array | None = None,
    used: Array | None = None,
    tolerance: float = 1e-12,
) -> Filtered:
    """The predictor from x0 (nx,) and its covariance P0 (nx, nx), both zero by default.

    (2.35) of Linder (2017).

    Parameters
    ----------
    y, u : (N, ny) and (N, nu).
    used : (N, ny) bool, False where a sample of y is missing: it is predicted, not used.
    tolerance : relative change of P below which the steady-state gain takes over. The sample where
        it does is `converged_at` of the result; where no steady state exists it is None.

    Raises
    ------
    ModelError
        If P0 is not symmetric and positive semidefinite, or an innovation covariance is singular.
    """
    s = system
    y, u = s.signals(y, u)
    N = len(y)
    whole = used is None or bool(np.all(used))
    mask = np.ones((N, s.ny), dtype=bool) if used is None else np.asarray(used, dtype=bool)
    P = _initial_covariance(s, P0)
    limit = _steady_state_or_none(s)
    last_gap = -1 if whole else int(np.flatnonzero(~mask.all(axis=1))[-1])

    x = np.zeros((N + 1, s.nx))
    x[0] = 0.0 if x0 is None else np.asarray(x0, dtype=float).ravel()
    e, F = np.zeros((N, s.ny)), np.empty((N, s.ny, s.ny))
    converged = None
    y = np.where(mask, y, 0.0)
    known = u @ s.D.T
    driven = u @ s.B.T
    scale = None if limit is None else covariance_scale(limit.P, P)
    for t in range(N):
        if limit is not None and scale is not None and t > last_gap:
            if np.max(np.abs((P - limit.P) / scale), initial=0.0) < tolerance:
                converged = t
                break
        now = s if whole or mask[t].all() else _without(s, mask[t])
        F[t], K, after = step(now, P)
        _refuse_singular(F[t], t)
        e[t] = np.where(mask[t], y[t] - s.C @ x[t] - known[t], 0.0)
        x[t + 1] = s.A @ x[t] + driven[t] + K @ e[t]
        P = after
    if converged is not None and limit is not None:
        rest = limit.run(y[converged:], u[converged:], x[converged])
        e[converged:], x[converged:], F[converged:] = rest.innovations, rest.x, limit.F
        P = limit.P
    return Filtered(e, F, x, P, converged, log_likelihood(e, F, int(mask.sum())))


def _steady_state_or_none(s: NoisySystem) -> Predictor | None:
    try:
        return steady_state(s)
    except ModelError:
        return None  # the time-varying predictor exists all the same


def _refuse_singular(F: Array, t: int) -> None:
    if not np.all(np.isfinite(F)) or np.linalg.eigvalsh(F)[0] <= 0.0:
        raise ModelError(
            f"the innovation covariance at sample {t} is singular; give every output some "
            "measurement noise, or a P0 that is positive definite"
        )


def log_likelihood(innovations: Array, covariances: Array, count: int | None = None) -> float:
    """log of the Gaussian density of a record, from its innovations (N, ny) and their covariances.

    `count` is how many samples were measured (default all); missing ones have innovation zero and
    variance one.
    """
    count = innovations.size if count is None else count
    _, logdet = np.linalg.slogdet(covariances)
    solved = np.linalg.solve(covariances, innovations[:, :, None])[:, :, 0]
    quadratic = float(np.sum(innovations * solved))
    return float(-0.5 * (np.sum(logdet) + quadratic + count * np.log(2 * np.pi)))


def _initial_covariance(s: NoisySystem, P0: Array | None) -> Array:
    P = np.zeros((s.nx, s.nx)) if P0 is None else np.atleast_2d(np.asarray(P0, dtype=float))
    if P.shape != (s.nx, s.nx) or not np.allclose(P, P.T):
        raise ModelError(
            f"P0 is to be a symmetric ({s.nx}, {s.nx}) matrix, one row for each of "
            f"{', '.join(s.state_name(i) for i in range(s.nx))}; for independent initial values "
            "give np.diag of their variances"
        )
    largest = float(np.max(np.abs(P), initial=0.0))
    if float(np.min(np.linalg.eigvalsh(P), initial=0.0)) < -1e-9 * largest:
        raise ModelError("P0 is not positive semidefinite; give np.diag of the variances")
    return P


def covariance_scale(P: Array, P0: Array) -> Array:
    """(nx, nx) sizes of the entries of a covariance that settles at P from P0."""
    variance = np.maximum(np.diag(P), 1e-6 * np.diag(P0))
    size = np.sqrt(np.maximum(variance, 1e-24 * max(float(np.max(variance, initial=0.0)), 1e-270)))
    return np.asarray(np.outer(size, size))


def _without(s: NoisySystem, there: Array) -> NoisySystem:
    """The system at a sample where outputs are missing: they are noise of size one."""
    C, R, S = s.C * there[:, None], s.R * np.outer(there, there), s.S * there[None, :]
    R[~there, ~there] = 1.0
    return NoisySystem(s.A, s.B, C, s.D, s.Q, R, S, s.Ts, s.states, s.outputs, s.inputs)


# -- derivatives --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class SystemTangent:
    """Derivatives of a `NoisySystem` in m parameters: each (m, rows, columns)."""

    A: Array
    B: Array
    C: Array
    D: Array
    Q: Array
    S: Array
    R: Array


@dataclass(frozen=True, slots=True, eq=False)
class GainTangent:
    """Derivatives of gain (m, nx, ny), state (m, nx, nx) and innovation (m, ny, ny) covariance."""

    K: Array
    P: Array
    F: Array


def riccati_step_tangent(
    s: NoisySystem, d: SystemTangent, K: Array, P: Array, F: Array, dP: Array
) -> tuple[GainTangent, Array]:
    """Derivatives of gain and innovation covariance at P, and dP one sample later.

    P[t+1] = (A - K C) P (A - K C)' + Q - S K' - K S' + K R K' is stationary in K at the optimal
    gain, so K's own derivative drops out of dP[t+1].
    """
    closed = s.A - K @ s.C
    moved = d.A - K @ d.C
    half = moved @ P @ closed.T - d.S @ K.T
    after = closed @ dP @ closed.T + half + half.transpose(0, 2, 1) + d.Q + K @ d.R @ K.T
    PC = P @ s.C.T
    CPd = d.C @ PC
    dF = CPd + CPd.transpose(0, 2, 1) + s.C @ dP @ s.C.T + d.R
    cross = d.A @ PC + s.A @ (dP @ s.C.T + P @ d.C.transpose(0, 2, 1)) + d.S
    dK = np.linalg.solve(F, (cross - K @ dF).transpose(0, 2, 1)).transpose(0, 2, 1)
    return GainTangent(dK, dP, dF), after


def gain_tangent(predictor: Predictor, d: SystemTangent) -> GainTangent:
    """Exact derivatives of the steady state: the Riccati equation differentiated implicitly.

    dP solves the Lyapunov equation dP = (A - K C) dP (A - K C)' + W with the W of
    `riccati_step_tangent`.
    """
    p, n, m = predictor, predictor.system.nx, len(d.A)
    zero = np.zeros((m, n, n))
    _, w = riccati_step_tangent(p.system, d, p.K, p.P, p.F, zero)
    dP = _lyapunov(p.A_closed, w)
    dP = (dP + dP.transpose(0, 2, 1)) / 2
    return riccati_step_tangent(p.system, d, p.K, p.P, p.F, dP)[0]
