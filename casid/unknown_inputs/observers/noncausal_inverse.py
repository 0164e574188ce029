"""The inverse of a sampled system, run over a whole record: unstable zeros run backward in time.

Of a window of outputs Y[t] = [y[t]; ..; y[t+L]] = O x[t] + J [u[t]; ..; u[t+L]] a matrix K with
K J = [I 0 .. 0] leaves

    u[t] = K (Y[t] - O x[t]),   x[t+1] = (A - E K O) x[t] + E K Y[t] + H N (Y[t] - O x[t])    (1)

where N J = 0: L is the inverse's delay, and H is free. It is an observer's gain: with L <= 1 and no
unstable zeros (1) has the states of the disturbance-decoupled observer. What H does not move are
the system's zeros. Those inside the unit circle run forward, those outside backward.

Sources: M. K. Sain, J. L. Massey, Invertibility of linear time-invariant dynamical systems, IEEE
Trans. Autom. Control 14 (1969) 141-149; S. Devasia, D. Chen, B. Paden, Nonlinear inversion-based
output tracking, IEEE Trans. Autom. Control 41 (1996) 930-942 (stable inversion).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import TINY, Array
from casid.data.record import Record
from casid.errors import DataError, ModelError
from casid.linear.filtering.split_dynamics import SplitDynamics, split_dynamics
from casid.linear.subspaces import unobservable_subspace
from casid.model.quantities import count_text
from casid.unknown_inputs.observers.equivalent_model import (
    direction_text,
    pole_text,
    require_recoverable,
)
from casid.unknown_inputs.observers.input_estimate import InputEstimate, noise_guess
from casid.unknown_inputs.observers.output_window import observer_gain, output_window
from casid.unknown_inputs.observers.system_reader import unknown_input_system
from casid.unknown_inputs.observers.unknown_input_system import UnknownInputSystem

ON_CIRCLE = 1e-6
"""Zeros this near to the unit circle count as lying on it."""

STANDS_OUT = 2.0
"""Ratio of the spectra of estimate and noise from which on the band is usable (a choice)."""


@dataclass(frozen=True, slots=True, eq=False)
class NoncausalInverse:
    """Inverse (1) of a sampled system.

    Attributes
    ----------
    system : sampled. O ((L+1) ny, nx); K (nu, (L+1) ny); drive (nx, (L+1) ny) = E K + H N.
    A : (nx, nx) of (1); split : its stable and anti-stable parts.
    zeros : the system's invariant zeros, which no gain moves.
    """

    system: UnknownInputSystem
    delay: int
    O: Array  # noqa: E741
    K: Array
    drive: Array
    A: Array
    split: SplitDynamics
    zeros: Array

    @property
    def backward_zeros(self) -> Array:
        """Zeros outside the unit circle, which run backward in time."""
        return np.asarray(self.zeros[np.abs(self.zeros) > 1])

    def response(self, omega: Array) -> Array:
        """(F, nu, ny) transfer functions from outputs to inputs at frequencies [rad/s]."""
        z = np.exp(1j * np.ravel(omega) * self.system.Ts)
        ny, n = self.system.ny, self.system.nx
        Z = (z[:, None] ** np.arange(self.delay + 1))[:, :, None, None] * np.eye(ny)
        Z = Z.reshape(len(z), -1, ny)
        x = np.linalg.solve(z[:, None, None] * np.eye(n) - self.A, self.drive @ Z)
        return np.asarray(self.K @ (Z - self.O @ x))

    def amplification(self, omega: Array, noise: Mapping[str, float]) -> Array:
        """(F, nu) root of the noise's spectrum in each input [unit sqrt(s)], two-sided.

        Parameters
        ----------
        omega : (F,) frequencies [rad/s]. noise : output -> standard deviation of white noise.
        """
        sd = self.system.noise_levels(noise)
        power = np.sum(np.abs(self.response(omega)) ** 2 * sd**2, axis=2)
        return np.asarray(np.sqrt(power * self.system.Ts))

    def run(
        self,
        record: Record,
        *,
        noise: Mapping[str, float] | None = None,
        band: float | None = None,
    ) -> InputEstimate:
        """The unknown inputs of a record.

        Parameters
        ----------
        noise : output -> standard deviation of its white noise; guessed from second differences
            where not given.
        band : a frequency [rad/s] above which the estimate is cut, by a Butterworth filter of order
            4 forward and backward, half the amplitude there. Noise is cut, and the input with it.

        Returns
        -------
        InputEstimate
            Standard deviations are the noise's alone; infinite where not `valid`: where transients
            from the ends may be above a tenth of it. `band` of it says where the input's spectrum
            exceeds the noise's `STANDS_OUT` times.

        Raises
        ------
        DataError
            For channels that do not fit, missing samples, or a record shorter than the transients.
        """
        s = self.system
        y, u = s.complete_signals(record)
        given = {o: noise_guess(y[:, i]) for i, o in enumerate(s.outputs)} | dict(noise or {})
        known = split_dynamics(s.A).run(u @ s.B.T)
        y = y - known @ s.C.T - u @ s.D.T
        N = record.N - self.delay
        cut = _cut(band, s.Ts)
        sd = self._deviation(given, cut)
        window = np.hstack([y[k : k + N] for k in range(self.delay + 1)])
        x = self.split.run(window @ self.drive.T)
        values = (window - x @ self.O.T) @ self.K.T
        start, end = self._transients(x, values, 0.1 * sd, cut)
        _refuse_short(record, start, end, N)
        values = _band_limited(values, cut)
        pad = ((0, self.delay), (0, 0))
        values, x = np.pad(values, pad), np.pad(x, pad)
        valid = np.zeros(record.N, dtype=bool)
        valid[start : N - end] = True
        return InputEstimate(
            s.unknown,
            {i: s.units[i] for i in s.unknown if i in s.units},
            record.t,
            values,
            np.where(valid[:, None], sd, np.inf),
            x + known,
            valid,
            "the noncausal inverse",
            record.name,
            self._bands(values[valid], given),
            {f"noise of {o}": v for o, v in given.items()},
            self._assumed(noise or {}, band),
        )

    def _assumed(self, noise: Mapping[str, float], band: float | None) -> tuple[str, ...]:
        guessed = [o for o in self.system.outputs if o not in noise]
        return (
            "the model is exact, and the unknown input is held over each sample",
            *(f"noise of {o} is white; its size was guessed" for o in guessed),
            *([] if band is None else [f"the input has nothing above {band:g} rad/s"]),
        )

    def _deviation(self, noise: Mapping[str, float], cut: Array | None) -> Array:
        """(nu,) standard deviations: the noise's spectrum integrated over the unit circle."""
        away = np.min(np.abs(np.abs(np.linalg.eigvals(self.A)) - 1), initial=1.0)
        # The sum over equally spaced points errs by rho^points, rho the pole's distance ratio.
        points = int(min(max(2048, 40 / away), 200_000))
        w = np.pi / self.system.Ts * (np.arange(points) + 0.5) / points
        power = self.amplification(w, noise) ** 2 / self.system.Ts
        if cut is not None:
            from scipy.signal import sosfreqz

            _, B = sosfreqz(cut, w * self.system.Ts)
            power = power * np.abs(B[:, None]) ** 4
        return np.asarray(np.sqrt(np.mean(power, axis=0)))

    def _transients(
        self, x: Array, values: Array, below: Array, cut: Array | None
    ) -> tuple[int, int]:
        """Samples at the start and the end until what they begin with is `below` in every input.

        Each mode starts anywhere within its own rms, and dies out as its eigenvalue has it, cut by
        the filter; the filter smears the ends over some samples of its own.
        """
        modes, vectors = np.linalg.eig(self.A)
        seen = np.abs(self.K @ self.O @ vectors)
        rms = np.sqrt(np.mean(np.abs(np.linalg.solve(vectors, x.T)) ** 2, axis=1))
        first = np.max(3 * seen * rms / below[:, None], axis=0, initial=0.0)
        smeared = 0
        if cut is not None:
            from scipy.signal import sos2zpk

            slow = (np.abs(modes) > 1e-3) & (np.abs(modes) < 1e3)  # others are gone at once
            passed = _through(cut, modes[slow]) * _through(cut, 1 / modes[slow])
            first[slow] *= np.abs(passed)
            slowest = float(np.max(np.abs(sos2zpk(cut)[1])))
            largest = float(np.max(np.abs(values) / below))
            smeared = int(np.ceil(max(np.log(largest), 0.0) / -np.log(slowest)))
        ends = [smeared, smeared]
        for size_now, mode in zip(first, modes, strict=True):
            if size_now > 1:
                speed = abs(np.log(max(abs(mode), TINY)))
                k = int(abs(mode) > 1)
                ends[k] = max(ends[k], smeared + int(np.ceil(np.log(size_now) / speed)))
        start = len(self.A) + ends[0]
        return start, ends[1] + (len(self.A) if np.any(np.abs(modes) > 1) else 0)

    def _bands(
        self, values: Array, noise: Mapping[str, float]
    ) -> tuple[tuple[float, float] | None, ...]:
        """Where the estimate's spectrum exceeds the noise's, by Welch's method."""
        from scipy.signal import welch

        Ts = self.system.Ts
        length = min(len(values), max(64, len(values) // 8))
        if length < 16:
            return tuple(None for _ in self.system.unknown)
        f, P = welch(values, 1 / Ts, nperseg=length, axis=0, return_onesided=False)
        inside = f > 0
        w, P = 2 * np.pi * f[inside], P[inside]
        ratio: Array = np.asarray(P / self.amplification(w, noise) ** 2)
        found: list[tuple[float, float] | None] = []
        for column in ratio.T:
            best = int(np.argmax(column))
            if column[best] < STANDS_OUT:
                found.append(None)
                continue
            low = high = best
            while low > 0 and column[low - 1] >= STANDS_OUT:
                low -= 1
            while high + 1 < len(column) and column[high + 1] >= STANDS_OUT:
                high += 1
            found.append((float(w[low]), float(w[high])))
        return tuple(found)

    def __str__(self) -> str:
        s = self.system
        lines = [repr(self)]
        for z in self.zeros:
            how = "backward in time" if abs(z) > 1 else "forward"
            lines.append(f"  zero {pole_text(z, s)}: runs {how}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return (
            f"<NoncausalInverse of {self.system.name}: {', '.join(self.system.unknown)} from "
            f"{', '.join(self.system.outputs)}, {count_text(self.delay, 'sample')} ahead, "
            f"{len(self.backward_zeros)} zeros backward>"
        )


def noncausal_inverse(
    system: Any,
    unknown: Sequence[str] | str | None = None,
    *,
    Ts: float | None = None,
    noise: Mapping[str, float] | None = None,
    values: Mapping[str, float] | None = None,
) -> NoncausalInverse:
    """The inverse of a system from its unknown inputs to its outputs, for whole records.

    Parameters
    ----------
    system, unknown, values : as in `unknown_input_system`.
    Ts : sample time [s] of a continuous-time system, its unknown inputs held over each sample.
    noise : output -> standard deviation, where there are more outputs than unknown inputs: weighs
        them against each other (equal by default).

    Raises
    ------
    ModelError
        If the outputs do not determine the inputs (which ones), a zero lies on the unit circle
        (where), or a continuous system has no Ts.
    """
    s = unknown_input_system(system, unknown, values=values)
    if not s.is_discrete:
        if Ts is None:
            raise ModelError(f"{s.name} is in continuous time; give the record's sample time, Ts=")
        s = s.sampled(Ts)
    require_recoverable(s)
    s.require_outputs(noise or {})
    sd = np.array([(noise or {}).get(o, 1.0) for o in s.outputs])
    delay, O, K, N = output_window(s, sd)  # noqa: E741
    A = s.A - s.E @ K @ O
    H = observer_gain(s, A, O, s.E @ K, N, np.tile(sd, delay + 1))
    V = unobservable_subspace(A, N @ O, 1e-8)
    zeros = np.linalg.eigvals(V.T @ A @ V)
    on = [i for i, z in enumerate(zeros) if abs(abs(z) - 1) < ON_CIRCLE]
    if on:
        z = zeros[on[0]]
        _, vectors = np.linalg.eig(V.T @ A @ V)
        raise ModelError(
            f"{s.name}: zero {pole_text(z, s)} on the unit circle, along "
            f"{direction_text(V @ vectors[:, on[0]], s.states)}: no output sees "
            f"{', '.join(s.unknown)} at that frequency, and an inverse would drift. Add an output "
            "that sees it there, or use reconstruct_input, which says how little is known"
        )
    A = A - H @ N @ O
    return NoncausalInverse(s, delay, O, K, s.E @ K + H @ N, A, split_dynamics(A), zeros)


def _through(cut: Array, z: Array) -> Array:
    """The filter's transfer function at points z that are not zero."""
    powers = z[:, None] ** -np.arange(3.0)
    return np.asarray(np.prod((powers @ cut[:, :3].T) / (powers @ cut[:, 3:].T), axis=1))


def _refuse_short(record: Record, start: int, end: int, N: int) -> None:
    """Refuse a record of which transients from start and end leave none of the N estimates."""
    if start + end >= N:
        raise DataError(
            f"{record.name}: {record.N} samples, but transients of the inverse take {start} "
            f"from the start and {end} from the end; give a longer record, a lower band, or "
            "use reconstruct_input"
        )


def _band_limited(values: Array, cut: Array | None) -> Array:
    if cut is None:
        return values
    from scipy.signal import sosfiltfilt

    return np.asarray(sosfiltfilt(cut, values, axis=0))


def _cut(band: float | None, Ts: float) -> Array | None:
    if band is None:
        return None
    if not 0 < band < np.pi / Ts:
        raise DataError(
            f"band = {band!r}; give a frequency between 0 and {np.pi / Ts:.4g} rad/s, half the "
            "sampling frequency"
        )
    from scipy.signal import butter

    return np.asarray(butter(4, band * Ts / np.pi, output="sos"))
