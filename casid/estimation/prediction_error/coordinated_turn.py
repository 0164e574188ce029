"""Speed of a vehicle from its track, x, y and heading: the coordinated turn.

On a circle the velocities in the vehicle's own axes do not change, u ahead and v to the side. So
they and the rate of turn r wander, and position and heading follow:

    x' = u cos(psi) - v sin(psi),   y' = u sin(psi) + v cos(psi),   psi' = r                (1)
    u' = surge w_1,   v' = sway w_2,   r' = yaw w_3,   w white of intensity one             (2)

The usual coordinated turn has v = 0, the course being the heading (Y. Bar-Shalom, X. R. Li,
T. Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, sec. 11.7); a ship
drifts. Linder (2017), section 9.6, has the surge speed of a model ship from such a smoother.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import TINY, Array
from casid.data.record import Record
from casid.errors import DataError, ModelError
from casid.linear.filtering.extended_smoother import (
    ExtendedSmoother,
    Levels,
    Smoothed,
    StochasticModel,
)

OUTPUTS = {"x": "m", "y": "m", "psi": "rad"}
"""What is measured, in the earth's axes: x north, y east, psi from x to y, or any other pair."""

SOURCES = (
    "Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and "
    "Navigation, Wiley 2001, sec. 11.7 (coordinated turn)",
    "H. E. Rauch, F. Tung, C. T. Striebel, AIAA J. 3 (1965) 1445-1450 (smoother)",
    "J. Linder, Indirect System Identification for Unknown Input Problems, 2017, sec. 9.6",
)


def coordinated_turn(Ts: float, *, drifts: bool = True) -> StochasticModel:
    """Model (1)-(2) over a sample time Ts [s], its motion exact for constant u, v and r.

    Parameters
    ----------
    drifts : whether there is a sway speed v.
    """
    states = {"x": "m", "y": "m", "psi": "rad", "r": "rad/s", "u": "m/s"}
    levels = {"surge": "m/s^1.5", "yaw": "rad/s^1.5"}
    if drifts:
        states["v"] = "m/s"
        levels["sway"] = "m/s^1.5"
    levels |= {"position": "m", "heading": "rad"}

    def process(x: Any, values: Any) -> Any:
        return _intensity(x, {n: values[i] for i, n in enumerate(levels)}, Ts, drifts=drifts)

    def variances(values: Any) -> Any:
        at, heading = (values[list(levels).index(name)] for name in ("position", "heading"))
        return ca.vertcat(at**2, at**2, heading**2)

    return StochasticModel(
        "coordinated turn" if drifts else "coordinated turn without drift",
        states,
        OUTPUTS,
        levels,
        partial(_transition, Ts=Ts, drifts=drifts),
        process,
        lambda x: x[:3],
        variances,
        angles=("psi",),
    )


def _transition(x: Any, Ts: float, *, drifts: bool) -> Any:
    """The state one sample later: moved along the mean heading, turned by the rate."""
    psi, turned = x[2], x[3] * Ts
    # The mean velocity points along the mean heading: sin(a)/a of half the turn, whose
    # series holds (to 1e-10) where a division would be by zero.
    a = turned / 2
    small = ca.fabs(a) < 0.02
    quotient = ca.sin(ca.if_else(small, 1.0, a)) / ca.if_else(small, 1.0, a)
    length = Ts * ca.if_else(small, 1 - a**2 / 6 + a**4 / 120, quotient)
    c, s = ca.cos(psi + a), ca.sin(psi + a)
    u, v = x[4], x[5] if drifts else 0.0
    moved = [x[0] + length * (u * c - v * s), x[1] + length * (u * s + v * c)]
    return ca.vertcat(*moved, psi + turned, *[x[i] for i in range(3, 6 if drifts else 5)])


def _intensity(x: Any, level: Mapping[str, Any], Ts: float, *, drifts: bool) -> Any:
    """Intensity over one sample along the mean heading, by Gauss's quadrature.

    Position answers a push of u and v to first order in the time left, one of r to second:
    polynomials of degree four at most, for which three nodes are exact.
    """
    root = np.sqrt(0.6)
    psi = x[2] + x[3] * Ts / 2
    c, s = ca.cos(psi), ca.sin(psi)
    u, v = x[4], x[5] if drifts else 0.0
    order = ["surge", "yaw", *(["sway"] if drifts else [])]
    n = 6 if drifts else 5
    Q = ca.SX.zeros(n, n)
    for node, weight in ((-root, 5 / 18), (0.0, 8 / 18), (root, 5 / 18)):
        left = Ts * (1 + node) / 2
        pushes = {
            "surge": [c * left, s * left, 0.0, 0.0, 1.0, 0.0],
            "sway": [-s * left, c * left, 0.0, 0.0, 0.0, 1.0],
            "yaw": [
                -(u * s + v * c) * left**2 / 2,
                (u * c - v * s) * left**2 / 2,
                left,
                1.0,
                0.0,
                0.0,
            ],
        }
        for name in order:
            push = ca.vertcat(*pushes[name][:n])
            Q += weight * Ts * level[name] ** 2 * (push @ push.T)
    return Q


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Speeds along a track, each with its standard deviation.

    The deviations are given the levels of noise, and for a track that is smooth as (2) says.

    Attributes
    ----------
    t : (N,) [s]; u, v, r : surge and sway speed [m/s], rate of turn [rad/s].
    U : (N,) speed along the course, sqrt(u^2 + v^2) [m/s]; course : (N,) [rad].
    smoothed : all states with their covariances.
    levels : of the noises, estimated or stated.
    notes : what to mind.
    """

    name: str
    t: Array
    smoothed: Smoothed
    levels: Levels
    notes: tuple[str, ...] = ()

    @property
    def u(self) -> Array:
        """(N,) surge speed [m/s]."""
        return self.smoothed["u"]

    @property
    def u_sd(self) -> Array:
        """(N,) standard deviation of the surge speed [m/s]."""
        return self.smoothed.std_error("u")

    @property
    def drifts(self) -> bool:
        """Whether sway is part of the model."""
        return "v" in self.smoothed.states

    @property
    def v(self) -> Array:
        """(N,) sway speed [m/s]; zero where the model has none."""
        return self.smoothed["v"] if self.drifts else np.zeros_like(self.u)

    @property
    def v_sd(self) -> Array:
        """(N,) standard deviation of the sway speed [m/s]."""
        return self.smoothed.std_error("v") if self.drifts else np.zeros_like(self.u)

    @property
    def r(self) -> Array:
        """(N,) rate of turn [rad/s]."""
        return self.smoothed["r"]

    @property
    def U(self) -> Array:
        """(N,) speed along the course [m/s]; the sign of u where there is no drift."""
        return np.asarray(np.hypot(self.u, self.v)) if self.drifts else self.u

    @property
    def U_sd(self) -> Array:
        """(N,) standard deviation of U [m/s], to first order; that of u + v where U is zero."""
        if not self.drifts:
            return self.u_sd
        speed = np.maximum(self.U, TINY)
        slope = np.column_stack([self.u / speed, self.v / speed])
        slope[self.U == 0] = 1.0
        variance = np.einsum("ti,tij,tj->t", slope, self.smoothed.P[:, 4:6, 4:6], slope)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    @property
    def course(self) -> Array:
        """(N,) direction of the velocity [rad], psi + atan2(v, u)."""
        return np.asarray(self.smoothed["psi"] + np.arctan2(self.v, self.u))

    def references(self) -> tuple[str, ...]:
        """The sources of the method."""
        return SOURCES

    def __repr__(self) -> str:
        return (
            f"<Track {self.name}: N = {len(self.t)}, U = {self.U.min():.4g} to "
            f"{self.U.max():.4g} m/s, std. error {np.median(self.U_sd):.2g}>"
        )

    def __str__(self) -> str:
        rows = []
        units = coordinated_turn(1.0).levels
        for name, value in self.levels.values.items():
            error = self.levels.relative_errors[name]
            how = "stated" if error == 0 else f"+- {100 * error:.0f} %"
            how = "as good as zero, or undetermined" if name in self.levels.undetermined else how
            rows.append(f"  {name:10}  {value:11.4g} {units[name]:9} {how}")
        return "\n".join([repr(self)[1:-1], *rows, *(f"  note: {note}" for note in self.notes)])


@names_wrong_types()
def smooth_track(
    record: Record,
    channels: Mapping[str, str] | None = None,
    *,
    known: Mapping[str, float | Array] | None = None,
    levels: Mapping[str, float] | None = None,
    drifts: bool = True,
) -> Track:
    """Speed along a track from positions and heading, by an extended Kalman smoother.

    Parameters
    ----------
    record : its samples marked missing are left out. Headings may jump by 2 pi.
    channels : ``{"x": ..., "y": ..., "psi": ...}``, the channels' names where they differ.
    known : standard deviation of measurement noise per output [m, rad], a number or (N,): an
        accuracy that changes, a rounding. It comes on top of the levels position and heading.
    levels : those that are known, name -> value: surge, sway [m/s^1.5], yaw [rad/s^1.5],
        position [m], heading [rad]. The others are estimated by maximum likelihood.
    drifts : estimate a sway speed, too; without, the heading is the course.

    Raises
    ------
    DataError
        For units that are not m, m and rad, or too few samples.
    ModelError
        For unknown channels or levels.
    SolveError
        If the likelihood has no optimum: state some of the levels.
    """
    names = {out: (channels or {}).get(out, out) for out in OUTPUTS}
    for out in (*(channels or {}), *(known or {})):
        if out not in OUTPUTS:
            raise ModelError(f"track: no output {out!r}; there are {', '.join(OUTPUTS)}")
    for out, channel in names.items():
        record[channel]  # says which there are
        if record.units[channel] != OUTPUTS[out]:
            raise DataError(
                f"{record.name}: {channel} is in {record.units[channel]}, but {out} of a track is "
                f"in {OUTPUTS[out]}; choose the channel with channels={{{out!r}: ...}}"
            )
    y = np.column_stack([record[c] for c in names.values()])
    used = ~np.column_stack([record.is_missing(c) for c in names.values()])
    sd = np.zeros(y.shape)
    for i, out in enumerate(OUTPUTS):
        sd[:, i] = np.asarray((known or {}).get(out, 0.0), dtype=float)
    if np.any(used.sum(axis=0) < 4):
        few = [c for c, count in zip(names.values(), used.sum(axis=0), strict=True) if count < 4]
        raise DataError(
            f"{record.name}: {few[0]} has fewer than 4 samples that are not missing; a speed needs "
            "more, widen the window"
        )
    model = coordinated_turn(record.Ts, drifts=drifts)
    smoother = ExtendedSmoother(model)
    start, x0, P0 = _start(record, names, sd, model)
    for name in levels or {}:
        if name not in model.levels:
            raise ModelError(
                f"{model.name}: no level {name!r}; there are {', '.join(model.levels)}"
            )
    free = [name for name in model.levels if name not in (levels or {})]
    start |= {k: float(v) for k, v in (levels or {}).items()}
    found = smoother.fit(y, start, x0, P0, free=free, used=used, known=sd)
    smoothed = smoother.smooth(y, found.values, x0, P0, used=used, known=sd)
    track = Track(record.name, record.t, smoothed, found)
    return replace(track, notes=_notes(track))


def _notes(track: Track) -> tuple[str, ...]:
    """What spoils the numbers of a track."""
    notes = []
    slow = int(np.sum(track.U < 2 * track.U_sd))
    if slow:
        notes.append(
            f"{slow} samples have a speed below twice its standard deviation: course and drift "
            "mean little there"
        )
    if track.levels.undetermined:
        notes.append(
            f"{', '.join(track.levels.undetermined)}: as good as zero, or undetermined by these "
            "samples; state it with levels="
        )
    return tuple(notes)


def rounding_error(values: Array, digits: int = 3) -> Array:
    """Standard deviation (N,) of numbers written with so many significant digits.

    One unit of the last digit / sqrt(12) (W. F. Sheppard 1898), for `known` of `smooth_track`: give
    the values in the unit they were written in. Those below a thousandth count as a thousandth:
    what was rounded to zero is not exact.
    """
    power = np.floor(np.log10(np.maximum(np.abs(np.asarray(values, dtype=float)), 1e-3)))
    return np.asarray(10.0 ** (power - digits + 1) / np.sqrt(12.0))


def _start(
    record: Record,
    names: Mapping[str, str],
    sd: Array,
    model: StochasticModel,
) -> tuple[dict[str, float], Array, Array]:
    """Levels to start from, and a first state that knows little."""
    at: dict[str, Array] = {out: record.filled(channel) for out, channel in names.items()}
    at["psi"] = np.unwrap(at["psi"])
    N = record.N
    # Long enough for noise to average out of a slope, short against a turn: a tenth, a heuristic.
    span = max(2, min(N // 10, 50))
    t = record.Ts * np.arange(span)
    slopes = {out: float(np.polyfit(t, v[:span], 1)[0]) for out, v in at.items()}
    psi = float(np.median(at["psi"][: max(1, span // 4)]))
    u = slopes["x"] * np.cos(psi) + slopes["y"] * np.sin(psi)
    v = -slopes["x"] * np.sin(psi) + slopes["y"] * np.cos(psi)
    lag = max(1, span // 2)
    moved = np.hypot(at["x"][lag:] - at["x"][:-lag], at["y"][lag:] - at["y"][:-lag])
    speed = max(float(np.median(moved)) / (lag * record.Ts), abs(u), 1e-6)
    turn = float(np.std(at["psi"][lag:] - at["psi"][:-lag])) / (lag * record.Ts)
    turn = max(turn, abs(slopes["psi"]), 1e-6)
    # Second differences are noise, were it not for turns: an upper end for the start.
    rough = {out: float(np.std(np.diff(v, 2))) / np.sqrt(6.0) for out, v in at.items()}
    window = N * record.Ts / 10
    first = {
        "surge": 0.1 * speed / np.sqrt(window),
        "sway": 0.1 * speed / np.sqrt(window),
        "yaw": turn / np.sqrt(window),
        "position": max((rough["x"] + rough["y"]) / 2, 1e-6 * speed * record.Ts),
        "heading": max(rough["psi"], 1e-6),
    }
    wide = [
        float(np.hypot(10 * first["position"] + speed * record.Ts, 3 * sd[0, i])) for i in (0, 1)
    ]
    deviation = [*wide, 0.5, 3 * turn, speed, speed]
    n = len(model.states)
    x0 = np.array([at["x"][0], at["y"][0], at["psi"][0], 0.0, u, v])[:n]
    P0 = np.diag(np.square(deviation[:n]))
    return {k: first[k] for k in model.levels}, x0, P0
