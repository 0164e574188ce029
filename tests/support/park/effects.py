"""What may be hidden in a system: laws of force, changes of parameters, actuators and sensors.

The kinds have the names that a diagnosis gives them. Sizes are in units that suit the record: a
force of size 1 is the rms of what accelerates that balance, so that one range serves all systems.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.signal import lfilter

from tests.support.park.simulator import Acting, Array, Input, Place, System, staged

Stage = Literal["force", "parameter", "mode", "input", "sensor", "sample"]

TIMING = ("time_delay", "sensor_lag", "actuator_lag")
"""Kinds that are one class."""

GRID = 12
"""Instants, frequencies or positions that the prior of an effect allows, evenly."""


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """A kind in a place, with the law of its stage."""

    kind: str
    where: str
    stage: Stage
    law: Callable[..., Any]
    place: Any = None  # Place of a force
    channel: str = ""  # of a sensor or input, or what an effect refers to
    parameter: str = ""
    n: int = 1
    positive: bool = False
    grid: tuple[float, ...] = (0.0,)
    limit: float = 3.0  # the largest size that is still this effect
    fixed: bool = False  # present or not: no size to choose
    also: tuple[str, ...] = ()

    def force(self, size: Array, hyper: float, t: float, x: Array, p: Any, z: Any) -> Any:
        return self.law(size, hyper, t, x, p, z)

    def shape(self, t: float, hyper: float, horizon: float, z: Any) -> Any:
        return self.law(t, hyper, horizon, z)

    @property
    def names(self) -> list[tuple[str, str]]:
        """What counts as this effect: kind and place."""
        kinds: tuple[str, ...] = TIMING if self.kind in TIMING else (self.kind,)
        if self.kind in ("deadzone", "backlash"):
            kinds = ("deadzone", "backlash")
        if self.kind == "knock":  # the nearest that a catalogue has: a force for a while
            kinds = ("knock", "offset")
        return [(kind, where) for kind in kinds for where in (self.where, *self.also)]


@dataclass(frozen=True, slots=True)
class Scales:
    """Of a nominal record: rms force and rate, largest position of each place."""

    force: Mapping[str, float]
    rate: Mapping[str, float]
    position: Mapping[str, float]
    largest: Mapping[str, float]  # of each channel
    rms: Mapping[str, float]


def forces_of(place: Place, s: Scales, duration: float, Ts: float) -> Iterator[Effect]:
    """Laws of force at a place, of its rate v and position q."""
    F, V = s.force[place.name], s.rate[place.name]

    def v(x: Array) -> Array:
        return (place.of(x, place.rate) - place.operating) / V

    def made(kind: str, law: Callable[..., Any], **more: Any) -> Effect:
        return Effect(kind, place.name, "force", law, place=place, also=place.also, **more)

    plus = {"positive": True}
    yield made("quadratic_damping", lambda a, h, t, x, p, z: -F * a[0] * v(x) * abs(v(x)), **plus)
    if not place.one_way:
        edge = 0.05
        yield made(
            "coulomb_friction", lambda a, h, t, x, p, z: -F * a[0] * np.tanh(v(x) / edge), **plus
        )
        yield made(
            "cubic_damping", lambda a, h, t, x, p, z: -F * a[0] * v(x) ** 3, limit=1.0, **plus
        )
    yield made("offset", lambda a, h, t, x, p, z: F * a[0])
    slow, fast = 2 * np.pi * 6 / duration, 2 * np.pi * 0.08 / Ts
    yield made(
        "periodic_disturbance",
        lambda a, h, t, x, p, z: F * (a[0] * np.cos(h * t) + a[1] * np.sin(h * t)),
        n=2,
        grid=tuple(np.geomspace(slow, fast, GRID)),
    )
    motion = place.position
    if motion is None:
        return
    Q = s.position[place.name]

    def q(x: Array) -> Array:
        return place.of(x, motion) / Q

    yield made("cubic_stiffness", lambda a, h, t, x, p, z: -F * a[0] * q(x) ** 3)
    yield made("quadratic_stiffness", lambda a, h, t, x, p, z: -F * a[0] * q(x) ** 2)
    yield made(
        "end_stop",
        lambda a, h, t, x, p, z: -F * a[0] * np.sign(q(x)) * np.maximum(abs(q(x)) - h, 0.0),
        grid=tuple(np.linspace(0.6, 0.85, 3)),
        limit=30.0,
        **plus,
    )
    if place.spring is not None:
        k = place.spring
        kind = "deadzone" if len(place.signs) == 1 else "backlash"
        yield made(
            kind,
            lambda a, h, t, x, p, z: p[k] * Q * np.clip(q(x), -a[0], a[0]),
            limit=0.6,
            **plus,
        )
    yield Effect(
        "missing_mode",
        place.name,
        "mode",
        lambda: None,
        place=place,
        positive=True,
        grid=tuple(np.geomspace(2 * np.pi * 12 / duration, 2 * np.pi * 0.06 / Ts, GRID)),
        limit=F / V,
        also=place.also,
    )


def parameter_changes(system: System, duration: float) -> Iterator[Effect]:
    """Relative changes of each parameter: at an instant, along the record, with a channel."""
    times = tuple(np.linspace(0.15, 0.55, GRID) * duration)
    for name in (*system.theta, *system.more.get("moving", ())):

        def made(
            kind: str, where: str, law: Callable[..., Any], name: str = name, **more: Any
        ) -> Effect:
            return Effect(kind, where, "parameter", law, parameter=name, limit=0.8, **more)

        yield made(
            "parameter_jump",
            name,
            lambda t, h, T, z: np.asarray(t >= h, dtype=np.float64),
            grid=times,
        )
        yield made("parameter_drift", name, lambda t, h, T, z: t / T - 0.5)
        for c in system.beside:
            law = lambda t, h, T, z: z  # noqa: E731
            yield made("scheduled_parameter", f"{name}~{c.name}", law, channel=c.name)


def lagged(begins: Array, ends: Array, tau: Array, h: float) -> Array:
    """(steps, K) at the begin of each step of h: a signal of lines behind a lag, at rest before."""
    out = np.empty((len(begins), len(tau)))
    for i, one in enumerate(np.maximum(np.broadcast_to(tau, out.shape[1:]), 1e-9)):
        first, last = (np.broadcast_to(s, out.shape)[:, i] for s in (begins, ends))
        a = float(np.exp(-h / one))
        mean = one / h * (1 - a)  # of a line over a step, weighted by the lag
        driven = (mean - a) * first + (1 - mean) * last
        x = np.concatenate([first[:1], driven[:-1]])
        out[:, i] = lfilter([1.0], [1.0, -a], x)
    return out


def of_input(system: System, i: Input, s: Scales) -> Iterator[Effect]:
    """What may stand between a recorded input and what acts. Laws give (steps, 3, K)."""
    Ts, sub = system.Ts, system.substeps
    other = "foh" if i.hold == "zoh" else "zoh"
    sign = -1.0 if i.sd else 1.0  # a measured signal that is late: the true one is ahead

    def made(kind: str, law: Callable[..., Any], **more: Any) -> Effect:
        return Effect(kind, i.name, "input", law, channel=i.name, **more)

    def delayed(a: Array, u: Array) -> Array:
        return np.stack([staged(u, i.hold, sub, sign * d) for d in a[0]], axis=-1)

    yield made("time_delay", delayed, positive=True, limit=20.0)
    if not i.sd:

        def through_lag(a: Array, u: Array) -> Array:
            now = staged(u, i.hold, sub)
            halves = (now[:, :2].reshape(-1, 1), now[:, 1:].reshape(-1, 1))
            y = lagged(*halves, a[0] * Ts, Ts / sub / 2)
            y = y.reshape(-1, 2, a.shape[1])
            last = np.concatenate([y[1:, :1], y[-1:, 1:]])
            return np.concatenate([y, last], axis=1)

        yield made("actuator_lag", through_lag, positive=True, limit=30.0)
        top, R = s.largest[i.name], s.rms[i.name]
        if top > 1.2 * R:
            yield made(
                "actuator_saturation",
                lambda a, u: np.clip(
                    staged(u, i.hold, sub)[..., None], -top * (1 - a[0]), top * (1 - a[0])
                ),
                positive=True,
                limit=0.7,
            )
    else:
        R = s.rms[i.name]
        yield made("sensor_bias", lambda a, u: staged(u, i.hold, sub)[..., None] - R * a[0])
        zero = zero_of(i.unit)
        yield made(
            "sensor_scale",
            lambda a, u: zero + (staged(u, i.hold, sub)[..., None] - zero) / (1 + a[0]),
        )
    if system.law is not None and i is system.inputs[0]:
        return  # what is commanded next is not known yet: a loop has no other hold
    one = staged
    yield made(
        "hold",
        lambda a, u: (
            one(u, i.hold, sub)[..., None] * (1 - a[0]) + one(u, other, sub)[..., None] * a[0]  # type: ignore[arg-type]
        ),
        positive=True,
        fixed=True,
        limit=1.0,
    )


def of_sensor(system: System, j: int, s: Scales) -> Iterator[Effect]:
    """What may stand between an output and its record. Laws take and give (steps, ny, K)."""
    o, h = system.outputs[j], system.Ts / system.substeps
    R = s.rms[o.name]

    def made(kind: str, law: Callable[[Array, Array], Array], **more: Any) -> Effect:
        def changed(a: Array, Y: Array) -> Array:
            out = np.array(Y)
            out[:, j] = law(a, Y)
            return out

        return Effect(kind, o.name, "sensor", changed, channel=o.name, **more)

    def delayed(a: Array, Y: Array) -> Array:
        at = np.maximum(np.arange(len(Y) // 2)[:, None] - a[0] * system.substeps, 0)
        low = np.floor(at).astype(int)
        part, K = at - low, np.arange(Y.shape[2])
        begins, ends = Y[::2], Y[1::2]
        return np.repeat(begins[low, j, K] * (1 - part) + ends[low, j, K] * part, 2, axis=0)

    def behind(a: Array, Y: Array) -> Array:
        return np.repeat(lagged(Y[::2, j], Y[1::2, j], a[0] * system.Ts, h), 2, axis=0)

    yield made("sensor_bias", lambda a, Y: Y[:, j] + R * a[0])
    zero = zero_of(o.unit)
    yield made("sensor_scale", lambda a, Y: Y[:, j] + a[0] * (Y[:, j] - zero), limit=0.8)
    yield made("time_delay", delayed, positive=True, limit=20.0)
    yield made("sensor_lag", behind, positive=True, limit=30.0)
    for i, other in enumerate(system.outputs):
        if i != j and other.unit == o.unit:  # a sensor mounted askew feels its own kind
            ratio = R / s.rms[other.name]

            def mixed(a: Array, Y: Array, i: int = i, ratio: float = ratio) -> Array:
                return np.asarray(Y[:, j] + a[0] * ratio * Y[:, i])

            def drawn(a: Array, Y: Array, i: int = i) -> Array:
                return np.asarray(Y[:, j] + a[0] * (Y[:, i] - Y[:, j]))

            is_heat = o.unit == "K"  # a thermometer lies between two bodies
            yield made("cross_axis", drawn if is_heat else mixed, positive=is_heat)
    if system.more.get("rectified") == o.name:
        yield made("rectified", lambda a, Y: abs(Y[:, j]), fixed=True, limit=1.0, positive=True)


def zero_of(unit: str) -> float:
    """The reading that a gain leaves as it is: a thermometer is adjusted in melting ice."""
    return 273.15 if unit == "K" else 0.0


def catalogue_of(system: System, s: Scales) -> list[Effect]:
    """All effects with a smooth size that the prior of a system has."""
    duration = system.N * system.Ts
    out: list[Effect] = []
    for place in system.places:
        out += forces_of(place, s, duration, system.Ts)
    first = system.places[0]
    F = s.force[first.name]
    for c in system.beside:
        law = lambda a, h, t, x, p, z: F * a[0] * z  # noqa: E731
        out.append(Effect("extra_input", c.name, "force", law, place=first, channel=c.name))
    out += parameter_changes(system, duration)
    for i in system.inputs:
        if i.name not in system.more.get("reference", ()):
            out += of_input(system, i, s)
    for j in range(len(system.outputs)):
        out += of_sensor(system, j, s)
    without = system.more.get("without", ())
    return [e for e in out if e.kind not in without and (e.kind, e.where) not in without]


SAMPLES = ("outliers", "saturation")
"""Kinds that spoil single samples, whose size is no amplitude of a signature."""


def spoilt(kind: str, y: Array, level: float, rng: np.random.Generator) -> Array:
    """(N,) samples with spikes of `level`, or clipped by that share of their range."""
    if kind == "saturation":
        middle = 0.5 * (y.max() + y.min())
        half = 0.5 * (y.max() - y.min()) * (1 - level)
        return np.clip(y, middle - half, middle + half)
    hit = rng.random(len(y)) < 0.01
    height = level * rng.uniform(0.7, 1.3, len(y)) * rng.choice([-1.0, 1.0], len(y))
    return np.asarray(y + np.where(hit, height, 0.0), dtype=np.float64)


def unlisted_of(system: System, s: Scales) -> list[Effect]:
    """Effects that no catalogue has by name; in some systems one that it has does the same.

    Where a place has no position, q is its rate: `amplitude_damping` is then cubic damping.
    """
    duration, out = system.N * system.Ts, []
    for place in system.places:
        F, V = s.force[place.name], s.rate[place.name]
        motion = place.position or place.rate
        Q = s.position[place.name] if place.position else V

        def v(x: Array, place: Place = place, V: float = V) -> Array:
            return (place.of(x, place.rate) - place.operating) / V

        def q(x: Array, place: Place = place, Q: float = Q, motion: Any = motion) -> Array:
            return (place.of(x, motion) - (0.0 if place.position else place.operating)) / Q

        def made(kind: str, law: Callable[..., Any], place: Place = place, **more: Any) -> Effect:
            return Effect(kind, place.name, "force", law, place=place, **more)

        knock = 0.004 * duration
        out += [
            made(
                "knock",
                lambda a, h, t, x, p, z, F=F, w=knock: F * a[0] * np.exp(-(((t - h) / w) ** 2)),
                grid=tuple(np.linspace(0.15, 0.55, GRID) * duration),
                limit=30.0,
            ),
            made(
                "amplitude_damping",
                lambda a, h, t, x, p, z, F=F, v=v, q=q: -F * a[0] * q(x) ** 2 * v(x),
                positive=True,
            ),
            made(
                "rate_times_position",
                lambda a, h, t, x, p, z, F=F, v=v, q=q: -F * a[0] * q(x) * v(x),
            ),
        ]
    for name in system.theta:
        law = lambda t, h, T, z: np.sin(h * t)  # noqa: E731
        w = 2 * np.pi * 5 / duration
        out.append(
            Effect("parametric", name, "parameter", law, parameter=name, grid=(w,), limit=0.8)
        )
    return out


def sensed(Y: Array, acting: Sequence[Acting]) -> Array:
    """Outputs (2 steps, ny, K), as `simulate` gives them, with the effects of their sensors.

    Those that are late are true at the begin of each step.
    """
    for a in acting:
        if a.effect.stage == "sensor":
            Y = np.array(Y)
            Y[:, :, a.columns] = a.effect.law(a.size, Y[:, :, a.columns])
    return Y
