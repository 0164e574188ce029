"""Data of the simulation study 7.5.1: the pendulum of Table 7.2, nominal and loaded, many runs.

Linder (2017), section 7.5.1: T = 0.01 s, 150 000 samples a record, the cart's acceleration follows
a reference through F_delta(s) = 1/(0.2 s + 1), white noise of standard deviation 0.01 on the gyro
and on the accelerometer, and all signals behind the same zero-phase low-pass of order 20, cut-off
0.5 Hz. The thesis gives neither the reference nor the stop band nor how the phase became zero: here
the reference is a random telegraph of amplitude A and mean hold 1 s, the stop band begins at 6 Hz,
and the filter runs forward and backward.

A filter is linear, so the noise-free signals are filtered once and every run filters noise alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

import casid
from casid.arrays import Array
from casid.data.fir_filter import FirFilter, equiripple
from problems.pendulum import CART_LAG, TABLE_7_2, motion, telegraph

Truth = Literal["linear", "nonlinear"]

TS = 0.01
"""Sample time [s]."""

HELD_FOR = 1.0
"""Mean time between switches of the reference [s]."""

INSTRUMENT_LAG = 0.1
"""Time constant of the F_delta that the study's instruments are simulated with [s]."""

UNITS = {"gyro": "rad/s", "accel": "m/s^2", "ref": "m/s^2"}


def low_pass(passes: int = 2) -> FirFilter:
    """The study's filter: 21 taps, pass band to 0.5 Hz, stop band from 6 Hz, gain 1 at DC.

    Two passes are one forward and one backward, the common way to zero phase: 41 taps, the gain
    squared. One pass is centred. It hardly affects instrumental variables, but least squares: the
    noise that remains above 6 Hz decides its bias.
    """
    once = equiripple(0.5, TS, stop_hz=6.0, order=20)
    if passes == 1:
        return once
    if passes != 2:
        raise casid.DataError(f"passes={passes!r}; use 2 (forward and backward) or 1 (centred)")
    twice = np.asarray(np.convolve(once.taps, once.taps), dtype=np.float64)
    return FirFilter(twice, TS, f"{once.design}, forward and backward")


def sampled_exactly(ref: Array, *, m: float = 0.0, Ts: float = TS) -> tuple[Array, Array]:
    """Gyro [rad/s] and accelerometer [m/s^2] of the linear pendulum (7.10), without noise.

    The chain ref -> a_y -> pendulum is linear and the reference held over samples, so the states at
    the samples follow without an error of integration: with A V = V diag(l), every mode obeys

        w[t+1] = exp(l Ts) w[t] + (exp(l Ts) - 1)/l (V^-1 B) ref[t]

    Rounding alone is left: 3e-15 of the largest sample over 200 s.

    Parameters
    ----------
    ref : (N,) reference of the cart's acceleration [m/s^2].
    m : the load [kg]; all else is Table 7.2.
    Ts : sample time [s].

    Returns
    -------
    two (N,) arrays; the pendulum starts at rest.
    """
    from scipy.signal import lfilter

    v, g = TABLE_7_2, 9.81
    S = v["M"] * v["z_g"] + m * v["z_m"]
    I_1 = v["I_x"] + v["M"] * v["z_g"] ** 2 + m * v["z_m"] ** 2  # (7.8)
    torque = np.array([-(v["k"] + S * g), -v["d"], S]) / I_1  # (7.10)
    A = np.array([[0.0, 1.0, 0.0], torque, [0.0, 0.0, -1.0 / CART_LAG]])
    poles, V = np.linalg.eig(A)
    weights = np.linalg.solve(V, np.array([0.0, 0.0, 1.0 / CART_LAG]))
    accel = v["z_s"] * torque + np.array([g, 0.0, -1.0])  # (7.14)
    outputs = np.array([[0.0, 1.0, 0.0], accel]) @ V
    total = np.zeros((2, len(ref)))
    for pole, weight, column in zip(poles, weights, outputs.T, strict=True):
        if pole.imag < 0.0:
            continue  # the conjugate of a mode that counts twice
        gain = np.expm1(pole * Ts) / pole * weight
        mode = lfilter([0.0, gain], [1.0, -np.exp(pole * Ts)], ref)
        total += (2.0 if pole.imag > 0.0 else 1.0) * np.outer(column, mode).real
    return total[0], total[1]


class BlockFilter:
    """A FIR filter as two products with Toeplitz blocks: a third of the time of a convolution.

    With B samples a block, y[block] = x[block] T_1 + x[next block] T_2, T[i, j] = h[i - j]: twice
    the multiplications, but in matrix products.

    Attributes
    ----------
    input : (N + taps - 1,) view to be filled before a call.
    """

    def __init__(self, taps: Array, N: int) -> None:
        order = len(taps) - 1
        B = 8 * max(1, -(-order // 8))  # whole vector registers, and no fewer than the order
        blocks = -(-N // B)
        self.N = N
        self._padded = np.zeros((blocks + 1, B))
        self.input = self._padded.reshape(-1)[: N + order]
        toeplitz = np.zeros((B + order, B))
        for j in range(B):
            toeplitz[j : j + order + 1, j] = taps[::-1]
        self._own, self._next = toeplitz[:B].copy(), toeplitz[B:].copy()
        self._order = order
        self._sum, self._part = np.empty((blocks, B)), np.empty((blocks, B))

    def __call__(self, out: Array, add: Array | float = 0.0) -> Array:
        """Write sum_j h[j] input[t + taps - 1 - j] + add into `out` (N,)."""
        np.matmul(self._padded[:-1], self._own, out=self._sum)
        np.matmul(self._padded[1:, : self._order], self._next, out=self._part)
        self._sum += self._part
        return np.add(self._sum.reshape(-1)[: self.N], add, out=out)


class PendulumRecords:
    """The records of section 7.5.1, drawn again with new noise for every run.

    Parameters
    ----------
    amplitude : A of the reference, a random telegraph with mean hold 1 s [m/s^2].
    N : samples of a record behind the filter.
    load : mass on the loaded pendulum [kg].
    noise : standard deviation of the white noise before the filter, gyro [rad/s] and accel [m/s^2].
    seed : of the references and of `generator`.
    truth : "linear" for (7.10), sampled exactly; "nonlinear" for (7.9), by Runge-Kutta with five
        steps a sample.
    passes : of the filter, see `low_pass`.

    Attributes
    ----------
    clean : load case -> {"gyro", "accel", "ref"} -> (N,) filtered signals without noise.

    Notes
    -----
    Records start at rest. Pickling keeps the settings and makes the signals again.
    """

    cases = ("nominal", "loaded")

    def __init__(
        self,
        amplitude: float = 0.3,
        *,
        N: int = 150_000,
        load: float = TABLE_7_2["m"],
        noise: float = 0.01,
        seed: int = 1,
        truth: Truth = "linear",
        passes: int = 2,
    ) -> None:
        if truth not in ("linear", "nonlinear"):
            raise casid.DataError(f"truth={truth!r} is not known; use 'linear' or 'nonlinear'")
        self.amplitude, self.N, self.load, self.noise = amplitude, N, load, noise
        self.seed, self.truth, self.passes = seed, truth, passes
        self.Ts = TS
        self.low_pass = low_pass(passes)
        raw = N + 2 * self.low_pass.half
        self.clean: dict[str, dict[str, Array]] = {}
        for i, case in enumerate(self.cases):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, i)))
            ref = telegraph(raw, TS, amplitude=amplitude, hold=HELD_FOR, rng=rng)
            signals = (*self._sensed(ref, load if case == "loaded" else 0.0), ref)
            self.clean[case] = {n: self._smoothed(x) for n, x in zip(UNITS, signals, strict=True)}
        self._filter = BlockFilter(noise * self.low_pass.taps, N)
        self._drawn = {
            case: {"gyro": np.empty(N), "accel": np.empty(N), "ref": self.clean[case]["ref"]}
            for case in self.cases
        }

    def _smoothed(self, signal: Array) -> Array:
        """(N,) read-only, behind the filter."""
        smooth = np.asarray(np.convolve(signal, self.low_pass.taps, mode="valid"), dtype=np.float64)
        smooth.flags.writeable = False
        return smooth

    def _sensed(self, ref: Array, m: float) -> tuple[Array, Array]:
        if self.truth == "linear":
            return sampled_exactly(ref, m=m)
        v = TABLE_7_2
        phi, p, a_y, p_dot = motion(ref, TS, 5, k=v["k"], d=v["d"], I_x=v["I_x"], m=m, d_2=0.0)
        return p, v["z_s"] * p_dot + 9.81 * np.sin(phi) - a_y * np.cos(phi)

    def __repr__(self) -> str:
        return (
            f"<PendulumRecords amplitude {self.amplitude:g} m/s^2, {self.truth} pendulum, "
            f"2 records of {self.N} samples, noise {self.noise:g}, seed {self.seed}>"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        keys = ("amplitude", "N", "load", "noise", "seed", "truth", "passes")
        return _study, ({key: getattr(self, key) for key in keys},)

    def generator(self, run: int | np.random.SeedSequence) -> np.random.Generator:
        """The random numbers of one run, by its number or by the seed that a campaign hands out.

        The same for the same run, whoever draws the others. SFC64 takes four fifths of the default
        generator's time for a normal.
        """
        if not isinstance(run, np.random.SeedSequence):
            run = np.random.SeedSequence(self.seed, spawn_key=(1, run))
        return np.random.Generator(np.random.SFC64(run))

    def draw(self, rng: np.random.Generator) -> Mapping[str, Mapping[str, Array]]:
        """One run: load case -> channel -> (N,) filtered samples with new noise on both sensors.

        The arrays are reused: the next draw overwrites them. Copy what is to be kept.
        """
        for case, drawn in self._drawn.items():
            for channel in ("gyro", "accel"):
                rng.standard_normal(out=self._filter.input)
                self._filter(drawn[channel], self.clean[case][channel])
        return self._drawn

    def experiments(self, run: int | np.random.SeedSequence = 0) -> list[casid.Experiment]:
        """One run as experiments: nominal with known m = 0, loaded with nothing known of m."""
        made = []
        for case, drawn in self.draw(self.generator(run)).items():
            record = casid.Record(
                drawn,
                UNITS,
                TS,
                t0=self.low_pass.half * TS,
                name=case,
                provenance=(f"{self!r}, run {run}", self.low_pass.design),
            )
            made.append(casid.Experiment(record, {"m": 0.0} if case == "nominal" else {}, case))
        return made


def _study(settings: dict[str, Any]) -> PendulumRecords:
    return PendulumRecords(**settings)
