"""An unknown input from a whole record, smoothed: it is a random walk, or filtered noise.

    w[t+1] = A_w w[t] + noise,   u = C_w w,   x[t+1] = A x[t] + E u[t],   y = C x + F u + v   (1)

The joint state is smoothed by the recursion of Rauch, Tung and Striebel, exact for linear systems
(`casid.linear.filtering.extended_smoother`). The response to known inputs is taken from y
beforehand. Levels of noise that are not given are those of the greatest likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.arrays import TINY, Array
from casid.data.record import Record
from casid.errors import ModelError, nearest
from casid.linear.filtering.extended_smoother import ExtendedSmoother, StochasticModel
from casid.linear.filtering.noisy_system import sample_noise
from casid.linear.filtering.split_dynamics import split_dynamics
from casid.linear.stability import LAST_STABLE, spectral_radius
from casid.unknown_inputs.observers.equivalent_model import require_recoverable
from casid.unknown_inputs.observers.input_estimate import InputEstimate, noise_guess
from casid.unknown_inputs.observers.system_reader import unknown_input_system
from casid.unknown_inputs.observers.unknown_input_system import UnknownInputSystem

_DIFFUSE = 10.0  # a start so large that its response alone would be ten times the outputs


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """One input's model, sampled: A (n, n), Q (n, n) of a source of size one, C (n,), its start."""

    A: Array
    Q: Array
    C: Array
    P0: Array | None  # None: no stationary start, as of a random walk
    level: str


def reconstruct_input(
    system: Any,
    record: Record,
    unknown: Sequence[str] | str | None = None,
    *,
    noise: Mapping[str, float] | None = None,
    rate: Mapping[str, float] | None = None,
    models: Mapping[str, Any] | None = None,
    start_sd: Mapping[str, float] | None = None,
    process: Array | None = None,
    values: Mapping[str, float] | None = None,
) -> InputEstimate:
    """The unknown inputs of a record and their pointwise standard deviations.

    Parameters
    ----------
    system, unknown, values : as in `unknown_input_system`. A continuous-time system is sampled
        with the record's Ts, its unknown inputs held over each sample.
    record : missing samples of outputs are allowed.
    noise : output -> standard deviation of its white noise; estimated for those not given.
    rate : unknown input -> size of the source that drives it, estimated if not given. Of a random
        walk the standard deviation over one second [its unit / sqrt(s)].
    models : unknown input -> a ``control`` system from white noise to the input, instead of a
        random walk: of unit intensity in continuous, unit variance in discrete time.
    start_sd : state or unknown input -> standard deviation of its first value, about zero. By
        default so large that it does not matter.
    process : (nx, nx) covariance of white noise that moves the states at each sample.

    Returns
    -------
    InputEstimate
        Standard deviations are those of (1) with levels as given or found: right where the input
        is such noise, too small where it jumps, and they do not count the error of found levels.

    Raises
    ------
    ModelError
        If the outputs do not determine an input (named), a name is wrong, or a model is not
        strictly proper or has another sample time.
    """
    s = unknown_input_system(system, unknown, values=values)
    y, u = s.signals(record)
    s = s if s.is_discrete else s.sampled(record.Ts)
    _refuse_names(s, noise or {}, rate or {}, models or {}, start_sd or {})
    require_recoverable(s)
    y = y - _known_response(s, u)
    shapes = [_shape(name, s, record.Ts, (models or {}).get(name)) for name in s.unknown]
    n = s.nx + sum(len(p.A) for p in shapes)
    pick = _inputs_of(shapes, s.nx, n)
    A, C, Q0, sources = _joint_system(s, shapes, pick, process)
    levels = {f"noise of {o}": (noise or {}).get(o) for o in s.outputs}
    levels |= {p.level: (rate or {}).get(i) for i, p in zip(s.unknown, shapes, strict=True)}
    model = _stochastic(s, A, C, Q0, sources, tuple(levels), n)
    smoother = ExtendedSmoother(model)
    used, guesses = np.isfinite(y), _guesses(s, y, shapes, levels)
    free = [name for name, value in levels.items() if value is None]
    x0 = np.zeros(n)
    scale = np.array([np.sqrt(np.nanmean(c**2)) or 1.0 for c in y.T])
    P0 = _start(s, A, C / scale[:, None], shapes, guesses, start_sd or {})
    if free:
        fitted = smoother.fit(np.where(used, y, 0.0), guesses, x0, P0, free=free, used=used)
        guesses = dict(fitted.values)
    found = smoother.smooth(np.where(used, y, 0.0), guesses, x0, P0, used=used)
    covariance = np.einsum("ij,tjk,ik->ti", pick, found.P, pick)
    return InputEstimate(
        s.unknown,
        {i: s.units[i] for i in s.unknown if i in s.units},
        record.t,
        found.x @ pick.T,
        np.sqrt(np.maximum(covariance, 0.0)),
        found.x[:, : s.nx],
        np.ones(record.N, dtype=bool),
        "smoothing",
        record.name,
        (),
        guesses,
        _assumed(s, models or {}, free),
    )


def _joint_system(
    s: UnknownInputSystem, shapes: Sequence[_Shape], pick: Array, process: Array | None
) -> tuple[Array, Array, Array, list[Array]]:
    """A, C and process noise of states and inputs together, and each source's of size one."""
    n = pick.shape[1]
    A, Q0 = np.zeros((n, n)), np.zeros((n, n))
    A[: s.nx, : s.nx] = s.A
    A[: s.nx] += s.E @ pick
    C = np.hstack([s.C, np.zeros((s.ny, n - s.nx))]) + s.F @ pick
    if process is not None:
        Q0[: s.nx, : s.nx] = process
    sources = []
    at = s.nx
    for p in shapes:
        own = slice(at, at + len(p.A))
        A[own, own] = p.A
        Q = np.zeros((n, n))
        Q[own, own] = p.Q
        sources.append(Q)
        at = own.stop
    return A, C, Q0, sources


def _assumed(
    s: UnknownInputSystem, models: Mapping[str, Any], free: Sequence[str]
) -> tuple[str, ...]:
    kinds = {
        i: "noise through the given model" if i in models else "a random walk" for i in s.unknown
    }
    exact = [f"the estimate of {', '.join(free)} is exact"] if free else []
    return (*(f"{i} is {kind}" for i, kind in kinds.items()), *exact)


def _known_response(s: UnknownInputSystem, u: Array) -> Array:
    """What known inputs do to the outputs, one bounded motion of many: starts are free anyway."""
    if u.shape[1] == 0:
        return np.zeros((len(u), s.ny))
    x = split_dynamics(s.A).run(u @ s.B.T)
    return np.asarray(x @ s.C.T + u @ s.D.T)


def _shape(name: str, s: UnknownInputSystem, Ts: float, model: Any) -> _Shape:
    if model is None:
        one = np.ones((1, 1))
        return _Shape(one, Ts * one, np.ones(1), None, f"rate of {name}")
    import control
    from scipy.linalg import expm, solve_discrete_lyapunov

    g = control.ss(model)
    if g.noutputs != 1 or np.any(g.D):
        raise ModelError(
            f"{s.name}: the model of {name} has {g.noutputs} outputs and D = {g.D.tolist()}; give "
            "one output and D = 0 (white noise itself is a pole that is fast for the record)"
        )
    if g.dt in (0, None):
        A, Q = expm(g.A * Ts), sample_noise(g.A, g.B @ g.B.T, Ts)
    elif g.dt is True or abs(g.dt - Ts) < 1e-6 * Ts:
        A, Q = g.A, g.B @ g.B.T
    else:
        raise ModelError(
            f"{s.name}: the model of {name} has Ts = {g.dt:g} s, the record {Ts:g} s; give it in "
            "continuous time, or sampled with the record's Ts"
        )
    stable = spectral_radius(A) < LAST_STABLE
    P0 = np.asarray(solve_discrete_lyapunov(A, Q)) if stable else None
    return _Shape(np.asarray(A), np.asarray(Q), np.asarray(g.C).ravel(), P0, f"rate of {name}")


def _inputs_of(shapes: Sequence[_Shape], nx: int, n: int) -> Array:
    """(nu, n) picks the inputs out of the joint state."""
    pick, at = np.zeros((len(shapes), n)), nx
    for i, p in enumerate(shapes):
        pick[i, at : at + len(p.A)] = p.C
        at += len(p.A)
    return pick


def _stochastic(
    s: UnknownInputSystem,
    A: Array,
    C: Array,
    Q0: Array,
    sources: Sequence[Array],
    levels: Sequence[str],
    n: int,
) -> StochasticModel:
    import casadi as ca

    ny = s.ny

    def process(_: Any, sizes: Any) -> Any:
        total = ca.SX(ca.DM(Q0))
        for i, Q in enumerate(sources):
            total = total + sizes[ny + i] ** 2 * ca.DM(Q)
        return total

    return StochasticModel(
        name=s.name,
        states=dict.fromkeys([*s.states, *(f"w{i}" for i in range(n - s.nx))], "1"),
        outputs=dict.fromkeys(s.outputs, "1"),
        levels=dict.fromkeys(levels, "1"),
        transition=lambda x: ca.DM(A) @ x,
        process=process,
        measurement=lambda x: ca.DM(C) @ x,
        variances=lambda sizes: sizes[:ny] ** 2,
    )


def _guesses(
    s: UnknownInputSystem,
    y: Array,
    shapes: Sequence[_Shape],
    levels: Mapping[str, float | None],
) -> dict[str, float]:
    """The levels given, and starts of the others.

    A source starts where the input that it makes in ten samples moves the outputs by their spread.
    """
    starts = {f"noise of {o}": noise_guess(y[:, i]) for i, o in enumerate(s.outputs)}
    for i, p in enumerate(shapes):
        x: Array = np.zeros(s.nx)
        response = [s.F[:, i]]
        for _ in range(10):
            x = s.A @ x + s.E[:, i]
            response.append(s.C @ x + s.F[:, i])
        gain = np.max(np.abs(np.array(response)) / np.nanstd(y, axis=0).clip(TINY))
        source = np.sqrt(max(float(p.C @ p.Q @ p.C), TINY))
        starts[p.level] = 0.3 / max(float(gain) * source, TINY)
    return {name: starts[name] if value is None else float(value) for name, value in levels.items()}


def _start(
    s: UnknownInputSystem,
    A: Array,
    C: Array,
    shapes: Sequence[_Shape],
    levels: Mapping[str, float],
    start_sd: Mapping[str, float],
) -> Array:
    """Covariance of the first joint state; `_DIFFUSE` where nothing is said.

    The size of a state is where its free response over the first samples is as large as the
    outputs (C has these in their rms).
    """
    n = len(A)
    span = 2 * n
    gramian, power = np.zeros(n), np.eye(n)
    for _ in range(span):
        gramian += np.sum((C @ power) ** 2, axis=0)
        power = A @ power
    reach = np.sqrt(span * len(C) / np.where(gramian > 0, gramian, np.inf))
    P0 = np.diag(np.where(reach > 0, (_DIFFUSE * reach) ** 2, 1.0))
    for name, sd in start_sd.items():
        if name in s.states:
            i = s.states.index(name)
            P0[i, i] = sd**2
    at = s.nx
    for name, p in zip(s.unknown, shapes, strict=True):
        k = len(p.A)
        if p.P0 is not None:
            P0[at : at + k, at : at + k] = levels[p.level] ** 2 * p.P0 + 1e-12 * np.diag(
                np.diag(p.P0)
            )
        elif name in start_sd and k == 1:
            P0[at, at] = start_sd[name] ** 2
        at += k
    return P0


def _refuse_names(s: UnknownInputSystem, *given: Mapping[str, Any]) -> None:
    allowed = (s.outputs, s.unknown, s.unknown, (*s.states, *s.unknown))
    what = ("noise", "rate", "models", "start_sd")
    for mapping, names, word in zip(given, allowed, what, strict=True):
        for name, value in mapping.items():
            if name not in names:
                raise ModelError(f"{s.name}: {word} names {name!r}{nearest(name, names)}")
            if word != "models" and not (np.isfinite(value) and value > 0):
                raise ModelError(
                    f"{s.name}: {word} of {name} is {value!r}; give a positive number (a very "
                    "small one for none)"
                )
