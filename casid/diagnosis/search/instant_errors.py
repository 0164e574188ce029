"""Instants of changes: where whole records have them, and what they add to all other errors.

Instants are searched on a grid and no variables of the last fit. About it the residual is linear in
them, too: with T the sensitivities of the variables and P those of the instants,

    S = P'P - P'T (T'T)^-1 T'P,    cov(t) = s^2 S^-1,    dx/dt = -(T'T)^-1 T'P                (1)

(Seber and Wild 2003, section 5.9: conditioning on estimates), s^2 the mean square of the residual.
The size of a short change and its length make up for one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import TINY, Array
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.signature_columns import extended_columns
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.thresholds import JUMPS
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.clock_effects import KNOCK, at_instant
from casid.model.effects.effect import Effect
from casid.model.model import Model


def with_instant_errors(
    attempts: Attempts, adopted: Sequence[Adopted], fit: Fit | None
) -> tuple[Adopted, ...]:
    """The causes with the errors of their instants (see `Adopted.shifts`), where they have any."""
    own = _timed(adopted)
    if fit is None or fit.criterion.whiten is not None or not own:
        return tuple(adopted)
    found = attempts.attempt("the errors of instants", lambda: _errors(fit, own))
    if found is None:
        return tuple(adopted)
    by_cause = {id(a): (shifts, errors) for a, shifts, errors in found}
    none: tuple[tuple[dict[str, float], ...], tuple[float, ...]] = ((), ())
    pairs = [(a, *by_cause.get(id(a), none)) for a in adopted]
    return tuple(replace(a, shifts=shifts, instant_errors=errors) for a, shifts, errors in pairs)


def moved_in_time(model: Model, adopted: Sequence[Adopted], fit: Fit) -> list[Candidate] | None:
    """The causes with their instants where a Gauss-Newton step takes them; None of no distance.

    An instant was placed while other causes were missing and noise was another. It stays inside the
    records, and behind the one before it.
    """
    own = _timed(adopted)
    if not own:
        return None
    at = _linearised(fit, own)
    step = np.linalg.pinv(at.left.T @ at.left, hermitian=True) @ (at.left.T @ at.residual)
    if np.all(np.abs(step) < JUMPS.still * np.sqrt(np.maximum(np.diag(at.covariance), 0.0))):
        return None
    data = fit.criterion.data
    start, stop = min(float(d.t[0]) for d in data), max(float(d.t[-1]) for d in data)
    steps, causes = iter(step.tolist()), []
    timed = {id(a) for a in own}
    for a in adopted:
        effect = a.candidate.effect
        if id(a) in timed:
            times = [t + next(steps) for t, _ in _ends(effect)]
            if times != sorted(times) or not start < times[0] <= times[-1] < stop:
                return None
            effect = at_instant(effect, model, *times)
        causes.append(replace(a.candidate, effect=effect))
    return causes


def _timed(adopted: Sequence[Adopted]) -> list[Adopted]:
    """Those that set in at an instant; a knock is too short for a step that is later."""
    effects = [(a, a.candidate.effect) for a in adopted]
    return [a for a, effect in effects if effect.sets_in and effect.shape != KNOCK]


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """A fit about its instants: residual (M,), P less what the variables take of it, and (1)."""

    residual: Array
    left: Array  # (M, m)
    moved: Array  # (n, m) dx/dt
    covariance: Array  # (m, m) of the instants


def _linearised(fit: Fit, own: Sequence[Adopted]) -> _Linearised:
    """(1) of a fit with causes that set in at instants."""
    residual, tangent, instants = _columns(fit, own)
    free = fit.solution.is_free
    size = np.sqrt(np.maximum(np.einsum("ij,ij->j", tangent, tangent), TINY))
    q, r = np.linalg.qr(tangent[:, free] / size[free])
    along = q.T @ instants
    left = instants - q @ along
    freedom = max(len(residual) - int(free.sum()) - instants.shape[1], 1)
    covariance = residual @ residual / freedom * np.linalg.pinv(left.T @ left, hermitian=True)
    moved = np.zeros((len(fit.x), instants.shape[1]))
    moved[free] = -np.linalg.lstsq(r, along, rcond=1e-10)[0] / size[free][:, None]
    return _Linearised(residual, left, moved, covariance)


def _errors(
    fit: Fit, own: Sequence[Adopted]
) -> list[tuple[Adopted, tuple[dict[str, float], ...], tuple[float, ...]]]:
    """Of each cause: what moves with its instants, and their standard errors [s]."""
    at = _linearised(fit, own)
    values, vectors = np.linalg.eigh(at.covariance)
    shifts = at.moved @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    errors = np.sqrt(np.maximum(np.diag(at.covariance), 0.0))
    out, first = [], 0
    for a in own:
        place = slice(first, first + len(_ends(a.candidate.effect)))
        named = tuple(
            dict(zip(fit.criterion.names, column.tolist(), strict=True))
            for column in shifts[:, place].T
        )
        out.append((a, named, tuple(errors[place].tolist())))
        first = place.stop
    return out


def _ends(effect: Effect) -> list[tuple[float, float]]:
    """The instants of an effect [s], each with the sign of the step there."""
    both = ((effect.variant, 1.0), (effect.end, -1.0))
    return [(t, sign) for t, sign in both if t is not None]


def _columns(fit: Fit, own: Sequence[Adopted]) -> tuple[Array, Array, Array]:
    """Residual (M,), sensitivities of the variables (M, n) and of the instants (M, m).

    A step that is later by a sample has less of it: that of an instant is the difference of two,
    half a sample on either side.
    """
    model = fit.criterion.model
    half = 0.5 * min(d.Ts for d in fit.criterion.data)
    steps, factors = [], []
    for a in own:
        size = fit.values[a.candidate.names[0]]
        for t, sign in _ends(a.candidate.effect):
            steps += [at_instant(a.candidate.effect, model, t + side) for side in (half, -half)]
            factors.append(sign * size / (2 * half))
    columns = extended_columns(fit, steps)
    parts = [columns.of_record(columns.wide.start, k) for k in range(len(columns.wide.data))]
    residual, tangent, psi = (np.concatenate([part[i] for part in parts]) for i in range(3))
    return residual, tangent, (psi[:, 0::2] - psi[:, 1::2]) * np.array(factors)
