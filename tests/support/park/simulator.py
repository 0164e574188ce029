"""Many variants of one system at a time, by a Runge-Kutta method of order 4 in fixed steps.

A variant is a column: initial state, parameters, and at most one hidden effect of some size. All
columns share the clock, so that a step is a few operations on arrays and the sensitivities, sizes
and rivals of a record cost one pass. NumPy and SciPy alone: nothing is shared with casid.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Hold = Literal["zoh", "foh"]
Signal = Callable[[np.random.Generator, int, float], Array]
"""Generator, number of samples, sample time -> (N,) samples."""


@dataclass(frozen=True, slots=True)
class Input:
    """A recorded input: a command without noise, or a measured signal with `sd`."""

    name: str
    unit: str
    signal: Signal
    hold: Hold = "foh"
    sd: float = 0.0


@dataclass(frozen=True, slots=True)
class Output:
    """A sensor with white noise."""

    name: str
    unit: str
    sd: float


@dataclass(frozen=True, slots=True)
class Disturbance:
    """An unmeasured input: noise of order 1 or 2 at the samples, straight lines between."""

    sd: float
    tau: float  # s, correlation or decay time
    omega: float = 0.0  # rad/s; 0: no resonance

    def coefficients(self, Ts: float) -> tuple[float, float, float]:
        """a1, a2 and the sd of the innovation of d_k = a1 d_{k-1} + a2 d_{k-2} + w_k."""
        r = float(np.exp(-Ts / self.tau))
        if not self.omega:
            return r, 0.0, self.sd * float(np.sqrt(1 - r * r))
        a1, a2 = 2 * r * float(np.cos(self.omega * Ts)), -r * r
        share = (1 + a2) * ((1 - a2) ** 2 - a1**2) / (1 - a2)  # variance of w over that of d
        return a1, a2, self.sd * float(np.sqrt(share))

    def draw(self, rng: np.random.Generator, N: int, Ts: float) -> Array:
        """(N,) samples of the stationary process."""
        from scipy.signal import lfilter

        a1, a2, sd = self.coefficients(Ts)
        before = int(np.ceil(8 * self.tau / Ts))
        drawn = lfilter([1.0], [1.0, -a1, -a2], sd * rng.standard_normal(N + before))
        return np.asarray(drawn[before:], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Place:
    """Where an effect may act: a balance, or an element between two, with its motion.

    `signs` gives the balances on which a force of the place acts; `rate` and `position` are
    combinations of states. `spring` is the parameter of a spring there, `also` further names.
    """

    name: str
    signs: Mapping[int, float]
    rate: Mapping[int, float]
    position: Mapping[int, float] | None = None
    spring: str | None = None
    also: tuple[str, ...] = ()
    operating: float = 0.0  # what the rate is about; laws act on the deviation from it
    one_way: bool = False  # the rate keeps its sign: no friction

    def of(self, x: Array, motion: Mapping[int, float]) -> Array:
        """A combination of states (nx, ...)."""
        total = sum(c * x[i] for i, c in motion.items())
        return np.asarray(total, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class System:
    """A system as its builder knows it.

    `rate(x, u, p, f)` gives the derivatives, `sensors(x, dx, u, p)` the outputs, rows of columns:
    u the inputs and behind them the disturbances, p the parameters, f extra forces by balance.
    `law(k, y, r, memory)`, if there is one, computes the first input from measured outputs.
    """

    name: str
    domain: str
    Ts: float
    N: int
    theta: Mapping[str, float]  # estimated; each case draws its own
    start: Mapping[str, tuple[float, float]]  # state -> mean and spread of the initial value
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    rate: Callable[..., Sequence[Any]]
    sensors: Callable[..., Sequence[Any]]
    places: tuple[Place, ...]
    beside: tuple[Input, ...] = ()
    disturbances: tuple[Disturbance, ...] = ()
    law: Callable[..., Any] | None = None
    more: Mapping[str, Any] = field(default_factory=dict)  # substeps, spread, without

    @property
    def substeps(self) -> int:
        return int(self.more.get("substeps", 2))


@dataclass(frozen=True, slots=True)
class Acting:
    """An effect that acts in some columns: `size` (n, columns), `hyper` (columns,)."""

    effect: Any  # effects.Effect
    columns: slice
    size: Array
    hyper: Array


def value_at(samples: Array, hold: Hold, times: Array, *, left: bool = False) -> Array:
    """A sampled signal at times in sample intervals; before and after it keeps its ends."""
    shift = -1e-9 if left else 1e-9
    at = np.clip(np.floor(times + shift).astype(int), 0, len(samples) - 1)
    if hold == "zoh":
        return np.asarray(samples[at])
    after = np.minimum(at + 1, len(samples) - 1)
    part = np.clip(times - at, 0.0, 1.0)
    return np.asarray(samples[at] * (1 - part) + samples[after] * part, dtype=np.float64)


def stage_times(N: int, substeps: int) -> Array:
    """(N substeps, 3) times of the stages of each step, in sample intervals."""
    step = np.arange(N * substeps)[:, None] + np.array([0.0, 0.5, 1.0])
    return np.asarray(step / substeps, dtype=np.float64)


def staged(samples: Array, hold: Hold, substeps: int, delay: float = 0.0) -> Array:
    """(N substeps, 3) values of a signal at the stages; the last is the limit from the left."""
    times = stage_times(len(samples), substeps) - delay
    out = value_at(samples, hold, times)
    out[:, 2] = value_at(samples, hold, times[:, 2], left=True)
    return np.asarray(out, dtype=np.float64)


@dataclass(slots=True)
class Feedback:
    """A sampled control law around a single column, and what it commanded.

    `actuator` gives what acts of all that was commanded until now, (steps, 3, 1) at its stages.
    """

    law: Callable[..., Any]
    noise: Array  # (N, ny) of the sensors
    reference: Array  # (N,)
    actuator: Callable[[Array], Array]
    memory: dict[str, Any] = field(default_factory=dict)
    commanded: list[float] = field(default_factory=list)

    def __call__(self, k: int, y: Array, steps: int) -> Array:
        """What acts in the steps of sample k, (steps, 3, 1)."""
        u = np.asarray(self.law(k, y + self.noise[k][:, None], self.reference[k], self.memory))
        self.commanded.append(float(u.ravel()[0]))
        return self.actuator(np.array(self.commanded))[-steps:]


def simulate(
    system: System,
    x0: Array,
    p: Mapping[str, Array],
    U: Array,
    acting: Sequence[Acting] = (),
    *,
    beside: Mapping[str, Array] | None = None,
    feedback: Feedback | None = None,
    clock: tuple[float | Array, float] | None = None,
) -> tuple[Array, Array]:
    """Outputs before sensor effects, (2 steps, ny, K), at the begin and end of each step; states.

    At the end of a step held inputs have not stepped to the next yet.

    States (samples + 1, nx, K) are those at the samples and at the end.

    Parameters
    ----------
    x0 : (nx, K) initial states.
    U : (steps, 3, nu, K or 1) inputs and disturbances at the stages.
    beside : channels that effects refer to, (steps, 3) or (steps, 3, K) each.
    clock : time of the first step, of all columns or each, and length of the record [s].
    """
    K, h = x0.shape[1], system.Ts / system.substeps
    steps, nx = len(U), len(system.start)
    x = np.concatenate([np.broadcast_to(x0, (nx, K)), np.zeros((2, K))])
    forces = [a for a in acting if a.effect.stage == "force"]
    moved = [a for a in acting if a.effect.stage == "parameter"]
    modes = [a for a in acting if a.effect.stage == "mode"]
    for a in modes:
        place = a.effect.place
        x[nx, a.columns] = place.of(x[:, a.columns], place.position)
        x[nx + 1, a.columns] = place.of(x[:, a.columns], place.rate)
    here = {
        id(a): {name: np.broadcast_to(v, (K,))[a.columns] for name, v in p.items()} for a in forces
    }
    n_balances = 1 + max(max(place.signs) for place in system.places)
    t0, horizon = clock or (0.0, steps * h)

    def channel(a: Acting, step: int, j: int) -> Any:
        signal = (beside or {}).get(a.effect.channel)
        return 0.0 if signal is None else signal[step, j]

    def derivative(step: int, j: int, x: Array, u: Array) -> tuple[Array, Mapping[str, Array]]:
        t = t0 + (step + 0.5 * j) * h
        f = np.zeros((n_balances, K))
        now: dict[str, Array] = dict(p)
        for a in moved:
            name = a.effect.parameter
            now[name] = np.array(np.broadcast_to(now[name], (K,)))
            z = channel(a, step, j)
            now[name][a.columns] *= 1 + a.size[0] * a.effect.shape(t, a.hyper, horizon, z)
        for a in forces:
            z = channel(a, step, j)
            push = a.effect.force(a.size, a.hyper, t, x[:, a.columns], here[id(a)], z)
            for b, sign in a.effect.place.signs.items():
                f[b, a.columns] += sign * push
        dx = np.zeros_like(x)
        for a in modes:
            part, place = x[:, a.columns], a.effect.place
            w, zeta = a.hyper, 0.05
            pull = w**2 * (part[nx] - place.of(part, place.position))
            pull = pull + 2 * zeta * w * (part[nx + 1] - place.of(part, place.rate))
            for b, sign in place.signs.items():
                f[b, a.columns] += sign * a.size[0] * pull
            dx[nx, a.columns], dx[nx + 1, a.columns] = part[nx + 1], -pull
        for i, row in enumerate(system.rate(x, u, now, f)):
            dx[i] = row
        return dx, now

    Y = np.empty((2 * steps, len(system.outputs), K))
    X = np.empty((steps // system.substeps + 1, nx, K))
    U = np.array(U) if feedback is not None else U
    for step in range(steps):
        k, inside = divmod(step, system.substeps)
        if not inside:
            X[k] = x[:nx]
        if feedback is not None and not inside:
            seen = np.stack([np.broadcast_to(r, (K,)) for r in _seen(system, x, U[step, 0], p)])
            U[step : step + system.substeps, :, 0] = feedback(k, seen, system.substeps)
        k1, now = derivative(step, 0, x, U[step, 0])
        for i, row in enumerate(system.sensors(x, k1, U[step, 0], now)):
            Y[2 * step, i] = row
        k2, _ = derivative(step, 1, x + 0.5 * h * k1, U[step, 1])
        k3, _ = derivative(step, 1, x + 0.5 * h * k2, U[step, 1])
        k4, _ = derivative(step, 2, x + h * k3, U[step, 2])
        x = x + h / 6 * (k1 + 2 * (k2 + k3) + k4)
        at_end, now = derivative(step, 2, x, U[step, 2])
        for i, row in enumerate(system.sensors(x, at_end, U[step, 2], now)):
            Y[2 * step + 1, i] = row
    X[-1] = x[:nx]
    return Y, X


def _seen(system: System, x: Array, u: Array, p: Mapping[str, Array]) -> Sequence[Any]:
    """Outputs that a control law sees: of states, not of derivatives."""
    return system.sensors(x, np.zeros_like(x), u, p)
