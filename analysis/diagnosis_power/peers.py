"""What others would name on the same cases: regressions of the residual acceleration.

All peers get the same columns: what a kind that they can express adds to phi''. On their own they
have the motion that was measured, the smoothed gyro and its integral less a line; aided, that which
casid's fitted baseline simulates, far less noisy than the sensors. The columns of the baseline
itself are projected out of everything first. Each peer gives a statistic and a name;
the statistic's threshold is set by null records afterwards, to the false-alarm rate of casid. What
a peer has no column for it cannot name, and that counts: a user does not know what is hidden.

    t-test          the candidate with the largest |t| when added alone
    correlation     the largest cross-correlation of simulation error and column, lags up to 1 s
    SINDy           sequentially thresholded least squares (Brunton, Proctor and Kutz 2016) of
                    PySINDy: the term that stands longest as the threshold rises
    ensemble        the same on bags of samples (Fasel et al. 2022), by median coefficient
    weak            the same on integrals against test functions (Messenger and Bortz 2021)
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import convolve1d
from scipy.signal import detrend, savgol_filter

import casid
from analysis.diagnosis_power.cases import Hidden
from analysis.diagnosis_power.energy import FITTED
from casid.arrays import Array
from casid.data.experiment import Experiment
from casid.estimation.simulation.fit import FitSettings, fit_model
from casid.estimation.simulation.minimization import Fit

Row = dict[str, Any]
Name = tuple[str, str]

ALONE = ("t-test", "correlation", "SINDy", "ensemble", "weak")
AIDED = tuple(f"{peer}, aided" for peer in ALONE)
PEERS = (*ALONE, *AIDED)

EXPRESSIBLE = {
    "quadratic_damping",
    "coulomb_friction",
    "cubic_stiffness",
    "deadzone",
    "extra_input",
    "parameter_jump",
    "parameter_drift",
    "scheduled_parameter",
    "time_delay",
    "sensor_lag",
}
"""Kinds with a column among the peers' candidates: rates over these stand beside those over all."""


def can_express(peer: str, kind: str) -> bool:
    """True if a peer has a column for a kind."""
    return kind in EXPRESSIBLE and (
        peer.startswith(("t-test", "correlation")) or kind != "parameter_jump"
    )


BEYOND_SINDY = {("parameter_jump", name) for name in ("k", "d", "m")} | {("extra_input", "ref")}
"""Left out of the sparse regressions, in their favour: with so many columns alike they name one of
these nearly always."""

THRESHOLDS = np.geomspace(0.5, 200.0, 24)
"""Of scaled coefficients, in units of the residual's spread over the root of its samples."""

JUMPS = 9
BAGS = 20


def peers_of(problem: casid.Problem, hidden: Hidden) -> Row:
    """Statistic and name of every peer, on its own and aided."""
    fit = _baseline(problem, hidden)
    alone = _of_motion(hidden, fit, aided=False)
    aided = _of_motion(hidden, fit, aided=True)
    return {**alone, **{f"{peer}, aided": found for peer, found in aided.items()}}


def _of_motion(hidden: Hidden, fit: Fit, *, aided: bool) -> Row:
    y, residual, base, columns, names = _regression(hidden, fit, aided=aided)
    basis, _ = np.linalg.qr(base)

    def apart(x: Array) -> Array:
        return np.asarray(x - basis @ (basis.T @ x))

    target, x = apart(y), apart(columns)
    x = x / np.maximum(np.linalg.norm(x, axis=0), 1e-12 * np.linalg.norm(columns, axis=0))
    sparse = [i for i, name in enumerate(names) if name not in BEYOND_SINDY]

    def sindy(target: Array, x: Array, bags: int = 0) -> tuple[float, int]:
        statistic, i = _sindy(target, x[:, sparse], bags)
        return statistic, sparse[i]

    found = {
        "t-test": _t_test(target, x),
        "correlation": _correlation(residual, x, round(1.0 / hidden.record.Ts)),
        "SINDy": sindy(target, x),
        "ensemble": sindy(target, x, bags=BAGS),
    }
    weak = _weak(round(0.4 / hidden.record.Ts))
    weak_y, weak_x, weak_base = (_project(weak, a) for a in (y, columns, base))
    q, _ = np.linalg.qr(weak_base)
    weak_x = weak_x - q @ (q.T @ weak_x)
    weak_x = weak_x / np.maximum(np.linalg.norm(weak_x, axis=0), 1e-300)
    found["weak"] = sindy(weak_y - q @ (q.T @ weak_y), weak_x)
    return {
        peer: {"statistic": float(statistic), "kind": names[i][0], "where": names[i][1]}
        for peer, (statistic, i) in found.items()
    }


def _fitted(r: casid.Record) -> casid.Record:
    return r.between(r.t0, r.t0 + (FITTED * r.N - 0.5) * r.Ts)


def _baseline(problem: casid.Problem, hidden: Hidden) -> Fit:
    part = _fitted(hidden.record)
    return fit_model(
        problem.model,
        [Experiment(part, {}, part.name)],
        FitSettings(starts=1),
        start=hidden.start,
        check_rank=False,
        throw=False,
    )


def _regression(
    hidden: Hidden, fit: Fit, *, aided: bool
) -> tuple[Array, Array, Array, Array, list[Name]]:
    """phi'', simulation error, columns of the baseline, columns and names of the candidates."""
    r = hidden.record
    part = _fitted(r)
    at = fit.criterion.simulated(fit.x, 0)
    window = max(5, 2 * round(0.05 / r.Ts) + 1)
    y = savgol_filter(part["gyro"], window, 3, deriv=1, delta=r.Ts)
    accel = savgol_filter(part["accel"], window, 3)
    p = savgol_filter(part["gyro"], window, 3)
    phi = detrend(cumulative_trapezoid(p, dx=r.Ts, initial=0))
    if aided:
        phi, p = at.x[:, 0], at.x[:, 1]
    t = part.t / part.t[-1]
    one, speed = np.ones_like(p), part["speed"] - part["speed"].mean()
    base = np.stack([phi, p, accel, one], axis=1)
    pairs: list[tuple[Name, Array]] = [
        (("quadratic_damping", "torque"), np.abs(p) * p),
        (("coulomb_friction", "torque"), np.tanh(p / (0.03 * np.std(p)))),
        (("cubic_stiffness", "torque"), phi**3),
        (("deadzone", "torque"), np.tanh(phi / (0.03 * np.std(phi)))),
        (("extra_input", "yaw_rate"), part["yaw_rate"]),
        (("extra_input", "ref"), part["ref"]),
        (("scheduled_parameter", "d~speed"), speed * p),
        (("scheduled_parameter", "k~speed"), speed * phi),
        (("parameter_drift", "k"), t * phi),
        (("parameter_drift", "d"), t * p),
        (("time_delay", "accel"), np.gradient(accel, r.Ts)),
    ]
    for at_t in np.linspace(0.0, 1.0, JUMPS + 2)[1:-1]:
        pairs += [
            (("parameter_jump", name), (t > at_t) * column)
            for name, column in (("k", phi), ("d", p), ("m", accel))
        ]
    edge = window  # what the smoother has not seen both sides of
    cut = slice(edge, -edge)
    columns = np.stack([column for _, column in pairs], axis=1)
    return y[cut], at.residual[cut, 0], base[cut], columns[cut], [name for name, _ in pairs]


def _t_test(y: Array, x: Array) -> tuple[float, int]:
    b = x.T @ y
    left = np.maximum(y @ y - b**2, 1e-300) / len(y)
    t = np.abs(b) / np.sqrt(left)
    return float(t.max()), int(t.argmax())


def _correlation(e: Array, x: Array, lags: int) -> tuple[float, int]:
    n = len(e)
    size = 1 << int(np.ceil(np.log2(2 * n)))
    spectrum = np.fft.rfft(e, size)[:, None] * np.conj(np.fft.rfft(x, size, axis=0))
    r = np.abs(np.fft.irfft(spectrum, size, axis=0))
    largest = np.maximum(r[: lags + 1].max(axis=0), r[-lags:].max(axis=0))
    largest = largest / np.sqrt(np.mean(e**2))
    return float(largest.max()), int(largest.argmax())


def _sindy(y: Array, x: Array, bags: int = 0) -> tuple[float, int]:
    """The threshold up to which a term stands, and the term."""
    from pysindy import STLSQ

    scale = float(np.sqrt(np.mean(y**2))) or 1.0
    rng = np.random.default_rng(0)
    # The rows enter by their moments only: a square root of them gives the same regression.
    draws = (
        [np.arange(len(y))]
        if not bags
        else [rng.integers(len(y), size=len(y)) for _ in range(bags)]
    )
    roots = []
    for rows in draws:
        both = np.column_stack([x[rows], y[rows] / scale])
        triangle: Array = np.linalg.qr(both, mode="r")  # type: ignore[assignment]
        roots.append((triangle[:, :-1], triangle[:, -1:]))
    best = (0.0, 0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a threshold leaves no term is what is sought
        for threshold in THRESHOLDS:
            coefficients = [
                STLSQ(threshold=threshold, alpha=1e-6, max_iter=20).fit(a, b).coef_[0]
                for a, b in roots
            ]
            size = np.abs(np.median(coefficients, axis=0))
            if not size.any():
                break
            i = int(size.argmax())
            best = (float(threshold + 1e-3 * size[i]), i)
    return best


def _weak(half: int) -> Array:
    """Derivative-free test function: (1 - s^2)^4 on 2 half + 1 samples, zero at both ends."""
    s = np.linspace(-1.0, 1.0, 2 * half + 1)
    return np.asarray((1 - s**2) ** 4 / half)


def _project(weight: Array, signal: Array) -> Array:
    """Integrals against the test function, moved by a quarter of its length each time."""
    step = max(1, len(weight) // 8)
    half = len(weight) // 2
    out = convolve1d(signal, weight, axis=0, mode="constant")
    return np.asarray(out[half:-half:step])
