"""What the roll model leaves over in turns, and which terms of the simulator make it.

With the accelerometer in the place of the sway acceleration the simulator's roll is exactly

    A_2 phi'' = -(k - K_vdot g) phi - d phi' - (K_vdot + S) a_s + K_r r + K_delta delta + tau    (1)

where the torque tau is what (8.20) leaves out, a sum of terms of u, v, p, r and phi. The bilinear
rule turns it into an equation error 2 T (tau_t - tau_(t-2))/Den, Den that of (8.60): the error is
the change of tau, and spikes where tau changes fast. The remainder is the rule's own error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import casid
from analysis.ship_basin_turns.records import Sailed, changes, near_changes
from casid.arrays import Array
from casid.estimation.moments.equations.parts import Part, parts_of
from casid.model.model import Model

AFTER, BEFORE = 0.8, 0.2
"""A turn's entry or exit [s]: until a rudder of 0.4 rad/s has moved by 0.2 rad and the roll has
answered, and what a zero-phase filter draws ahead."""


def missing_torques(sailed: Sailed, *, U: float = 1.0) -> dict[str, Array]:
    """tau of (1) by its terms, at the record's samples [N m].

    Parameters
    ----------
    U : speed that the model takes as constant [m/s].
    """
    ship = sailed.motion.ship
    c, g = ship.coefficients, ship.g
    u, v, p, r, phi = (sailed[n] for n in ("u", "v", "p", "r", "phi"))
    bend = c.K_vdot * g * (np.sin(phi) - phi) - ship.M * g * (ship.arm(phi) - ship.arm.slope * phi)
    heel = c.K_phiuv * np.abs(u * v) + c.K_phiur * np.abs(u * r) + c.K_phiphiphi * phi**2
    return {
        "speed in K_r r": (c.K_ur - c.K_vdot) * (u - U) * r,
        "speed in damping": c.K_up * (u - U) * p,
        "quadratic roll damping": c.K_pp * np.abs(p) * p,
        "cross flow in roll": (c.K_vv * np.abs(v) + c.K_vr * np.abs(r)) * v
        + c.K_rv * np.abs(v) * r,
        "heel and bend of the arm": heel * phi + bend,
    }


def with_torques(sailed: Sailed) -> casid.Experiment:
    """The record with tau's terms as channels, so that a filter meets them too."""
    record = sailed.experiment.record
    for name, torque in missing_torques(sailed).items():
        record = record.with_channel(f"tau {name}", torque, "N m")
    return casid.Experiment(record, sailed.experiment.known, sailed.experiment.name)


def _coefficients(part: Part, values: Mapping[str, float]) -> Array:
    own = {**part.values, **values, **{n: part.values[n] for n in part.known}}
    return np.asarray(part.equation.g([own[q] for q in part.equation.parameters])).ravel()


def equation_errors(
    model: Model, experiments: Sequence[casid.Experiment], values: Mapping[str, float]
) -> dict[str, Array]:
    """(N,) left - columns' theta of each record; zero before the equation's longest lag."""
    found = {}
    for part in parts_of(model, experiments):
        equation, theta = part.equation, _coefficients(part, values)
        first = max(c.order for c in (equation.left, *equation.columns))
        rest = equation.left.samples(part.signals, first)
        for value, column in zip(theta, equation.columns, strict=True):
            rest = rest - value * column.samples(part.signals, first)
        found[part.record] = np.concatenate([np.zeros(first), rest])
    return found


def predicted_errors(
    model: Model, experiments: Sequence[casid.Experiment], values: Mapping[str, float]
) -> dict[str, dict[str, Array]]:
    """Record -> term -> (N,) its part of the equation error, 2 T (tau_t - tau_(t-2))/Den."""
    found: dict[str, dict[str, Array]] = {}
    for part in parts_of(model, experiments):
        theta, own = _coefficients(part, values), {**part.values, **values}
        columns = part.equation.columns
        (at,) = (i for i, c in enumerate(columns) if {t[0] for t in c.taps} == {"delta"})
        found[part.record] = {}
        for name in part.channels:
            if name.startswith("tau "):
                error = np.zeros(len(part.channels[name]))
                for _, lag, weight in columns[at].taps:
                    moved = np.roll(part.channels[name], lag)
                    moved[:lag] = moved[lag]
                    error += theta[at] / own["K_delta"] * weight * moved
                error[: columns[at].order] = 0.0
                found[part.record][name[4:]] = error
    return found


@dataclass(frozen=True, slots=True)
class Spikes:
    """How a residual stands out where turns begin and end; all in rad/s.

    Attributes
    ----------
    near, elsewhere : rms within `BEFORE` and `AFTER` of a change of the rudder, and of the rest.
    mean : mean of the modulus over everything.
    entries, exits : median over turns of the largest modulus at the entry, and at the exit.
    """

    near: float
    elsewhere: float
    mean: float
    entries: float
    exits: float

    @property
    def ratio(self) -> float:
        """rms near changes over rms elsewhere."""
        return self.near / self.elsewhere

    def row(self) -> dict[str, float]:
        """Of a table."""
        return {
            "rms near changes": self.near,
            "rms elsewhere": self.elsewhere,
            "ratio": self.ratio,
            "peak at entries / mean": self.entries / self.mean,
            "peak at exits / mean": self.exits / self.mean,
        }


def spikes(
    sailed: Sequence[Sailed],
    experiments: Sequence[casid.Experiment],
    errors: Mapping[str, Array],
) -> Spikes:
    """Of the residuals of all records; `experiments` may be trimmed, as by a filter."""
    near: list[Array] = []
    elsewhere: list[Array] = []
    peaks: dict[bool, list[float]] = {True: [], False: []}
    for s, e in zip(sailed, experiments, strict=True):
        error, Ts = errors[e.name], e.record.Ts
        shift = round(e.record.t[0] / Ts)
        at = near_changes(s.command, AFTER, before=BEFORE)[shift : shift + len(error)]
        used = np.arange(len(error)) >= 5
        near.append(error[at & used])
        elsewhere.append(error[~at & used])
        for k in changes(s.command):
            a, b = k - round(BEFORE / Ts) - shift, k + round(AFTER / Ts) - shift
            if a >= 5 and b <= len(error):
                is_entry = abs(s.command[k]) > abs(s.command[k - 1])
                peaks[is_entry].append(float(np.max(np.abs(error[a:b]))))
    a, b = np.concatenate(near), np.concatenate(elsewhere)
    return Spikes(
        near=float(np.sqrt(np.mean(a**2))),
        elsewhere=float(np.sqrt(np.mean(b**2))),
        mean=float(np.mean(np.abs(np.concatenate([a, b])))),
        entries=float(np.median(peaks[True])),
        exits=float(np.median(peaks[False])),
    )
