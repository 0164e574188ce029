"""Instants of changes: where whole records have them, and what they add to all other errors.

Instants are searched on a grid and no variables of the last fit. About it the residual is linear in
them, too: with T the sensitivities of the variables and P those of the instants,

    L = P - T (T'T)^-1 T'P,    cov(t) = (L'L)^-1 L' Gamma L (L'L)^-1,
    dx/dt = -(T'T)^-1 T'P                                                                     (1)

(Seber and Wild 2003, section 5.9: conditioning on estimates), Gamma the covariance of the residual
by its autoregressions. The size of a short change and its length make up for one another.

(1) is the slope at one instant. What hardly acts for a while may set in at any time of it, so the
error of an instant is from the sum of squares S(t) as far as it matters, its size as large as it is
best there and all else linear:

    sd = max |t - t^| / z  over  S(t) - min S <= z^2 s^2 f,    z = 1.96                       (2)

(Bates and Watts 1988, section 6.1), s^2 the mean square of the residual and f the variance by (1)
in units of that by white noise: an autocorrelated residual determines it less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import TINY, Array
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.evidence.records.signal_sizes import window_of
from casid.diagnosis.evidence.scores.score_tests import regressed
from casid.diagnosis.evidence.scores.signature_columns import extended_columns, without
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.thresholds import JUMPS
from casid.errors import SolveError
from casid.estimation.noise.residual_autoregressions import residual_products
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
    step = at.inverse @ (at.left.T @ at.residual)
    if np.all(np.abs(step) < JUMPS.still * at.white):
        return None
    start, stop = window_of(fit)
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
    """The causes that set in at an instant, without knocks, too short for a later step."""
    effects = [(a, a.candidate.effect) for a in adopted]
    return [a for a, effect in effects if effect.sets_in and effect.shape != KNOCK]


@dataclass(frozen=True, slots=True, eq=False)
class _Linearised:
    """A fit about its instants: residual (M,), P less what the variables take of it, and (1)."""

    residual: Array
    left: Array  # (M, m)
    moved: Array  # (n, m) dx/dt
    inverse: Array  # (m, m) of L'L
    mean_square: float  # of the residual

    @property
    def white(self) -> Array:
        """Standard errors of the instants (m,) [s], were the residual white."""
        return np.asarray(np.sqrt(self.mean_square * np.maximum(np.diag(self.inverse), 0.0)))

    def covariance(self, fit: Fit) -> Array:
        """(1) of the instants, (m, m) [s^2]."""
        ny = len(fit.criterion.outputs)
        rows = np.cumsum([len(d.t) * ny for d in fit.criterion.data])
        left = [part.reshape(-1, ny, part.shape[1]) for part in np.split(self.left, rows[:-1])]
        return self.inverse @ residual_products(fit, fit.solution.is_free, left) @ self.inverse


def _linearised(fit: Fit, own: Sequence[Adopted]) -> _Linearised:
    """(1) of a fit with causes that set in at instants."""
    residual, tangent, instants = _columns(fit, own)
    free = fit.solution.is_free
    size = np.sqrt(np.maximum(np.einsum("ij,ij->j", tangent, tangent), TINY))
    q, r = np.linalg.qr(tangent[:, free] / size[free])
    along = q.T @ instants
    left = instants - q @ along
    freedom = max(len(residual) - int(free.sum()) - instants.shape[1], 1)
    inverse = np.linalg.pinv(left.T @ left, hermitian=True)
    moved = np.zeros((len(fit.x), instants.shape[1]))
    moved[free] = -np.linalg.lstsq(r, along, rcond=1e-10)[0] / size[free][:, None]
    mean_square = float(residual @ residual) / freedom
    return _Linearised(residual, left, moved, inverse, mean_square)


def _errors(
    fit: Fit, own: Sequence[Adopted]
) -> list[tuple[Adopted, tuple[dict[str, float], ...], tuple[float, ...]]]:
    """For each cause, what moves with its instants, and their standard errors [s]."""
    at, instants = _linearised(fit, own), _instants(fit, own)
    covariance = at.covariance(fit)
    local = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    memory = (local / np.maximum(at.white, TINY)) ** 2
    errors = np.array(
        [_error(fit, at, i, instant, memory[i]) for i, instant in enumerate(instants)]
    )
    wider = errors / np.maximum(local, TINY)
    values, vectors = np.linalg.eigh(covariance * np.outer(wider, wider))
    shifts = at.moved @ (vectors * np.sqrt(np.maximum(values, 0.0)))
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


@dataclass(frozen=True, slots=True, eq=False)
class _Instant:
    """One end of a cause [s], the sign of the step there, and the times it lies between."""

    cause: Adopted
    time: float
    sign: float
    between: tuple[float, float]

    def step(self, model: Model, later: float) -> Effect:
        """The cause as a lasting change that sets in `later` [s] after the instant."""
        return at_instant(self.cause.candidate.effect, model, self.time + later)

    def size(self, fit: Fit) -> float:
        """Size of the step, in the unit of the cause."""
        return self.sign * fit.values[self.cause.candidate.names[0]]


def _instants(fit: Fit, own: Sequence[Adopted]) -> list[_Instant]:
    """The ends of the causes, one cause after the other."""
    start, stop = window_of(fit)
    out = []
    for a in own:
        ends = _ends(a.candidate.effect)
        times = [start, *(t for t, _ in ends), stop]
        out += [_Instant(a, t, sign, (times[j], times[j + 2])) for j, (t, sign) in enumerate(ends)]
    return out


def _ends(effect: Effect) -> list[tuple[float, float]]:
    """The instants of an effect [s], each with the sign of the step there."""
    both = ((effect.variant, 1.0), (effect.end, -1.0))
    return [(t, sign) for t, sign in both if t is not None]


def _error(fit: Fit, at: _Linearised, i: int, instant: _Instant, memory: float) -> float:
    """Standard error of one instant by (2) [s]; `memory` is f."""
    local = float(at.white[i] * np.sqrt(memory))
    farthest = max(abs(end - instant.time) for end in instant.between)
    if local <= 0.0 or farthest <= 0.0:
        return local
    most = JUMPS.z**2 * at.mean_square * memory
    away = np.geomspace(min(JUMPS.z * local, 0.01 * farthest), farthest, JUMPS.distances)
    tried = np.concatenate([-away[::-1], [0.0], away])
    moments, (first, last) = instant.time + tried, instant.between
    tried = tried[(first < moments) & (moments < last)]
    rises = _rises(fit, at, i, instant, tried)
    low, high = _bracketed(tried, rises, most)
    finer = [np.linspace(end[0], end[1], JUMPS.distances) for end in (low, high)]
    tried = np.concatenate([tried, *finer])
    rises = np.append(rises, _rises(fit, at, i, instant, np.concatenate(finer)))
    return float(np.abs(tried[rises - rises.min() <= most]).max()) / JUMPS.z


def _bracketed(distances: Array, rises: Array, most: float) -> tuple[Array, Array]:
    """The outermost distances within (2), each with the next one outside where there is one."""
    inside = np.flatnonzero(rises - rises.min() <= most)
    first, last = int(inside[0]), int(inside[-1])
    return (
        distances[[max(first - 1, 0), first]],
        distances[[last, min(last + 1, len(distances) - 1)]],
    )


def _rises(fit: Fit, at: _Linearised, i: int, instant: _Instant, distances: Array) -> Array:
    """S at distances from an instant [s], less S there."""
    model, ends = fit.criterion.model, _instants(fit, [instant.cause])
    steps = [instant.step(model, d) for d in (0.0, *distances.tolist())]
    whole = [end.step(model, 0.0) for end in ends]
    e, psi = regressed(fit, instant.cause.candidate.names[0], [*steps, *whole])
    others = np.linalg.qr(np.delete(at.left, i, axis=1))[0]
    e, psi = (c - others @ (others.T @ c) for c in (e, psi))
    moved, own = psi[:, : len(steps)], psi[:, len(steps) :] @ [end.sign for end in ends]
    moved = own[:, None] + instant.sign * (moved - moved[:, :1])
    explained = (moved.T @ e) ** 2 / np.maximum(np.einsum("ij,ij->j", moved, moved), TINY)
    if not np.isfinite(explained[0]):
        raise SolveError("the change has no finite effect at its instant")
    return np.asarray(np.nan_to_num(explained[0] - explained[1:], nan=np.inf))


def _columns(fit: Fit, own: Sequence[Adopted]) -> tuple[Array, Array, Array]:
    """Residual (M,), sensitivities of the variables (M, n) and of the instants (M, m).

    A step that is later by a sample has less of it: that of an instant is the difference of two,
    half a sample on either side; that of a gain is simulated without the gain, which multiplies it.
    """
    model, instants = fit.criterion.model, _instants(fit, own)
    half = 0.5 * min(d.Ts for d in fit.criterion.data)
    steps = [instant.step(model, side) for instant in instants for side in (half, -half)]
    columns = extended_columns(fit, steps)
    wide = columns.wide
    parts = [columns.of_record(wide.start, k) for k in range(len(wide.data))]
    residual, tangent, psi = (np.concatenate([part[i] for part in parts]) for i in range(3))
    gains = [a.candidate.names[0] for a in own if a.candidate.effect.is_new_gain]
    if gains:
        x = without(wide, wide.start, gains)
        psi = np.concatenate([columns.of_record(x, k)[2] for k in range(len(wide.data))])
    sizes = np.array([instant.size(fit) for instant in instants])
    return residual, tangent, (psi[:, 0::2] - psi[:, 1::2]) * (sizes / (2 * half))
