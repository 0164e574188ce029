"""Periods of a force in a position: what a whitened residual shows of cogging.

For every number of periods in the range that a position covers, the responses to cos and sin of
that phase, off the baseline's tangent, explain a sum of squares g of the whitened residual, which
is chi^2(2) where nothing is periodic, in units of the residual's level: the median of all g over
that of chi^2(2). The largest of K has p = 1 - (1 - exp(-g/2))^K, an upper bound by independence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.residual.linearised_path import Linearised
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.thresholds import COGGING
from casid.estimation.simulation.minimization import Fit
from casid.model.effects.balances.cogging_effects import cogging
from casid.model.effects.effect import Effect, Motion, Sizes
from casid.model.effects.places.place import Place
from casid.model.effects.places.places import places_of
from casid.model.units import same_dimension


@dataclass(frozen=True, slots=True, eq=False)
class CoggingCandidate:
    """Cogging in one place, with the amplitudes that its score gives."""

    effect: Effect
    starts: dict[str, float]  # by the effect's own parameter names
    p_value: float  # over all periods searched
    statistic: float  # Lagrange multiplier, chi^2(2) at a period given beforehand


def cogging_candidates(
    at: Weighted, sizes: Sizes, *, alpha: float = 0.05
) -> list[CoggingCandidate]:
    """The most significant period of every place whose motion covers several.

    An angle is searched where it turns round at least once: what swings meets no tooth twice.
    """
    fit = at.unbiased or at.fit
    found = []
    for place in places_of(fit.criterion.model):
        if place.position is None or not place.is_mechanical or place.velocity is None:
            continue
        motion = sizes.motion_of(place.position)
        pitches = pitches_of(place, motion, sizes)
        if len(pitches) < COGGING.fewest:
            continue
        best = _best(fit, sizes, place, pitches)
        if best is not None and best.p_value < alpha:
            found.append(best)
    return sorted(found, key=lambda c: -c.statistic)


def pitches_of(place: Place, motion: Motion, sizes: Sizes) -> Array:
    """Periods that the motion covers several times, and that the samples resolve."""
    span = motion.high - motion.low
    is_angle = same_dimension(place.position_unit, "rad")
    if not np.isfinite(span) or span <= 0.0 or (is_angle and span < 2 * np.pi):
        return np.empty(0)
    step = sizes.motion_of(place.velocity).rms * (sizes.Ts or 0.0)
    resolved = span / max(COGGING.samples * step, span * 1e-6)  # periods in the range
    turns = span / (2 * np.pi)
    if is_angle and resolved > turns * COGGING.fewest:
        # Teeth are counted in a turn: whole numbers of them, however many turns there are.
        teeth = np.arange(1, int(min(resolved / turns, COGGING.most)) + 1)
        return np.asarray(2 * np.pi / teeth[teeth * turns >= COGGING.fewest])
    count = np.arange(COGGING.fewest, min(resolved, COGGING.most), 0.5)
    return np.asarray(span / count)


def _best(fit: Fit, sizes: Sizes, place: Place, pitches: Array) -> CoggingCandidate | None:
    """The period that explains most, with its p-value over all of them."""
    motion = sizes.motion_of(place.position)
    middle, span = 0.5 * (motion.low + motion.high), motion.high - motion.low
    responses = _Responses(fit, sizes, place, middle)
    gains, steps = responses.gains(pitches, responses.e)
    i = int(np.argmax(gains))
    effect = cogging(fit.criterion.model, place, float(pitches[i]), span, middle)
    if effect is None or gains[i] <= 2 * np.log(len(pitches)):  # the largest by chance
        return None
    # What is periodic leaks into all other periods: their level is that of what it leaves.
    left = responses.e - responses.off_the_tangent(pitches[i : i + 1]) @ steps[i]
    others = np.delete(responses.gains(pitches, left)[0], i)
    level = max(1.0, float(np.median(others)) / (2 * np.log(2.0)))
    chance = min(float(np.exp(-0.5 * gains[i] / level)), 1 - 1e-12)
    p = max(-np.expm1(len(pitches) * np.log1p(-chance)), TINY)
    # A full step may carry the motion into the next tooth, from where no fit comes back.
    begin = COGGING.start * steps[i]
    starts = {q.name: float(s) for q, s in zip(effect.parameters[:2], begin, strict=True)}
    return CoggingCandidate(effect, starts, float(p), float(gains[i]))


class _Responses:
    """Whitened responses of the outputs to forces along one place, records stacked."""

    def __init__(self, fit: Fit, sizes: Sizes, place: Place, middle: float) -> None:
        self.criterion, self.place = fit.criterion, place
        self.linearised = Linearised(fit.criterion, fit.x)
        data = fit.criterion.data
        self.runs = [fit.criterion.simulated(fit.x, k) for k in range(len(data))]
        self.paths = [
            self.linearised.path(k, run.x[: d.N], d)
            for k, (run, d) in enumerate(zip(self.runs, data, strict=True))
        ]
        ends = np.cumsum([d.N for d in data])[:-1]
        assert sizes.course is not None
        self.moves = np.split(sizes.course(place.position) - middle, ends)
        self.shares = {
            row: np.split(sizes.course(factor), ends)
            for row, factor in place.shares
            if row in fit.criterion.model.balances
        }
        own = [
            np.concatenate([run.residual[:, :, None], run.jacobian], axis=2) for run in self.runs
        ]
        whole = np.concatenate([self._white(part, k) for k, part in enumerate(own)])
        tangent = whole[:, 1:] / np.maximum(np.linalg.norm(whole[:, 1:], axis=0), TINY)
        u, s, _ = np.linalg.svd(tangent, full_matrices=False)
        self.basis = u[:, s > 1e-8 * s[0]]
        self.e = whole[:, 0] - self.basis @ (self.basis.T @ whole[:, 0])
        self._kept: dict[bytes, Array] = {}  # pitches -> what `off_the_tangent` gave

    def gains(self, pitches: Array, e: Array) -> tuple[Array, Array]:
        """Sum of squares of `e` (M,) that each pitch explains (K,), and its amplitudes (K, 2)."""
        gains, steps = np.empty(len(pitches)), np.empty((len(pitches), 2))
        for first in range(0, len(pitches), COGGING.at_once):
            some = pitches[first : first + COGGING.at_once]
            rest = self._kept.get(some.tobytes())
            if rest is None:
                rest = self.off_the_tangent(some)
                if (len(self._kept) + 1) * rest.size <= COGGING.kept:
                    self._kept[some.tobytes()] = rest
            for j in range(rest.shape[1] // 2):
                pair = rest[:, 2 * j : 2 * j + 2]
                step, *_ = np.linalg.lstsq(pair, e, rcond=1e-10)
                gains[first + j], steps[first + j] = float(np.sum((pair @ step) ** 2)), step
        return gains, steps

    def off_the_tangent(self, pitches: Array) -> Array:
        """Responses (M, 2 n) to the cosine and the sine of each pitch, less the baseline's part."""
        columns = []
        balances = list(self.criterion.model.balances)
        for k, (run, d) in enumerate(zip(self.runs, self.criterion.data, strict=True)):
            turn = 2 * np.pi * self.moves[k][:, None] / pitches
            force = np.stack([np.cos(turn), np.sin(turn)], axis=2).reshape(d.N, -1)
            out = np.zeros((d.N, len(self.criterion.outputs), force.shape[1]))
            for row, factors in self.shares.items():
                out += self.paths[k].respond(balances.index(row), factors[k][:, None] * force)
            out = self.linearised.through_sensors(out, run.y, k) * d.used[:, :, None]
            columns.append(self._white(out, k))
        psi = np.concatenate(columns)
        return np.asarray(psi - self.basis @ (self.basis.T @ psi))

    def _white(self, columns: Array, k: int) -> Array:
        """Columns (N, ny, m) of one record, weighted and whitened, (N ny, m)."""
        assert self.criterion.whiten is not None
        white = self.criterion.whiten(columns * self.criterion.weights[None, :, None], k)
        return np.asarray(white).reshape(-1, columns.shape[2])
