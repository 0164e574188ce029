"""A laboratory pendulum on a cart dragged by hand, as two loggers would have recorded it.

The synthetic counterpart of Linder (2017), section 7.5.2: constants of Tables 7.3 and 7.4, k and d
near the estimates of Table 7.5. One inertial unit rides on the pendulum, one on the cart; each
writes at 100 Hz on a clock of its own. The pendulum is held while a hammer knocks on the cart, so
that both feel the same, and then released. Springs may stiffen: their torque is k(phi) phi with
k(phi) = k (1 + kappa phi^2).

The cart's unit measures what the indirect model has no use for, the cart's acceleration with noise:
it is the external reference (delta := measured a_y, F_delta = 1) that instruments are made of.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import casid

Array = NDArray[np.float64]

TABLES_7_3_AND_7_4 = {
    "I_x": 0.00707,  # kg m^2
    "M": 1.324,  # kg
    "z_g": -0.0211,  # m
    "z_s": -0.1163,  # m
    "I_xm": 5.1e-6,  # kg m^2, loaded; 0 nominal
    "m": 0.0975,  # kg, loaded; 0 nominal
    "z_m": -0.1225,  # m
}
STIFFNESS, DAMPING, G = 1.84, 0.0032, 9.81  # N m/rad, N m s/rad (Table 7.5), m/s^2

KNOCKS = ((1.5, 15.0), (2.2, 22.0), (4.0, 18.0))
"""Time [s] and height [m/s^2] of the hammer's pulses on the cart; unequal gaps, one alignment."""

KNOCK_WIDTH = 0.012
"""Standard deviation in time of a pulse [s]: nothing is left of it at 50 Hz."""

RELEASED_AT = 8.0
"""When the pendulum is let go and the cart begins to be dragged [s]."""

STARTED_WITHIN = 2.0
"""Both loggers are switched on in the last seconds before t = 0, one after the other [s]."""

HELD = (0.0, 8.0)
"""On either logger's clock: the stretch that holds all knocks and ends before the release [s]."""

SETTLING = 5.0
"""Left out between the release and the first sample that is used [s]."""

STEP = 0.0025
"""Of the Runge-Kutta integration [s]: (w h)^5/120 = 1e-9 a step at the pendulum's 14 rad/s."""


def direct_model(*, cart_recorded: bool = False) -> casid.Model:
    """The linear pendulum (7.10) with (7.13)-(7.15) and the constants of Tables 7.3 and 7.4.

    With `cart_recorded` the cart's acceleration a_y is a recorded input, for comparison.
    """
    v = TABLES_7_3_AND_7_4
    m = casid.Model("laboratory pendulum on a cart")
    phi, p = m.state("phi", "rad"), m.state("p", "rad/s")
    a_y = m.input("a_y", "m/s^2") if cart_recorded else m.unknown_input("a_y", "m/s^2")
    k = m.parameter("k", "N m/rad", start=1.5, lower=0.0, upper=50.0)
    d = m.parameter("d", "N m s/rad", start=0.005, lower=0.0, upper=1.0)
    # Below 0.00266 kg m^2 the inertia I_2 of the indirect model would be negative.
    I_x = m.parameter("I_x", "kg m^2", start=0.008, lower=0.0027, upper=0.1)
    load = m.parameter("m", "kg", value=0.0, lower=0.0, upper=1.0)
    z_m = m.parameter("z_m", "m", value=v["z_m"], lower=-0.5, upper=0.0)
    M, z_g = m.constant("M", v["M"], "kg"), m.constant("z_g", v["z_g"], "m")
    I_xm, z_s = m.constant("I_xm", 0.0, "kg m^2"), m.constant("z_s", v["z_s"], "m")
    g = m.constant("g", G, "m/s^2")
    S = M * z_g + load * z_m
    I_1 = I_x + M * z_g**2 + I_xm + load * z_m**2  # about the pivot (7.8)
    m.derivative(phi, p)
    m.balance(p, "torque", inertia=I_1, terms=[-(k + S * g) * phi, -d * p, S * a_y])
    m.output("gyro", p, "rad/s")
    m.output("accel", z_s * m.der(p) + g * phi - a_y, "m/s^2")
    return m


# -- the rig, by a simulator of its own ----------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Pendulum:
    """The nonlinear pendulum (7.9), with springs that may stiffen."""

    m: float = 0.0  # load [kg]
    k: float = STIFFNESS  # [N m/rad]
    d: float = DAMPING  # [N m s/rad]
    kappa: float = 0.0  # k(phi) = k (1 + kappa phi^2) [1/rad^2]

    @property
    def S(self) -> float:
        """M z_g + m z_m [kg m]."""
        v = TABLES_7_3_AND_7_4
        return v["M"] * v["z_g"] + self.m * v["z_m"]

    @property
    def I_1(self) -> float:
        """Inertia about the pivot [kg m^2], with I_xm where there is a load (7.8)."""
        v = TABLES_7_3_AND_7_4
        own = v["I_xm"] if self.m > 0.0 else 0.0
        return v["I_x"] + v["M"] * v["z_g"] ** 2 + own + self.m * v["z_m"] ** 2

    def acceleration(self, phi: float, p: float, a_y: float, torque: float = 0.0) -> float:
        """phi'' [rad/s^2] from (7.9)."""
        spring = self.k * (1.0 + self.kappa * phi * phi) * phi
        across = G * math.sin(phi) - a_y * math.cos(phi)
        return (torque - spring - self.d * p - self.S * across) / self.I_1

    def motion(self, a_y: Array, torque: Array, h: float, phi: float = 0.0) -> Array:
        """Integrate (7.9) from the angle `phi` at rest by Runge-Kutta 4.

        Parameters
        ----------
        a_y, torque : (2 n - 1,) cart acceleration [m/s^2] and disturbance [N m], every h/2.
        h : step [s].
        phi : angle at the start [rad].

        Returns
        -------
        (3, n) array: phi, phi' and phi'', every h.
        """
        spring, stiffening, d = self.k, self.k * self.kappa, self.d
        S, Sg, inverse = self.S, self.S * G, 1.0 / self.I_1
        sin, cos = math.sin, math.cos

        def rate(x: float, v: float, a: float, t: float) -> float:
            bend = (spring + stiffening * x * x) * x
            return (t - bend - Sg * sin(x) - d * v + S * a * cos(x)) * inverse

        a, t = a_y.tolist(), torque.tolist()
        n = len(a) // 2 + 1
        path = np.empty((n, 3))
        x, v = phi, 0.0
        for i in range(n):
            j = 2 * i
            c1 = rate(x, v, a[j], t[j])
            path[i] = x, v, c1
            if i == n - 1:
                break
            v2 = v + h / 2 * c1
            c2 = rate(x + h / 2 * v, v2, a[j + 1], t[j + 1])
            v3 = v + h / 2 * c2
            c3 = rate(x + h / 2 * v2, v3, a[j + 1], t[j + 1])
            v4 = v + h * c3
            c4 = rate(x + h * v3, v4, a[j + 2], t[j + 2])
            x += h / 6 * (v + 2 * v2 + 2 * v3 + v4)
            v += h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
        return path.T


@dataclass(frozen=True, slots=True)
class Sensors:
    """White noise (standard deviations) and constant biases of both inertial units, SI units."""

    gyro: float = 0.007
    accel: float = 0.01
    cart: float = 0.01
    gyro_bias: float = 0.005
    accel_bias: float = 0.05
    cart_bias: float = -0.03


NOISELESS = Sensors(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One run of the rig: what the two loggers wrote, and what was true.

    Attributes
    ----------
    cart : channel cart_accel [m/s^2], in the orientation of the pendulum's unit: it shows -a_y.
    pendulum : channels gyro [rad/s] and accel [m/s^2].
    offset : seconds to add to the cart's clock to get the pendulum's.
    released : the release on the pendulum's clock [s].
    truth : phi, p, p_dot, a_y at the pendulum's samples.
    plant : the pendulum that moved.
    """

    cart: casid.Record
    pendulum: casid.Record
    offset: float
    released: float
    truth: Mapping[str, Array]
    plant: Pendulum


def dragged(
    t: Array, amplitude: float, rng: np.random.Generator, band: tuple[float, float] = (0.3, 3.0)
) -> Array:
    """A Gaussian signal of rms `amplitude` with all its power in a band [Hz], t equidistant.

    Below the band a hand would run out of floor, above it out of speed.
    """
    frequency = np.fft.rfftfreq(t.size, t[1] - t[0])
    inside = (frequency >= band[0]) & (frequency <= band[1])
    lines = rng.standard_normal((2, int(inside.sum())))
    spectrum = np.zeros(frequency.size, dtype=np.complex128)
    spectrum[inside] = lines[0] + 1j * lines[1]
    signal = np.fft.irfft(spectrum, t.size)
    return np.asarray(amplitude * signal / np.sqrt(np.mean(signal**2)), dtype=np.float64)


def knocks(t: Array) -> Array:
    """The hammer's pulses in the cart's acceleration, (N,) [m/s^2] at times t [s]."""
    return np.asarray(
        sum(h * np.exp(-0.5 * ((t - at) / KNOCK_WIDTH) ** 2) for at, h in KNOCKS), dtype=np.float64
    )


def interpolated(values: Array, positions: Array) -> Array:
    """Between equidistant values, by the polynomial through the six nearest (Lagrange).

    Parameters
    ----------
    values : (k, n), n >= 6.
    positions : (N,) in steps from the first value, 0 to n - 1.

    Returns
    -------
    (k, N) array. A wave of w rad a step is met to w^6/205 of its amplitude.
    """
    nodes = range(-2, 4)
    first = np.clip(np.floor(positions).astype(int), 2, values.shape[1] - 4)
    apart = positions - first
    total = np.zeros((len(values), len(positions)))
    for node in nodes:
        weight = np.ones_like(apart)
        for other in nodes:
            if other != node:
                weight *= (apart - other) / (node - other)
        total += weight * values[:, first + node]
    return total


def record(
    plant: Pendulum | None = None,
    *,
    duration: float = 600.0,
    amplitude: float = 0.5,
    torque: float = 0.0,
    sensors: Sensors | None = None,
    seed: int = 1,
    name: str = "rig",
) -> Recording:
    """Knock, release, drag: one run of the rig.

    Parameters
    ----------
    plant : the pendulum; the nominal one by default.
    duration : of the stretch that will be used [s].
    amplitude : rms of the cart's acceleration between 0.3 and 3 Hz [m/s^2]. At 0.5 m/s^2 the
        pendulum swings by 0.06 rad rms: it resonates at 2.3 Hz.
    torque : rms of a random disturbance torque in the same band [N m].
    sensors : noise and biases; those of an inexpensive unit by default.
    seed : of everything random, the clocks' starts included.
    """
    plant = plant or Pendulum()
    sensors = sensors or Sensors()
    rng = np.random.default_rng(seed)
    steps = math.ceil((SETTLING + duration + 4.0) / STEP)
    half = np.linspace(0.0, steps * STEP, 2 * steps + 1, dtype=np.float64)
    onset = np.minimum(half / 2.0, 1.0) ** 2 * (3.0 - 2.0 * np.minimum(half / 2.0, 1.0))
    hand = onset * dragged(half, amplitude, rng)
    disturbance = onset * dragged(half, torque, rng)
    states = plant.motion(hand, disturbance, STEP)
    moving = np.vstack([states, hand[::2]])

    def at(t: Array) -> Array:
        """phi, p, p_dot, a_y (4, N): at rest and knocked upon before the release."""
        free = t >= RELEASED_AT
        values = np.zeros((4, t.size))
        values[:, free] = interpolated(moving, (t[free] - RELEASED_AT) / STEP)
        values[3] += knocks(t)
        return values

    Ts = 0.01
    N = round((RELEASED_AT + SETTLING + duration + 3.0) / Ts)
    start_cart, start_pendulum = rng.uniform(-STARTED_WITHIN, 0.0, 2)
    noise = rng.standard_normal((3, N))
    clock = Ts * np.arange(N)
    phi, p, p_dot, a_y = at(start_pendulum + clock)
    a_s = TABLES_7_3_AND_7_4["z_s"] * p_dot + G * np.sin(phi) - a_y * np.cos(phi)  # (7.14)
    source = (f"simulated by problems/pendulum_rig.py, seed {seed}",)
    return Recording(
        cart=casid.Record(
            {
                "cart_accel": -at(start_cart + clock)[3]
                + sensors.cart * noise[0]
                + sensors.cart_bias
            },
            {"cart_accel": "m/s^2"},
            Ts,
            name=f"{name}-cart",
            provenance=source,
        ),
        pendulum=casid.Record(
            {
                "gyro": p + sensors.gyro * noise[1] + sensors.gyro_bias,
                "accel": a_s + sensors.accel * noise[2] + sensors.accel_bias,
            },
            {"gyro": "rad/s", "accel": "m/s^2"},
            Ts,
            name=f"{name}-pendulum",
            provenance=source,
        ),
        offset=float(start_cart - start_pendulum),
        released=float(RELEASED_AT - start_pendulum),
        truth={"phi": phi, "p": p, "p_dot": p_dot, "a_y": a_y},
        plant=plant,
    )


# -- from two loggers to one record --------------------------------------------------------------


def merged(recording: Recording) -> casid.Record:
    """One record at 100 Hz with gyro, accel and ref, the cart's measured acceleration.

    The clocks are aligned by the knocks; the record is on the pendulum's clock, knocks included.

    Raises
    ------
    DataError
        If the knocks do not settle the offset.
    """
    from casid.data.alignment import align

    pendulum, cart = recording.pendulum, recording.cart
    alignment = align(
        pendulum.between(*HELD),
        cart.between(*HELD),
        using="accel",
        other_using="cart_accel",
        max_offset=STARTED_WITHIN,
    )
    both = alignment.apply(pendulum, cart)
    both = both.with_channel("ref", -both["cart_accel"], "m/s^2").without("cart_accel")
    return both


def prepared(recording: Recording, *, duration: float | None = None) -> casid.Record:
    """The record that linear estimators take: `merged`, low-passed, at 50 Hz.

    Every channel passes the 21-tap low-pass (0.5 Hz, stop band from 6 Hz) forward and backward; the
    stretch from 5 s after the release is cut out, one sample in two kept, and the means subtracted:
    they hold the biases. The pendulum resonates where the filter's gain is 0.7: that leaves a
    linear model as it is, but shrinks the angle that stiffening springs see.

    Parameters
    ----------
    duration : of the record [s]; 600 s are 30 000 samples. All there is by default.

    Raises
    ------
    DataError
        If the knocks do not settle the offset, or the recording is shorter than `duration`.
    """
    from casid.data.fir_filter import equiripple
    from casid.data.preparation import detrend

    smooth = merged(recording)
    low_pass = equiripple(0.5, smooth.Ts, stop_hz=6.0, order=20)
    for _ in range(2):
        smooth = low_pass.apply(smooth)
    first = int(np.ceil((recording.released + SETTLING - smooth.t0) / smooth.Ts))
    last = smooth.N if duration is None else first + round(duration / smooth.Ts)
    if last > smooth.N:
        raise casid.DataError(
            f"{smooth.name}: {duration:g} s are requested, {(smooth.N - first) * smooth.Ts:g} s "
            "were recorded after the release. Ask for less, or record for longer."
        )
    thinned = casid.Record(
        {name: smooth[name][first:last:2] for name in smooth.names},
        smooth.units,
        2 * smooth.Ts,
        t0=float(smooth.t[first]),
        name=smooth.name,
        provenance=(*smooth.provenance, "1 sample in 2 kept"),
    )
    return detrend(thinned)


def experiments(
    *,
    duration: float = 600.0,
    amplitude: float = 0.5,
    kappa: float = 0.0,
    torque: float = 0.0,
    sensors: Sensors | None = None,
    load_known: bool = False,
    seed: int = 1,
) -> list[casid.Experiment]:
    """The nominal and the loaded pendulum, prepared: two records of `duration` at 50 Hz.

    The loaded one knows its load's own inertia I_xm, and m only with `load_known`. Other arguments
    as in `record`; `kappa` [1/rad^2] is the stiffening of the springs.
    """
    loads = {case: dict(values) for case, values in problem.load_cases.items()}
    made = []
    for i, (case, known) in enumerate(loads.items()):
        run = record(
            Pendulum(m=known["m"], kappa=kappa),
            duration=duration,
            amplitude=amplitude,
            torque=torque,
            sensors=sensors,
            seed=1000 * seed + i,
            name=case,
        )
        if case == "loaded" and not load_known:
            del known["m"]
        made.append(casid.Experiment(prepared(run, duration=duration), known, case))
    return made


def example() -> list[casid.Experiment]:
    """A minute of the nominal rig as merged, with springs that stiffen: for the diagnosis."""
    run = record(Pendulum(kappa=5.0), duration=60.0, amplitude=1.0, name="example")
    whole = merged(run)
    cut = whole.between(run.released + SETTLING, run.released + SETTLING + 60.0)
    return [casid.Experiment(cut, dict(problem.load_cases["nominal"]), "example")]


problem = casid.Problem(
    name="pendulum_rig",
    model=direct_model().eliminate("a_y", using="accel"),
    channels={"gyro": "gyro:rad/s", "accel": "accel:m/s^2"},
    recorded={"ref": "m/s^2"},
    time="t",
    load_cases={
        "nominal": {"m": 0.0, "I_xm": 0.0},
        "loaded": {"m": TABLES_7_3_AND_7_4["m"], "I_xm": TABLES_7_3_AND_7_4["I_xm"]},
    },
    example=example,
    description="Laboratory pendulum on a cart dragged by hand, held by springs; two loggers.",
    references=(
        "J. Linder, Indirect System Identification for Unknown Input Problems, 2017, section 7.5.2",
    ),
)


def aligned(run: Recording) -> casid.Alignment:
    """The clock of the cart's logger against that of the pendulum, from the knocks at its start."""
    return casid.align(
        run.pendulum.between(*HELD),
        run.cart.between(*HELD),
        using="accel",
        other_using="cart_accel",
        max_offset=STARTED_WITHIN,
    )
