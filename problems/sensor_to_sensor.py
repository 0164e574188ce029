"""Two accelerometers on a structure that an unmeasured force shakes.

Two floors of a building, or a machine and the frame it stands on. With z = x2 - x1:

    m_1 x1'' = -k_1 x1 - d_1 x1' + k_2 z + d_2 z' + F                                       (1)
    m_2 (x1'' + z'') = -k_2 z - d_2 z'                                                      (2)
    a_1 = x1'',   a_2 = x1'' + z''                                                          (3)

Nobody measures F. The accelerometer of the lower floor takes its place, a_1 = x1'', and (1) goes
with it: the remainder is the transmissibility from one sensor to the other,

    a_2 = (d_2 s + k_2)/(m_2 s^2 + d_2 s + k_2) a_1,                                        (4)

sensor-to-sensor identification (S2SID) in Linder (2017), section 3.6. The dynamics that both
sensors share, m_1, k_1, d_1, cancel (Example 3.11): neither the force nor the lower floor's
stiffness has to be known, and neither can be found. Of k_2, d_2 and m_2 only ratios are seen, so
m_2 is known. The noise of a_1 is in the input, and in the error of (4) as well: a model that takes
a_1 as it is errs by a little, and more the noisier a_1 is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import casid

Array = NDArray[np.float64]

TRUE = {
    "m_1": 3000.0,  # kg
    "k_1": 9e5,  # N/m
    "d_1": 1.2e3,  # N s/m
    "m_2": 2000.0,  # kg
    "k_2": 5e5,  # N/m
    "d_2": 1.5e3,  # N s/m
}
"""The simulated building: eigenfrequencies 11.3 and 24.3 rad/s, upper floor alone 15.8 rad/s."""

NOISE = 0.02
"""Standard deviation of the white noise on either accelerometer [m/s^2]."""


def direct_model() -> casid.Model:
    """(1)-(3), the force still in it.

    `m_1`, `k_1` and `d_1` are constants with the simulated values; the indirect model has none of
    them.
    """
    m = casid.Model("two floors, shaken")
    # At rest before the record; after the elimination no output feels these two any more.
    x, v = m.state("x_1", "m", initial=0.0), m.state("v_1", "m/s", initial=0.0)
    z, w = m.state("z", "m"), m.state("w", "m/s")
    F = m.unknown_input("F", "N")
    k_2 = m.parameter("k_2", "N/m", start=3e5, lower=1e4, upper=1e7)
    d_2 = m.parameter("d_2", "N s/m", start=5e3, lower=0.0, upper=1e5)
    units = {"m_1": "kg", "k_1": "N/m", "d_1": "N s/m", "m_2": "kg"}
    m_1, k_1, d_1, m_2 = (m.constant(name, TRUE[name], unit) for name, unit in units.items())
    spring = k_2 * z + d_2 * w
    m.derivative(x, v)
    m.derivative(z, w)
    m.balance(v, "lower floor", inertia=m_1, terms=[-k_1 * x, -d_1 * v, spring, F])
    m.balance(w, "upper floor", inertia=m_2, terms=[-spring, -m_2 * m.der(v)])
    m.output("a_1", m.der(v), "m/s^2")
    m.output("a_2", m.der(v) + m.der(w), "m/s^2")
    return m


def indirect_model() -> casid.Model:
    """(4): the force replaced by the lower accelerometer."""
    return direct_model().eliminate("F", using="a_1")


def force(N: int, h: float, *, size: float, rng: np.random.Generator) -> Array:
    """(N,) an unmeasured force [N] every h seconds: noise through two lags of 25 ms.

    Standard deviation `size`, and a knock of thrice that about every four seconds.
    """
    keep = float(np.exp(-h / 0.025))
    push = rng.standard_normal(N) + 4 * np.sqrt(0.025 / h) * (rng.random(N) < h / 4.0)
    out = np.empty(N)
    first = second = 0.0
    for i, p in enumerate(push.tolist()):
        first += (1 - keep) * (p - first)
        second += (1 - keep) * (first - second)
        out[i] = second
    return np.asarray(size * out / np.std(out))


def simulate(
    *,
    duration: float = 60.0,
    size: float = 3000.0,
    k_3: float = 0.0,
    noise: float = NOISE,
    seed: int = 1,
    name: str = "example",
    with_force: bool = False,
    **changed: float,
) -> casid.Record:
    """The building (1)-(3) under a random force, sampled at 200 Hz.

    Parameters
    ----------
    duration : [s]. size : standard deviation of the force [N].
    k_3 : hardening of the spring between the floors, k_2 z + k_3 z^3 [N/m^3].
    noise : standard deviation of either accelerometer [m/s^2].
    with_force : a channel "force" with what nobody measures.
    changed : other values of `TRUE`.
    """
    v = TRUE | changed
    m_1, k_1, d_1, m_2, k_2, d_2 = (v[n] for n in ("m_1", "k_1", "d_1", "m_2", "k_2", "d_2"))
    Ts, substeps = 0.005, 2
    h, N = Ts / substeps, round(duration / Ts)
    rng = np.random.default_rng(seed)
    push = force(2 * N * substeps + 1, h / 2, size=size, rng=rng)

    def rates(motion: tuple[float, ...], F: float) -> tuple[float, ...]:
        x, u, z, w = motion
        spring = k_2 * z + d_2 * w + k_3 * z**3
        a_1 = (-k_1 * x - d_1 * u + spring + F) / m_1
        return u, a_1, w, -spring / m_2 - a_1

    state: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    a_1, a_2 = np.empty(N), np.empty(N)
    at = 0
    for i in range(N):
        now = rates(state, float(push[at]))
        a_1[i], a_2[i] = now[1], now[1] + now[3]
        for _ in range(substeps):
            F0, F1, F2 = (float(push[at + k]) for k in range(3))
            s1 = rates(state, F0)
            s2 = rates(tuple(x + h / 2 * r for x, r in zip(state, s1, strict=True)), F1)
            s3 = rates(tuple(x + h / 2 * r for x, r in zip(state, s2, strict=True)), F1)
            s4 = rates(tuple(x + h * r for x, r in zip(state, s3, strict=True)), F2)
            state = tuple(
                x + h / 6 * (r1 + 2 * r2 + 2 * r3 + r4)
                for x, r1, r2, r3, r4 in zip(state, s1, s2, s3, s4, strict=True)
            )
            at += 2
    record = casid.Record(
        {
            "a_1": a_1 + noise * rng.standard_normal(N),
            "a_2": a_2 + noise * rng.standard_normal(N),
        },
        {"a_1": "m/s^2", "a_2": "m/s^2"},
        Ts=Ts,
        name=name,
        provenance=(f"simulated by problems/sensor_to_sensor.py, seed {seed}",),
    )
    true = push[: 2 * N * substeps : 2 * substeps]
    return record.with_channel("force", true, "N") if with_force else record


def example() -> list[casid.Experiment]:
    """One minute of the building with something that the model above leaves out."""
    return [casid.Experiment(simulate(k_3=2e8), {}, "example")]  # hardening, for the diagnosis


def draw(seed: int) -> list[casid.Experiment]:
    """One minute of the building as the model has it: force and noise drawn from `seed`."""
    return [casid.Experiment(simulate(seed=seed, name="drawn"), {}, "drawn")]


problem = casid.Problem(
    name="sensor_to_sensor",
    model=indirect_model(),
    channels={"a_1": "a_1:m/s^2", "a_2": "a_2:m/s^2"},
    time="t",
    example=example,
    simulate=draw,
    truth={name: TRUE[name] for name in ("k_2", "d_2")},
    description="Two accelerometers on a building that an unmeasured force shakes; in the example "
    "the upper floor's columns harden, which the model leaves out.",
    references=(
        "J. Linder, Indirect System Identification for Unknown Input Problems, 2017, section 3.6",
    ),
)
