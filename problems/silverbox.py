"""Silverbox: an electronic circuit that behaves as a mass on a spring with damping.

    y'' = b u - d y' - k_1 y + offset                                                         (1)

Both voltages are recorded, the output y as the position of a mass of one. Benchmark of Wigren and
Schoukens (Uppsala University, technical report 2013-006), sampled at 1e7/2^14 = 610.35 Hz; the part
with a multisine input. The record comes through filters: between its samples the input is no
staircase. (1) takes it as held all the same, as one would who reads of a digital generator;
`silverbox_model("foh")` joins the samples by straight lines, `silverbox_model("bandlimited")` takes
the voltage as free of everything above half the sampling rate, as the filters leave it.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

import casid

TS = 2**14 / 1e7  # s
SAMPLES_PER_PERIOD = 1024


def silverbox_model(hold: Literal["zoh", "foh", "bandlimited"] = "zoh") -> casid.Model:
    """(1), with what the input does between its samples."""
    m = casid.Model("silverbox")
    y, v = m.state("y", "V"), m.state("v", "V/s")
    u = m.input("u", "V", hold=hold)
    b = m.parameter("b", "1/s^2", start=2e5, lower=0.0, upper=1e7)
    d = m.parameter("d", "1/s", start=50.0, lower=0.0, upper=1e4)
    k_1 = m.parameter("k_1", "1/s^2", start=1.9e5, lower=1e3, upper=1e7)
    offset = m.parameter("offset", "V/s^2", start=0.0, lower=-1e5, upper=1e5)
    m.derivative(y, v)
    m.balance(v, "force", inertia=1, terms=[b * u, -d * v, -k_1 * y, offset], unit="V/s^2")
    m.output("y", y, "V")
    return m


def simulate(
    *,
    periods: float = 8.0,
    b: float = 1.946e5,
    d: float = 41.0,
    k_1: float = 1.849e5,
    k_3: float = 7.51e5,
    offset: float = -1000.0,
    hold: Literal["zoh", "continuous"] = "continuous",
    noise: float = 2e-4,
    seed: int = 4,
) -> casid.Record:
    """A multisine of 22 mV rms from 0.6 to 200 Hz, in both channels sampled as the circuit's.

    `k_3` [1/(s^2 V^2)] hardens the spring, `noise` [V] is white, on the output. The input is the
    multisine itself between the samples (`continuous`), or its last sample (`zoh`). The circuit has
    run for a period before the record begins.
    """
    substeps = 8
    N, before = round(periods * SAMPLES_PER_PERIOD), SAMPLES_PER_PERIOD
    h = TS / substeps
    rng = np.random.default_rng(seed)
    lines = np.arange(1, round(200.0 * SAMPLES_PER_PERIOD * TS))
    phases = rng.uniform(0.0, 2.0 * np.pi, lines.size)
    # Twice as fine as the steps of Runge and Kutta, whose middle needs the input as well.
    fine = 2 * substeps * SAMPLES_PER_PERIOD
    spectrum = np.zeros(fine // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(1j * phases)
    period = np.fft.irfft(spectrum, fine)
    period *= 0.022 / np.std(period)
    if hold == "zoh":
        period = np.repeat(period[:: 2 * substeps], 2 * substeps)
    u = period.tolist()

    def acceleration(y: float, v: float, force: float) -> float:
        return b * force - d * v - (k_1 + k_3 * y * y) * y + offset

    y = v = 0.0
    measured = np.empty(N)
    for i in range(before + N):
        if i >= before:
            measured[i - before] = y
        for j in range(substeps):
            at = 2 * (i * substeps + j) % fine
            first, middle = u[at], u[at + 1]
            # A staircase steps at the sample itself: the step before ends with the old value.
            last = u[at + 1] if hold == "zoh" else u[(at + 2) % fine]
            a1 = acceleration(y, v, first)
            v2 = v + h / 2 * a1
            a2 = acceleration(y + h / 2 * v, v2, middle)
            v3 = v + h / 2 * a2
            a3 = acceleration(y + h / 2 * v2, v3, middle)
            v4 = v + h * a3
            a4 = acceleration(y + h * v3, v4, last)
            y += h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    measured += noise * rng.standard_normal(N)
    sampled = np.tile(period[:: 2 * substeps], math.ceil(periods))[:N]
    return casid.Record(
        {"y": measured, "u": sampled},
        {"y": "V", "u": "V"},
        Ts=TS,
        name="example",
        provenance=(f"simulated by problems/silverbox.py, seed {seed}",),
    )


def example() -> list[casid.Experiment]:
    """Thirteen seconds with a spring that hardens and an input that moves between the samples."""
    return [casid.Experiment(simulate(), {}, "example")]


def draw(seed: int) -> list[casid.Experiment]:
    """Thirteen seconds of (1), its input held, with phases and noise from this seed."""
    return [casid.Experiment(simulate(k_3=0.0, hold="zoh", seed=seed), {}, "drawn")]


problem = casid.Problem(
    name="silverbox",
    model=silverbox_model(),
    channels={"u": "u_V:V", "y": "y_V:V"},
    time="t_s",
    example=example,
    simulate=draw,
    truth={"b": 1.946e5, "d": 41.0, "k_1": 1.849e5, "offset": -1000.0},
    description="Electronic mass on a spring, driven by a multisine; voltages in and out.",
    references=(
        "T. Wigren, J. Schoukens, Data for Benchmarking in Nonlinear System Identification, "
        "Uppsala University, technical report 2013-006",
    ),
)
