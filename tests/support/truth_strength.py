"""The size of an effect from its strength: what the best linear refit leaves of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from tests.support.truth_effects import (
    MOVING,
    ONE_SIDED,
    SAMPLES,
    SCATTER,
    Draws,
    sense,
    sense_input,
    spoil,
)
from tests.support.truth_motion import Motion, Runaway

Array = np.ndarray[Any, np.dtype[np.floating[Any]]]

FINE = 0.002  # integration step of the record itself [s]
COARSE = 0.005  # integration step while the size of an effect is sought [s]
TOLERANCE = 0.01  # relative tolerance of the strength in the search


class UnreachableStrength(ValueError):
    """No admissible size of this effect leaves the requested misfit in this record."""


@dataclass(slots=True)
class Refit:
    """Best linear model of one output: alpha_1, alpha_2 free, the rest linear and eliminated.

    xdd + alpha_1 xd + alpha_2 x = beta u; the regressor columns, at given alphas, are the response
    to u (or a constant where there is no input) and the two free modes, so the gain and the initial
    state come from linear least squares (variable projection, Golub & Pereyra 1973).
    """

    output: str  # "x" or "v"
    hold: str  # how u runs between grid points: "foh", "zoh", or "none" for no input
    start: tuple[float, float]  # alpha_1, alpha_2 without the effect
    last: tuple[float, float] = (0.0, 0.0)  # log-ratio of the last optimum to `start`

    def misfit(self, path: Motion, y: Array, t: Array) -> float:
        """Return the rms of y (N,), at times t, minus its best linear fit.

        Two starts, the undisturbed system and the last optimum, and the better end of the two:
        large delays and lags make local minima.
        """
        h = float(path.t[1] - path.t[0])
        first, stride = round((t[0] - path.t[0]) / h), round((t[1] - t[0]) / h)
        u = path.u[first:] if self.hold != "none" else path.u
        scale = float(np.std(y)) or 1.0

        def residual(log_ratio: Array) -> Array:
            alpha_1, alpha_2 = np.array(self.start) * np.exp(np.clip(log_ratio, -4.0, 4.0))
            root = np.sqrt(complex(0.25 * alpha_1**2 - alpha_2))
            if abs(root) < 1e-9:
                root = 1e-9 + 0j
            r = -0.5 * alpha_1 + root
            if abs(r.imag) > 0.0:
                mode = np.exp(r * t)
                modes = [mode.real, mode.imag]
            else:
                modes = [np.exp(r.real * t), np.exp((-0.5 * alpha_1 - root).real * t)]
            if self.hold == "none":
                columns = np.stack([np.ones_like(t), *modes], axis=1)
            else:
                response = _response(alpha_1, alpha_2, self.output, self.hold, h, u)
                columns = np.stack([response[::stride][: t.size], *modes], axis=1)
            columns = columns / np.linalg.norm(columns, axis=0)
            q, _ = np.linalg.qr(columns)
            out: Array = (y - q @ (q.T @ y)) / scale
            return out

        starts = {(0.0, 0.0), self.last}
        fits = [
            least_squares(residual, s, method="lm", xtol=1e-8, ftol=1e-9, max_nfev=60)
            for s in starts
        ]
        best = min(fits, key=lambda fit: float(fit.cost))
        self.last = (float(np.clip(best.x[0], -4, 4)), float(np.clip(best.x[1], -4, 4)))
        return float(np.sqrt(np.mean(best.fun**2))) * scale


def _response(alpha_1: float, alpha_2: float, output: str, hold: str, h: float, u: Array) -> Array:
    """Response of the unit-gain oscillator to u, from rest (any other start is in the modes)."""
    C = np.array([[0.0, 1.0]] if output == "v" else [[1.0, 0.0]])
    A, B = np.array([[0.0, 1.0], [-alpha_2, -alpha_1]]), np.array([[0.0], [1.0]])
    system = (A, B, C, np.zeros((1, 1)))
    A, B, C, D0, _ = cont2discrete(system, h, method=hold)  # type: ignore[call-overload]
    a = [1.0, -float(np.trace(A)), float(np.linalg.det(A))]
    g0, g1, g2 = float(D0[0, 0]), float((C @ B)[0, 0]), float((C @ A @ B)[0, 0])
    out: Array = lfilter([g0, g1 + a[1] * g0, g2 + a[1] * g1 + a[2] * g0], a, u)
    return out


@dataclass(frozen=True, slots=True)
class Outcome:
    """The final trajectory with all effects on, and what was found on the way."""

    kinds: tuple[str, str]
    sizes: Mapping[str, float]
    draws: list[Draws]
    strengths: tuple[float, float]
    joint: float
    motion: Motion
    output: str
    sensed: Array  # (N,) with the sensor's bias, delay, lag; no noise
    felt: Array  # the measured input on the integration grid, no noise
    alone: tuple[tuple[Array, Array], ...]  # output and input (N,) with one effect each, no noise

    def spoil(self, y: Array) -> Array:
        """Add outliers, then clip: the last two things that happen to a sample."""
        return spoil(y, self.sizes, dict(zip(self.kinds, self.draws, strict=True)), self.level())

    def level(self) -> float:
        """Where the sensor clips."""
        return self.sizes.get("saturation", 1.0) * float(np.max(np.abs(self.sensed)))


def solve(
    motion: Callable[[Mapping[str, float], float], Motion],
    refit: Refit,
    t: Array,
    noise: float,
    effect: str,
    strength: float,
    second: tuple[str, float] | None,
    draws: list[Draws],
    size: float | None,
    beside: Callable[[Array], Array] | None = None,
) -> Outcome:
    """Find each effect's size alone, then run them together on the fine grid.

    `beside` is the signal that a sensor mounted askew also feels.
    """
    kinds = (effect, second[0] if second else "none")
    wanted = (strength, second[1] if second else 0.0)
    named = dict(zip(kinds, draws, strict=True))
    paths: dict[tuple[float, bool], Motion] = {}

    def path(sizes: Mapping[str, float], h: float) -> Motion:
        acting = {kind: s for kind, s in sizes.items() if kind in MOVING}
        if acting:
            return motion(acting, h)
        if (h, False) not in paths:  # the motion itself is free of effects: once is enough
            paths[h, False] = motion({}, h)
        return paths[h, False]

    def measure(sizes: Mapping[str, float], h: float) -> float:
        now = path(sizes, h)
        y = sense(sizes, named, now, refit.output, t, beside)
        if set(sizes) & SCATTER:
            true = sense({}, named, now, refit.output, t)
            return float(np.sqrt(np.mean((y - true) ** 2))) / noise
        if set(sizes) & SAMPLES:
            level = sizes.get("saturation", 1.0) * float(np.max(np.abs(y)))
            return float(np.sqrt(np.mean((spoil(y, sizes, named, level) - y) ** 2))) / noise
        if len(now.u):
            now = replace(now, u=sense_input(sizes, named, now))
        return refit.misfit(now, y, t) / noise

    def reading(sizes: Mapping[str, float]) -> tuple[Array, Array]:
        now = path(sizes, FINE)
        y = sense(sizes, named, now, refit.output, t, beside)
        level = sizes.get("saturation", 1.0) * float(np.max(np.abs(y)))
        at = np.rint((t - now.t[0]) / (now.t[1] - now.t[0])).astype(int)
        u = sense_input(sizes, named, now)[at] if len(now.u) else now.u
        return spoil(y, sizes, named, level), u

    sizes: dict[str, float] = {}
    strengths = []
    for i, (kind, target) in enumerate(zip(kinds, wanted, strict=True)):
        if kind != "none":
            if i == 0 and size is not None:
                sizes[kind] = size
            else:
                sizes[kind] = _search(kind, draws[i], target, measure)
        single = {kind: sizes[kind]} if kind in sizes else {}
        strengths.append(measure(single, FINE) if kind != "none" or i == 0 else 0.0)
    if len(sizes) == 2 and not set(sizes) & (SAMPLES | SCATTER):
        joint = measure(sizes, FINE)
    else:
        joint = math.sqrt(sum(s**2 for s in strengths))  # spoilt samples: independent of the rest
    final = path(sizes, FINE)
    sensed = sense(sizes, named, final, refit.output, t, beside)
    felt = sense_input(sizes, named, final) if len(final.u) else final.u
    alone = tuple(reading({kind: sizes[kind]}) for kind in kinds) if len(sizes) == 2 else ()
    return Outcome(
        kinds,
        sizes,
        draws,
        (strengths[0], strengths[1]),
        joint,
        final,
        refit.output,
        sensed,
        felt,
        alone,
    )


def _search(
    kind: str, draw: Draws, target: float, measure: Callable[[Mapping[str, float], float], float]
) -> float:
    """Find the size that leaves the wanted strength, by secants in log-log inside a bracket."""
    if not target > 0.0:
        raise ValueError(f"strength={target!r} of {kind}: choose a positive one, or effect 'none'")
    start, limit = {
        "quadratic_damping": (0.01, 1e3),
        "coulomb_friction": (0.02, 0.3),
        "cubic_stiffness": (0.5, 1e4),
        "deadzone": (0.01, 1.0),
        "offset": (0.5, 5.0),
        "extra_input": (0.05, 1e2),
        "periodic_disturbance": (0.02, 1e2),
        "parameter_jump": (0.03, 3.0),
        "parameter_drift": (0.03, 3.0),
        "scheduled_parameter": (0.3, 10.0),
        "sensor_bias": (0.01, 1e2),
        "time_delay": (0.01, 0.2),
        "sensor_lag": (0.01, 0.5),
        "sensor_scale": (0.05, 0.9),
        "cross_axis": (0.01, 10.0),
        "missing_mode": (0.003, 0.1),
        "stribeck_friction": (0.02, 0.3),
        "bilinear_stiffness": (0.2, 9.0),
        "amplitude_damping": (0.5, 1e4),
        "parametric_stiffness": (0.03, 0.9),
        "hysteresis": (0.02, 10.0),
        "knock": (0.1, 100.0),
        "clock_drift": (0.01, 0.5),
        "jitter": (0.001, 0.05),
        "multiplicative_noise": (0.02, 1.0),
        "outliers": (0.01, 1e6),
        "saturation": (0.1, 0.999),  # of 1 - L / max|y|: less is more
    }[kind]
    signs = (1.0,) if kind in ONE_SIDED or draw.where == "m" else (draw.sign, -draw.sign)
    largest = 0.0
    for sign in signs:  # the drawn sign may be unreachable: a softening spring runs away

        def of(size: float, sign: float = sign) -> float:
            return measure({kind: 1.0 - size if kind == "saturation" else sign * size}, COARSE)

        size, found = _root(of, target, start, limit)
        if size is not None:
            return 1.0 - size if kind == "saturation" else sign * size
        largest = max(largest, found)
    raise UnreachableStrength(
        f"{kind}: strength {target:g} was not reached; the largest found is {largest:.3g}. "
        "Ask for less, take another seed, or give `size` instead."
    )


def _root(
    strength: Callable[[float], float], target: float, start: float, limit: float
) -> tuple[float | None, float]:
    """Return the size with the wanted strength (None if there is none), and the largest found."""
    low, high, size, largest = 0.0, math.inf, start, 0.0
    points: list[tuple[float, float]] = []
    for _ in range(25):
        try:
            found = strength(size)
        except (Runaway, np.linalg.LinAlgError):
            found = math.inf
        if math.isfinite(found):
            largest = max(largest, found)
            if abs(found / target - 1.0) < TOLERANCE:
                return size, largest
            points.append((math.log(size), math.log(max(found, 1e-12))))
        if found > target:
            high = min(high, size)
        else:
            low = max(low, size)
        if low >= limit * 0.999 or high - low < 2e-3 * high:
            break
        guess = 0.0
        slope = 1.0
        if len(points) > 1 and points[-1][0] != points[-2][0]:
            slope = (points[-1][1] - points[-2][1]) / (points[-1][0] - points[-2][0])
        if points and slope > 0.2:
            step = (math.log(target) - points[-1][1]) / min(slope, 3.0)
            guess = math.exp(points[-1][0] + min(max(step, -3.0), 3.0))
        if not low < guess < high:  # outside the bracket: halve it in ratio, or widen it
            guess = 3.0 * low if high == math.inf else math.sqrt(max(low, high / 30.0) * high)
        size = min(guess, limit)
    return None, largest
