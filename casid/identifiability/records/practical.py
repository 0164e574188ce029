"""Practical identifiability: errors to expect from these records under their noise.

With S the sensitivities of the outputs to the unknown parameters and initial states along the
user's excitation and sigma the standard deviation of white noise, the Fisher information is

    F = sum_k S_k' diag(1 / sigma^2) S_k                                                     (1)

and F^-1 bounds the covariance of every unbiased estimate (Cramer and Rao; Ljung 1999, (7.88)).
A structurally unidentifiable parameter has no information here either; an identifiable one may
still be poorly determined by this record. No fit is needed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.data.problem import Problem
from casid.errors import IdentifiabilityError
from casid.estimation.estimate import Estimate
from casid.estimation.local_rank import LocalRank, describe_null, local_rank
from casid.identifiability.records.planned_experiment import Experiments, Noise, Planned, plan
from casid.identifiability.records.practical_result import (
    LARGEST_RELATIVE,
    POOR,
    UNDETERMINED,
    UNJUDGED,
    WELL,
    Conditioning,
    Direction,
    Matrices,
    Practical,
    Row,
    Setup,
    Verdict,
)
from casid.model.model import Model

__all__ = ["Direction", "Practical", "Row", "practical_identifiability"]


@names_wrong_types()
def practical_identifiability(
    problem: Problem | Model,
    experiments: Experiments = None,
    *,
    at: Mapping[str, float] | Estimate | None = None,
    noise: Mapping[str, float] | None = None,
    own: Sequence[str] = (),
    substeps: int | None = None,
    largest_relative: float = LARGEST_RELATIVE,
    largest_correlation: float = 0.99,
) -> Practical:
    """The error to expect of each unknown parameter from these experiments and their noise (1).

    Parameters
    ----------
    problem : or its model alone.
    experiments : records with the inputs (SI units); outputs need not be measured. Default the
        problem's own example.
    at : values of parameters and initial states, or an estimate; default the starts.
    noise : output -> standard deviation of its white noise; default that of the problem, else what
        the measured outputs show, else one unit (a relative statement).
    own : parameters of which every record has its own value.
    substeps : Runge-Kutta steps a sample; None takes as many as matter.
    largest_relative : a parameter is "poorly determined" if its relative standard error is larger.
    largest_correlation : where there is no such error to judge (noise unknown, value zero), it is
        "poorly determined" if it is correlated more with another. Both limits are conventions.

    Returns
    -------
    Practical

    Raises
    ------
    IdentifiabilityError
        If nothing is unknown.
    ModelError, DataError, SolveError
        See `plan`.

    Example
    -------
    >>> import casid
    >>> import numpy as np
    >>> m = casid.Model("cooling cup")
    >>> T, tau = m.state("T", "K"), m.parameter("tau", "s", start=100, lower=1)
    >>> m.derivative(T, -T / tau)
    >>> _ = m.output("excess", T, "K")
    >>> noise = 0.1 * np.random.default_rng(1).standard_normal(200)
    >>> excess = 50 * np.exp(-5 * np.arange(200) / 400) + noise
    >>> cup = casid.Record({"excess": excess}, {"excess": "K"}, Ts=5, name="cup")
    >>> casid.practical_identifiability(m, cup, noise={"excess": 0.1})
    <Practical cooling cup: rank 2 of 2>
    """
    p = plan(problem, experiments, at=at, noise=noise, own=own, substeps=substeps)
    names = p.criterion.names
    if not names:
        raise IdentifiabilityError(
            f"{p.problem.name}: no parameter and no initial state is unknown, so there is nothing "
            "to determine; free one with model.with_unknown(name)"
        )
    root = p.root()
    rank = local_rank(root.T @ root, p.x, names, p.scale)
    matrices = _matrices(root, rank, names)
    limits = (largest_relative, largest_correlation)
    rows = [_row(p, i, rank, matrices, limits) for i in range(len(names))]
    return Practical(
        problem=p.problem.name,
        rows=tuple(sorted(rows, key=lambda r: r.is_state)),
        setup=Setup(
            tuple(d.name for d in p.criterion.data), p.criterion.n_samples, p.noise, *limits
        ),
        matrices=matrices,
        conditioning=_conditioning(p, root, rank),
    )


def _matrices(root: Array, rank: LocalRank, names: tuple[str, ...]) -> Matrices:
    covariance = _covariance(root, rank, names)
    with np.errstate(all="ignore"):
        sd = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(sd, sd)
    return Matrices(names, root.T @ root, covariance, correlation)


def _conditioning(p: Planned, root: Array, rank: LocalRank) -> Conditioning:
    values, weakest = _directions(p, root, rank)
    return Conditioning(
        rank.rank, rank.unknowns, values, _condition(weakest), weakest, describe_null(rank)
    )


def _covariance(root: Array, rank: LocalRank, names: Sequence[str]) -> Array:
    """Inverse information; inf where there is none, the rest as if that had a known value."""
    n = root.shape[1]
    length = np.linalg.norm(root, axis=0)
    lost = np.array([any(name in d for d in rank.null) for name in names], dtype=bool)
    zero = np.array([{name} in [set(d) for d in rank.null] for name in names], dtype=bool)
    index = np.flatnonzero(~zero)
    covariance = np.zeros((n, n))
    if index.size:
        _, s, vt = np.linalg.svd(root[:, index] / length[index])
        keep = index.size - (len(rank.null) - int(zero.sum()))
        half = vt[:keep].T / s[:keep] / length[index, None]
        covariance[np.ix_(index, index)] = half @ half.T
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    return covariance


def _directions(p: Planned, root: Array, rank: LocalRank) -> tuple[Array, tuple[Direction, ...]]:
    """Singular values of the parameters' scaled sensitivities, states eliminated; worst last."""
    states = p.is_state
    scaled = root * p.scale
    a, b = scaled[:, ~states], scaled[:, states]
    names = [n for n, s in zip(p.criterion.names, states, strict=True) if not s]
    if not names:
        return np.zeros(0), ()
    basis, lost_states = _range(b)
    _, s, vt = np.linalg.svd(a - basis @ (basis.T @ a))
    lost = min(len(rank.null) - lost_states, len(names))
    out = []
    for k in reversed(range(len(names))):
        v = vt[k] * np.sign(vt[k][np.argmax(np.abs(vt[k]))])
        is_lost = k >= len(names) - lost
        size = 0.01 / np.max(np.abs(v)) if is_lost else 1 / s[k]
        kept = np.abs(v) > 1e-3 * np.max(np.abs(v))
        moves = {n: float(size * w) for n, w, is_in in zip(names, v, kept, strict=True) if is_in}
        out.append(Direction(math.inf if is_lost else float(1 / s[k]), moves))
    return s, tuple(out)


def _range(b: Array) -> tuple[Array, int]:
    """Orthonormal basis of the columns' range (n, r), and how many columns it lacks."""
    length = np.linalg.norm(b, axis=0)
    u, s, _ = np.linalg.svd(b[:, length > 0] / length[length > 0], full_matrices=False)
    r = int(np.sum(s > np.sqrt(1e-11 * max(b.shape[1], 1))))
    return u[:, :r], b.shape[1] - r


def _condition(weakest: Sequence[Direction]) -> float:
    if not weakest or math.isinf(weakest[0].error):
        return math.inf if weakest else 1.0
    return weakest[0].error / weakest[-1].error


def _row(
    p: Planned,
    i: int,
    rank: LocalRank,
    matrices: Matrices,
    limits: tuple[float, float],
) -> Row:
    names, value, correlation = p.criterion.names, float(p.x[i]), matrices.correlation
    error = float(np.sqrt(matrices.covariance[i, i]))
    relative = error / float(p.size[i]) if p.size[i] else None
    partner, strength = None, None
    others = [j for j in np.flatnonzero(~p.is_state).tolist() if j != i]
    others = [j for j in others if np.isfinite(correlation[i, j])]
    if others:
        j = max(others, key=lambda k: abs(float(correlation[i, k])))
        partner, strength = names[j], float(correlation[i, j])
    verdict, note = _judged(names[i], rank, relative, (strength, partner), limits, p.noise)
    return Row(
        names[i],
        p.unit(i),
        value,
        bool(p.is_state[i]),
        error,
        relative,
        strength,
        partner,
        verdict,
        note,
        p.declared(i),
    )


def _judged(
    name: str,
    rank: LocalRank,
    relative: float | None,
    closest: tuple[float | None, str | None],
    limits: tuple[float, float],
    noise: Noise,
) -> tuple[Verdict, str]:
    """Verdict and why."""
    for direction in rank.null:
        if name in direction:
            others = [n for n in direction if n != name]
            if others:
                return UNDETERMINED, f"only in combination with {', '.join(others)}"
            return UNDETERMINED, "moves no output"
    close = ""
    if closest[0] is not None and abs(closest[0]) > limits[1]:
        close = f"correlated {closest[0]:+.4f} with {closest[1]}"
    if noise.is_absolute and relative is not None:
        # The standard error has the correlation in it: judged by that alone.
        if relative <= limits[0]:
            return WELL, close
        large = f"error {100 * relative:.3g} % of its size"
        return POOR, f"{large}; {close}" if close else large
    if close:
        return POOR, close
    if not noise.is_absolute:
        return UNJUDGED, "the noise is unknown"
    return UNJUDGED, "its value is zero, so no error is relative to it"
