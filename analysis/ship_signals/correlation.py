"""Roll rate, accelerometer and yaw rate are all correlated with the torque that disturbs the roll.

Rudder and torque are independent first-order Gauss-Markov sequences, drawn as straight lines
between samples, as the simulator draws them. The linear ship with them is then one discrete system

    z_{t+1} = Phi z_t + Gamma e_t,   z = [phi v p r delta tau],   P = Phi P Phi' + Gamma Q Gamma'

exactly, and its covariances are those of a Lyapunov equation. Records are drawn from that system
and from the nonlinear simulator; a mean over records has the standard error sd/sqrt(records).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from analysis.ship_signals.model import accelerometer, matrices, values_of
from casid.arrays import Array
from problems.ship_4dof import Actuator, Ship, simulate
from problems.ship_simulator.sensors import InertialUnit, for_roll, measure

SIGNALS = ("gyro", "accel", "r")
"""y_O, a_s and the yaw rate."""

CHANNELS = (*SIGNALS, "tau", "delta")
LAG = 23
"""Samples (0.46 s) after which r is correlated most with the torque."""

_KEEP = [0, 2, 3, 4]  # phi v p r: the heading is an integral that nothing depends on


@dataclass(frozen=True, slots=True)
class Drives:
    """Rudder and torque: standard deviations, times after which they have forgotten by 1/e [s].

    The default is a ship that nearly keeps its course, with motions so small that the simulator is
    linear: drag in sway grows with v |v|.
    """

    delta: float = 1e-4  # rad
    tau: float = 5e-3  # N m
    delta_time: float = 2.0
    tau_time: float = 0.5

    def memory(self, Ts: float) -> Array:
        """(2,) coefficient of one sample of delta and tau."""
        return np.asarray(np.exp(-Ts / np.array([self.delta_time, self.tau_time])))

    def innovation(self, Ts: float) -> Array:
        """(2,) standard deviation of what is new in a sample."""
        sd = np.array([self.delta, self.tau])
        return np.asarray(sd * np.sqrt(1.0 - self.memory(Ts) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """z_{t+1} = Phi z_t + Gamma e_t, channels = C z, and P the covariance of z.

    Attributes
    ----------
    Phi, P : (6, 6).
    Gamma : (6, 2) of what is new in delta and tau.
    C : (5, 6) rows of `CHANNELS`.
    """

    Ts: float
    drives: Drives
    Phi: Array
    Gamma: Array
    C: Array
    P: Array

    def covariance(self, lag: int = 0) -> Array:
        """(5, 5) E of channels(t + lag) channels(t)', lag >= 0."""
        return np.asarray(self.C @ np.linalg.matrix_power(self.Phi, lag) @ self.P @ self.C.T)

    @property
    def deviations(self) -> Array:
        """(5,) standard deviations of the channels."""
        return np.asarray(np.sqrt(np.diag(self.covariance())))

    def correlation(self, lag: int = 0, noise: Mapping[str, float] | None = None) -> Array:
        """(5,) correlation of the channels at t + lag with tau at t; lag of either sign.

        Parameters
        ----------
        noise : channel -> standard deviation of white noise of its sensor.
        """
        R = self.covariance(abs(lag))
        cross = R[:, 3] if lag >= 0 else R[3, :]
        sd = self.deviations
        measured = np.hypot(sd, [(noise or {}).get(n, 0.0) for n in CHANNELS])
        return np.asarray(cross / (measured * sd[3]))

    def at_once(self) -> Array:
        """(3,) what a signal gains within the sample per torque that is new in it."""
        return np.asarray((self.C @ self.Gamma)[:3, 1])


def sampled(Ts: float = 0.02, drives: Drives | None = None) -> Sampled:
    """The linear ship of Table 8.2 and its drives, sampled; straight lines between samples."""
    from scipy.linalg import expm, solve_discrete_lyapunov

    drives, values = drives or Drives(), values_of()
    E, F, B = matrices(values)
    A, G = (np.linalg.solve(E, m)[_KEEP] for m in (F, B))
    A = A[:, _KEEP]
    both = np.zeros((8, 8))  # x, u and the change of u in the sample, over the sample
    both[:4, :4], both[:4, 4:6], both[4:6, 6:] = A * Ts, G * Ts, np.eye(2)
    over = expm(both)
    later = over[:4, 6:]
    now = over[:4, 4:6] - later
    a = drives.memory(Ts)
    Phi = np.zeros((6, 6))
    Phi[:4, :4], Phi[:4, 4:], Phi[4:, 4:] = over[:4, :4], now + later * a, np.diag(a)
    Gamma = np.vstack([later, np.eye(2)])
    C_a, D_a = accelerometer(values)
    C = np.zeros((5, 6))
    C[0, 2], C[2, 3], C[3, 5], C[4, 4] = 1.0, 1.0, 1.0, 1.0
    C[1] = [*C_a[_KEEP], *D_a]
    Q = np.diag(drives.innovation(Ts) ** 2)
    P = solve_discrete_lyapunov(Phi, Gamma @ Q @ Gamma.T)
    return Sampled(Ts, drives, Phi, Gamma, C, np.asarray(P))


# -- records -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Means over records beside the theory.

    Attributes
    ----------
    names : of the numbers.
    theory, mean, error : (n,) each; the standard error is that of the mean.
    """

    names: tuple[str, ...]
    theory: Array
    mean: Array
    error: Array

    @property
    def z(self) -> Array:
        """(n,) distance from the theory in standard errors."""
        return np.asarray((self.mean - self.theory) / self.error)


def linear_records(system: Sampled, *, records: int, N: int, seed: int) -> Found:
    """Correlations with tau, variances, and gain at once, over records of the linear system.

    The records begin in the stationary state: nothing has to be left out.
    """
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(system.P)
    e = rng.standard_normal((N, 2, records)) * system.drives.innovation(system.Ts)[:, None]
    z = root @ rng.standard_normal((6, records))
    channels = np.empty((N, 5, records))
    for t in range(N):
        z = system.Phi @ z + system.Gamma @ e[t]
        channels[t] = system.C @ z
    scaled = channels / system.deviations[:, None]
    with_tau = np.mean(scaled[:, :3] * scaled[:, 3:4], axis=0)
    later = np.mean(scaled[LAG:, :3] * scaled[:-LAG, 3:4], axis=0)
    variance = np.mean(scaled[:, :3] ** 2, axis=0)
    new = e[:, 1:2]
    gain = np.mean(channels[:, :3] * new, axis=0) / system.drives.innovation(system.Ts)[1] ** 2
    names = [*_names(system.Ts), *(f"gain at once, tau to {n}" for n in SIGNALS)]
    theory = [*_theory(system, {}), *system.at_once()]
    return _found(names, theory, np.vstack([with_tau, later, variance, gain]))


def simulator_records(
    system: Sampled, *, records: int, seconds: float, settle: float, seed: int, noisy: bool = False
) -> Found:
    """Correlations with tau and variances over records of the nonlinear simulator.

    Parameters
    ----------
    seconds, settle : kept of each record, and left out at its start [s].
    noisy : by the sensors' noise of `InertialUnit`; else perfect sensors.
    """
    rng, Ts, drives = np.random.default_rng(seed), system.Ts, system.drives
    N, first = round((seconds + settle) / Ts), round(settle / Ts)
    ship = replace(Ship(), rudder=Actuator(-1.0, 1.0, 1e3))
    unit = InertialUnit() if noisy else InertialUnit().without_noise()
    noise = {"gyro": unit.gyro.noise, "accel": unit.accel.noise, "r": unit.yaw_gyro.noise}
    sd = np.hypot(system.deviations, [noise.get(n, 0.0) for n in CHANNELS])
    rows = []
    for _ in range(records):
        u = _gauss_markov(drives, Ts, N, rng)
        forces = np.zeros((N, 4))
        forces[:, 2] = u[:, 1]
        motion = simulate(u[:, 0], ship=ship, forces=forces, Ts=Ts, substeps=2)
        record = for_roll(measure(motion, unit, seed=int(rng.integers(2**31))))
        kept = np.stack([record[n][first:] for n in SIGNALS]) / sd[:3, None]
        tau = u[first:, 1] / sd[3]
        now, later = kept * tau, kept[:, LAG:] * tau[:-LAG]
        rows.append([np.mean(a, axis=1) for a in (now, later, kept**2)])
    return _found(_names(Ts), _theory(system, noise), np.array(rows).reshape(records, -1).T)


def _names(Ts: float) -> list[str]:
    return [
        *(f"corr({n}, tau)" for n in SIGNALS),
        *(f"corr({n}, tau {LAG * Ts:.2f} s before)" for n in SIGNALS),
        *(f"variance of {n} by theory's" for n in SIGNALS),
    ]


def _theory(system: Sampled, noise: Mapping[str, float]) -> list[float]:
    now, later = (system.correlation(lag, noise)[:3] for lag in (0, LAG))
    return [*now, *later, 1.0, 1.0, 1.0]


def _gauss_markov(drives: Drives, Ts: float, N: int, rng: np.random.Generator) -> Array:
    """(N, 2) delta and tau, stationary from the first sample."""
    from scipy.signal import lfilter

    e = rng.standard_normal((N, 2))
    columns = []
    for i, (a, new, sd) in enumerate(
        zip(drives.memory(Ts), drives.innovation(Ts), (drives.delta, drives.tau), strict=True)
    ):
        shocks = new * e[:, i]
        shocks[0] = sd * e[0, i]
        columns.append(lfilter([1.0], [1.0, -a], shocks))
    return np.stack(columns, axis=1)


def _found(names: list[str], theory: list[float], samples: Array) -> Found:
    """From (n, records) numbers, a record a column."""
    error = samples.std(axis=1, ddof=1) / np.sqrt(samples.shape[1])
    return Found(tuple(names), np.array(theory), samples.mean(axis=1), error)
