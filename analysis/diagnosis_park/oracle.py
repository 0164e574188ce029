"""The oracle: who knows the noise, the catalogue and the prior, and takes the maximum posterior.

Oracle-2 has nominal parameters and initial states free, oracle-1 knows the parameters. Both see the
record that the diagnosis sees, its fitted part. Signatures are whitened with the true noise and
projected off the nominal tangent; the best few candidates are then refitted by Gauss and Newton's
method in the true simulator. The size of a candidate has a prior even in its logarithm, instants
and frequencies an even one on the grid that they were drawn from (Laplace's approximation)

    log p(j | y) = const - J_j / 2 - n_j / 2 log max(J_0 - J_j, 1) - log(number of its grid).    (1)

For two candidates of free sign with signatures at cosine c and energy lambda

    P(right) = Phi(a) Phi(b) + Phi(-a) Phi(-b),  a = sqrt(lambda (1 - c) / 2),                   (2)
    b = sqrt(lambda (1 + c) / 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from analysis.diagnosis_park.bench import (
    Bench,
    Local,
    Motion,
    Variant,
    Whitener,
    projected,
    sensitivities,
)
from tests.support.park.effects import Effect

if TYPE_CHECKING:
    from tests.support.park.simulator import Array

REFINED = 6
"""Candidates that are refitted."""

SAME = 0.999
"""Cosine beyond which two effects are one thing in a model."""

DAMPING = (1.0, 0.5, 0.15)
"""Shares of a step that are tried."""

IN_SET = 3.0
"""Log posterior odds within which a rival belongs to the reported set (six units of BIC)."""


def probability_right(energy: float, cosine: float) -> float:
    """(2)."""
    a, b = np.sqrt(energy * (1 - cosine) / 2), np.sqrt(energy * (1 + cosine) / 2)
    return float(norm.cdf(a) * norm.cdf(b) + norm.cdf(-a) * norm.cdf(-b))


def posterior(
    residual: Array,
    tangent: Array,
    signatures: Sequence[Array],
    grids: Sequence[int],
    signs: Sequence[bool],
) -> tuple[Array, list[Array]]:
    """Log posterior (up to a constant) of each candidate and the size that it takes.

    Parameters
    ----------
    residual : (n,) whitened, of the nominal model.
    tangent : (n, m) whitened derivatives with respect to what is free; m may be zero.
    signatures : (n, n_j) whitened derivatives with respect to the sizes of each candidate.
    grids : instants or frequencies that each candidate's prior allows.
    signs : whether the size can only be positive.
    """
    e = projected(residual[:, None], tangent)[:, 0] if tangent.shape[1] else residual
    scores: list[float] = []
    sizes: list[Array] = []
    for rows, count, positive in zip(signatures, grids, signs, strict=True):
        psi = projected(rows, tangent) if tangent.shape[1] else rows
        size: Array = np.asarray(np.linalg.lstsq(psi, e, rcond=1e-10)[0], dtype=np.float64)
        if positive and rows.shape[1] == 1 and size[0] <= 0:
            size = np.zeros(1)
        fall = float(e @ e - np.sum((e - psi @ size) ** 2))
        scores.append(score_of(fall, rows.shape[1], count))
        sizes.append(size)
    return np.array(scores), sizes


def score_of(fall: float, n: int, count: int) -> float:
    """(1) from the fall of J."""
    return 0.5 * fall - 0.5 * n * float(np.log(max(fall, 1.0))) - float(np.log(count))


def minimised(
    bench: Bench,
    white: Whitener,
    y: Array,
    starts: Sequence[Variant],
    *,
    iterations: int = 3,
    fixed: bool = False,
) -> list[tuple[Variant, float]]:
    """Each variant with J after steps of Gauss and Newton; with `fixed` the parameters stay."""

    def misfit(moved: Sequence[Motion]) -> Array:
        J = np.sum(white(y[:, :, None] - np.stack([m.y for m in moved], axis=-1)) ** 2, axis=0)
        return np.where(np.isfinite(J), J, np.inf)

    at = bench.motions(starts)
    best = misfit(at)
    active = [i for i, J in enumerate(best) if np.isfinite(J)]
    for _ in range(iterations):
        trials: list[Variant] = []
        for i in active:
            moved = np.nan_to_num(sensitivities(bench, white, at[i]))
            if fixed:
                moved[:, : len(bench.theta)] = 0.0
            e = white(y[:, :, None] - at[i].y[:, :, None])[:, 0]
            scale = np.maximum(np.linalg.norm(moved, axis=0), 1e-12)
            step = np.linalg.lstsq(moved / scale, e, rcond=1e-9)[0] / scale
            trials += [_stepped(at[i].variant, f * step) for f in DAMPING]
        if not trials:
            break
        tried = bench.motions(trials)
        J = misfit(tried).reshape(len(active), len(DAMPING))
        still = []
        for row, i in enumerate(active):
            k = int(np.argmin(J[row]))
            gained = float(best[i] - J[row, k])
            if gained > 0:
                at[i], best[i] = tried[row * len(DAMPING) + k], J[row, k]
            if gained > 1e-2 * (1 + 1e-3 * best[i]):
                still.append(i)
        active = still
    return [(m.variant, float(J)) for m, J in zip(at, best, strict=True)]


def _stepped(at: Variant, step: Array) -> Variant:
    m = len(at.phi)
    phi = np.clip(at.phi + step[:m], -0.9 if m else 0.0, None)
    size = at.size + step[m:]
    if at.effect is not None:
        size = np.clip(size, 0.0 if at.effect.positive else -at.effect.limit, at.effect.limit)
    return replace(at, phi=phi, size=size)


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What an oracle says: the best candidate, the set within reach, log posteriors by effect."""

    effect: Effect
    reported: list[Effect]
    cosine: float  # the largest of the hidden effect to one that counts as another
    same: list[tuple[str, str]]  # names that are the hidden effect in this model


@dataclass(frozen=True, slots=True, eq=False)
class Signatures:
    """Whitened signatures of every effect at every point of its grid, and the nominal tangent."""

    keys: list[tuple[Effect, float]]
    rows: list[Array]  # (n, n_j) each
    tangent: Array
    y: Array  # (n, ny) of the nominal model


def signatures_of(bench: Bench, white: Whitener, catalogue: Sequence[Effect]) -> Signatures:
    """Those of a catalogue about the nominal motion of a record."""
    motion = bench.motions([bench.null()])[0]
    local = Local(bench, motion)
    base, changes = local.step(), []
    swinging = [bench.null()]
    ordered = sorted(catalogue, key=lambda e: ("input", "mode", "sensor").count(e.stage))
    keys = [(e, h) for e in ordered for h in e.grid]
    for e, h in keys:
        small = np.full(e.n, 1.0 if e.fixed else 1e-4 * e.limit)
        if e.stage in ("force", "parameter", "input"):
            changes += local.of_sizes(e, np.zeros(e.n), h, small, base)
        elif e.stage == "mode":
            swinging.append(Variant(np.zeros(bench.n_phi), e, small, h))
    moved = white(local.responses(changes, start=False))
    swung = bench.outputs(swinging) if len(swinging) > 1 else None
    out, at, mode = [], 0, 0
    for e, _ in keys:
        if e.stage in ("force", "parameter", "input"):
            out.append(moved[:, at : at + e.n])
            at += e.n
            continue
        width = 1.0 if e.fixed else 1e-4 * e.limit
        if e.stage == "mode" and swung is not None:
            mode += 1
            y = swung[:, :, mode] - swung[:, :, 0]
        else:
            size = np.full((1, 1), width)
            y = e.law(size, local.fine)[:: 2 * bench.system.substeps, :, 0] - local.y
        out.append(white(y[:, :, None] / width))
    tangent = sensitivities(bench, white, motion)
    return Signatures(keys, [np.nan_to_num(rows) for rows in out], tangent, motion.y)


def judged(
    bench: Bench,
    white: Whitener,
    y: Array,
    found: Signatures,
    truth: tuple[Effect, float, Any] | None,
    *,
    knows_parameters: bool = False,
) -> Verdict:
    """The oracle's name for a record (n, ny)."""
    keys, signatures = found.keys, found.rows
    tangent = found.tangent[:, len(bench.theta) :] if knows_parameters else found.tangent
    e = white((y - found.y)[:, :, None])[:, 0]
    counts = [len(effect.grid) for effect, _ in keys]
    signs = [effect.positive for effect, _ in keys]
    scores, sizes = posterior(e, tangent, signatures, counts, signs)
    best: dict[int, int] = {}
    for i in np.argsort(-scores):
        best.setdefault(id(keys[i][0]), int(i))
    leading = sorted(best.values(), key=lambda i: -scores[i])[:REFINED]
    starts = [bench.null()]
    for i in leading:
        effect, hyper = keys[i]
        limit = effect.limit
        clipped = np.clip(sizes[i], 0.0 if effect.positive else -limit, limit)
        starts.append(Variant(np.zeros(bench.n_phi), effect, clipped, hyper))
    fits = minimised(bench, white, y, starts, fixed=knows_parameters)
    J0 = fits[0][1]
    final = [
        score_of(J0 - J, keys[i][0].n, len(keys[i][0].grid))
        for i, (_, J) in zip(leading, fits[1:], strict=True)
    ]
    order = np.argsort(-np.array(final))
    top = float(final[order[0]])
    reported = [keys[leading[i]][0] for i in order if final[i] > top - IN_SET]
    same, cosine = _relatives(keys, signatures, tangent, truth)
    return Verdict(reported[0], reported, cosine, same)


def _relatives(
    keys: list[tuple[Effect, float]],
    signatures: list[Array],
    tangent: Array,
    truth: tuple[Effect, float, Any] | None,
) -> tuple[list[tuple[str, str]], float]:
    """Names that are one thing with the hidden effect, and the largest cosine to another."""
    if truth is None:
        return [], 0.0
    effect, hyper, size = truth
    mine = [i for i, (e, h) in enumerate(keys) if e is effect and h == hyper]
    if not mine:
        return [], 0.0
    target = projected(signatures[mine[0]] @ np.asarray(size)[:, None], tangent)[:, 0]
    norm_of = float(np.linalg.norm(target))
    same, cosine = list(effect.names), 0.0
    own = set(effect.names)
    for (other, _), rows in zip(keys, signatures, strict=True):
        if other is effect or own & set(other.names) or norm_of == 0.0:
            continue
        span = projected(rows, tangent)
        kept = np.linalg.norm(span, axis=0)
        if not (kept > 1e-9 * np.linalg.norm(rows, axis=0)).all():
            continue
        q = np.linalg.qr(span / np.maximum(kept, 1e-300))[0]
        c = float(np.linalg.norm(q.T @ target) / norm_of)
        if c > SAME:
            same += other.names
        else:
            cosine = max(cosine, c)
    return same, cosine
