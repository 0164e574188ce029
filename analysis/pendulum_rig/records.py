"""Records of the laboratory rig for many runs: one motion of the cart, everything else new.

A record of `problems.pendulum_rig` takes seconds, most of them in Runge-Kutta steps. Here the
pendulum is dragged once; disturbance torque and sensor noise are drawn anew for every run and
added. For the noise that is exact. For the torque it is superposition, which sin(phi) and cos(phi)
in (7.9) of Linder (2017) break by a share of phi^2/2: 0.3 % of the disturbance at 0.08 rad rms.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

import casid
from casid.arrays import Array
from casid.data.fir_filter import FirFilter, equiripple
from problems import pendulum_rig as rig

TORQUE = 0.0045
"""Disturbance torque, rms between 0.3 and 3 Hz [N m]: validation fits about as low as published."""

AMPLITUDE = 0.5
"""Of the cart's acceleration, rms between 0.3 and 3 Hz [m/s^2]."""

BAND = (0.3, 3.0)
"""Of both [Hz]."""

TS = 0.02
"""Sample time of the records [s]; the sensors write every half of it."""


def torque_response(plant: rig.Pendulum, torque: Array, Ts: float) -> dict[str, Array]:
    """What a periodic disturbance torque adds to both channels, by the linear pendulum (7.10).

    Exact for a signal whose power lies below the Nyquist frequency: every line of its spectrum is
    multiplied by the continuous transfer function.

    Parameters
    ----------
    torque : (N,) one period [N m].

    Returns
    -------
    gyro [rad/s] and accel [m/s^2], (N,) each.
    """
    N = torque.size
    s = 2j * np.pi * np.fft.rfftfreq(N, Ts)
    spring = plant.k + plant.S * rig.G
    phi = np.fft.rfft(torque) / (plant.I_1 * s**2 + plant.d * s + spring)
    z_s = rig.TABLES_7_3_AND_7_4["z_s"]
    return {
        "gyro": np.fft.irfft(s * phi, N).astype(np.float64),
        "accel": np.fft.irfft((z_s * s**2 + rig.G) * phi, N).astype(np.float64),
    }


class Draws:
    """Nominal and loaded records of `duration` seconds at 50 Hz, with new noise for every run.

    Parameters
    ----------
    duration : of a record [s].
    torque : rms of the disturbance [N m].
    sensors : white noise of both inertial units; biases go with the means.
    seed : of the cart's motion.

    Attributes
    ----------
    angle : rms of the pendulum's angle without disturbance, load case -> [rad].
    """

    cases = ("nominal", "loaded")

    def __init__(
        self,
        duration: float = 600.0,
        *,
        amplitude: float = AMPLITUDE,
        torque: float = TORQUE,
        sensors: rig.Sensors | None = None,
        kappa: float = 0.0,
        seed: int = 1,
    ) -> None:
        self.torque, self.sensors = torque, sensors or rig.Sensors()
        known = rig.problem.load_cases
        self.plants = {c: rig.Pendulum(m=known[c]["m"], kappa=kappa) for c in self.cases}
        self.known = {
            "nominal": dict(known["nominal"]),
            "loaded": {"I_xm": known["loaded"]["I_xm"]},
        }
        self.clean: dict[str, casid.Record] = {}
        self.angle: dict[str, float] = {}
        for i, case in enumerate(self.cases):
            run = rig.record(
                self.plants[case],
                duration=duration,
                amplitude=amplitude,
                sensors=rig.NOISELESS,
                seed=1000 * seed + i,
                name=case,
            )
            self.clean[case] = rig.prepared(run, duration=duration)
            late = run.pendulum.t > run.released + rig.SETTLING
            self.angle[case] = float(np.std(run.truth["phi"][late]))

    @cached_property
    def _filter(self) -> FirFilter:
        return equiripple(0.5, TS / 2, stop_hz=6.0, order=20)

    def _noise(self, N: int, rng: np.random.Generator) -> Array:
        """White noise of unit variance at 100 Hz, filtered, one sample in two kept: (N,)."""
        taps = np.convolve(self._filter.taps, self._filter.taps)  # forward and backward
        white = rng.standard_normal(2 * N + len(taps) - 1)
        return np.asarray(np.convolve(white, taps, "valid")[: 2 * N : 2], dtype=np.float64)

    def experiments(
        self,
        rng: np.random.Generator | None = None,
        *,
        torque: float | None = None,
        sensors: rig.Sensors | None = None,
        shared: bool = False,
    ) -> list[casid.Experiment]:
        """One run, or with `rng` None the motion without torque and noise.

        Parameters
        ----------
        torque, sensors : in place of those of all runs.
        shared : the noise of the pendulum's accelerometer is on the reference as well, as a common
            supply would put it there.
        """
        made = []
        for case, clean in self.clean.items():
            signals = {name: np.array(clean[name]) for name in clean.names}
            if rng is not None:
                self._disturb(signals, case, rng, self.torque if torque is None else torque)
                self._sense(signals, rng, sensors or self.sensors, shared=shared)
            signals = {name: x - x.mean() for name, x in signals.items()}
            record = casid.Record(signals, clean.units, clean.Ts, t0=clean.t0, name=case)
            made.append(casid.Experiment(record, self.known[case], case))
        return made

    def _disturb(
        self, signals: dict[str, Array], case: str, rng: np.random.Generator, rms: float
    ) -> None:
        N = len(signals["gyro"])
        torque = rig.dragged(TS * np.arange(N, dtype=np.float64), rms, rng, BAND)
        gain = np.asarray(self._filter.gain(np.fft.rfftfreq(N, TS)) ** 2)  # forward and backward
        smooth = np.fft.irfft(gain * np.fft.rfft(torque), N).astype(np.float64)
        for name, response in torque_response(self.plants[case], smooth, TS).items():
            signals[name] += response

    def _sense(
        self,
        signals: dict[str, Array],
        rng: np.random.Generator,
        sensors: rig.Sensors,
        *,
        shared: bool,
    ) -> None:
        N = len(signals["gyro"])
        own, gyro, cart = (self._noise(N, rng) for _ in range(3))
        signals["gyro"] += sensors.gyro * gyro
        signals["accel"] += sensors.accel * own
        signals["ref"] += sensors.cart * (own if shared else cart)
