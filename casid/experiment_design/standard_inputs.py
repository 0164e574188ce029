"""The usual inputs, as large as the limits allow: step, doublet, chirp, PRBS, multisine, release.

They are what a designed input is compared with, and where its search begins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import log, sqrt

import numpy as np

from casid.arrays import Array
from casid.errors import DataError, nearest
from casid.experiment_design.prediction import Prediction
from casid.experiment_design.setup import Setup
from casid.experiment_design.thresholds import KEEPING


@dataclass(frozen=True, slots=True, eq=False)
class StandardInput:
    """One of the usual inputs under the limits.

    Attributes
    ----------
    u : (N, nu) samples of the designed inputs, SI.
    release : (nr,) chosen initial values, SI.
    score : smallest logarithm of information; see `information`.
    """

    kind: str
    description: str
    u: Array
    release: Array
    score: float = -np.inf


def drawn(
    setup: Setup, rng: np.random.Generator, kinds: Sequence[str] = ()
) -> tuple[str, str, Array, Array]:
    """One input of random kind and settings at full amplitude: kind, words, u, release.

    `kinds` are those that it is drawn from, default all.
    """
    release = np.array([rng.choice([0.0, 0.5, 1.0, -1.0, -0.5]) for _ in setup.released])
    low, high = _ends(setup)
    start = np.array([setup.start[n] for n in setup.released])
    chosen = start + np.where(release > 0, release * (high - start), -release * (low - start))
    if not setup.designed:
        shown = [
            f"{n} = {setup.nominal.model.shown(n, v):.3g} {setup.nominal.model.unit_of(n)}"
            for n, v in zip(setup.released, chosen.tolist(), strict=True)
        ]
        what = "released from " + ", ".join(shown)
        return what, what, np.zeros((setup.N, 0)), chosen
    kind = str(rng.choice(list(kinds or _SHAPES)))
    columns, words = [], ""
    for name in setup.designed:
        shape, words = _SHAPES[kind](setup, rng)
        bottom, top = setup.limits.inputs[name]
        rest = setup.rest[name]
        centre = rest if rng.random() < 0.5 else 0.5 * (bottom + top)
        u = centre + np.where(shape > 0, shape * (top - centre), shape * (centre - bottom))
        columns.append(_with_slew(u, rest, setup.limits.slew.get(name), setup.Ts))
    return kind, words, np.column_stack(columns), chosen


def _ends(setup: Setup) -> tuple[Array, Array]:
    ranges = np.array(list(setup.limits.release.values())).reshape(-1, 2)
    return ranges[:, 0], ranges[:, 1]


def _with_slew(u: Array, rest: float, slew: float | None, Ts: float) -> Array:
    """The input followed from rest at a limited rate."""
    if slew is None:
        return u
    out, last = np.empty(len(u)), rest
    for k, wanted in enumerate(u.tolist()):
        last = float(np.clip(wanted, last - slew * Ts, last + slew * Ts)) if k else rest
        out[k] = last
    return out


def _frequencies(setup: Setup, rng: np.random.Generator, n: int) -> Array:
    """n frequencies [Hz], evenly drawn in their logarithm, sorted, that an interval resolves."""
    lowest = 1 / (setup.N * setup.Ts)
    highest = max(0.5 / (setup.excitation.per * setup.Ts), 2 * lowest)
    return np.sort(np.exp(rng.uniform(log(lowest), log(highest), n)))


def _step(setup: Setup, rng: np.random.Generator) -> tuple[Array, str]:
    t = np.arange(setup.N) / setup.N
    at, sign = rng.uniform(0, 0.3), rng.choice([-1.0, 1.0])
    return np.where(t >= at, sign, 0.0), f"step after {at * setup.duration:.3g} s"


def _doublet(setup: Setup, rng: np.random.Generator) -> tuple[Array, str]:
    t = np.arange(setup.N) * setup.Ts
    half = 0.5 / _frequencies(setup, rng, 1)[0]
    sign = rng.choice([-1.0, 1.0])
    shape = np.where(t < half, sign, np.where(t < 2 * half, -sign, 0.0))
    return shape, f"doublet of {2 * half:.3g} s"


def _chirp(setup: Setup, rng: np.random.Generator) -> tuple[Array, str]:
    low, high = _frequencies(setup, rng, 2)
    if rng.random() < 0.5:
        low, high = high, low
    t = np.arange(setup.N) * setup.Ts
    ratio = log(high / low) / setup.duration
    phase = low * t if abs(ratio) < 1e-9 else low * np.expm1(ratio * t) / ratio
    return np.sin(2 * np.pi * phase), f"chirp from {low:.3g} to {high:.3g} Hz"


def _prbs(setup: Setup, rng: np.random.Generator) -> tuple[Array, str]:
    clock = 0.5 / _frequencies(setup, rng, 1)[0]
    held = max(1, round(clock / setup.Ts))
    bits = rng.choice([-1.0, 1.0], setup.N // held + 1)
    return np.repeat(bits, held)[: setup.N], f"PRBS with a clock of {held * setup.Ts:.3g} s"


def _multisine(setup: Setup, rng: np.random.Generator) -> tuple[Array, str]:
    low, high = _frequencies(setup, rng, 2)
    first = 1 / (setup.N * setup.Ts)
    harmonics = np.arange(max(1, round(low / first)), max(1, round(high / first)) + 1)
    harmonics = rng.choice(harmonics, min(len(harmonics), 30), replace=False)
    t = np.arange(setup.N) * setup.Ts
    phases = rng.uniform(0, 2 * np.pi, len(harmonics))
    u = np.cos(2 * np.pi * first * np.outer(t, harmonics) + phases).sum(axis=1)
    return u / np.max(np.abs(u)), f"multisine from {low:.3g} to {high:.3g} Hz"


_SHAPES: dict[str, Callable[[Setup, np.random.Generator], tuple[Array, str]]] = {
    "step": _step,
    "doublet": _doublet,
    "chirp": _chirp,
    "PRBS": _prbs,
    "multisine": _multisine,
}


def kinds_of(given: Sequence[str]) -> tuple[str, ...]:
    """The kinds of standard inputs that a caller names.

    Raises
    ------
    DataError
        For one that there is not.
    """
    for kind in given:
        if kind not in _SHAPES:
            raise DataError(
                f"{kind!r} is no kind of standard input; there are {', '.join(_SHAPES)}"
                f"{nearest(kind, _SHAPES, is_listed=True)}"
            )
    return tuple(given)


def shrunk(
    prediction: Prediction, u: Array, release: Array, *, finer: int = 1
) -> tuple[Array, Array] | None:
    """The input nearest to a wished one, on the line from the set-up's base, that keeps all limits.

    None where not even the base keeps them.
    """
    setup = prediction.setup
    base, start = setup.begun_at

    def at(share: float) -> tuple[Array, Array]:
        return base + share * (u - base), start + share * (release - start)

    largest = _energy_share(setup, base - setup.at_rest, u - base)
    if prediction.is_allowed(*at(largest), finer=finer):
        return at(largest)
    if not prediction.is_allowed(*at(0.0), finer=finer):
        return None
    allowed, forbidden = 0.0, largest
    for _ in range(KEEPING.halvings):
        middle = 0.5 * (allowed + forbidden)
        if prediction.is_allowed(*at(middle), finer=finer):
            allowed = middle
        else:
            forbidden = middle
    return at(allowed)


def _energy_share(setup: Setup, from_rest: Array, moved: Array) -> float:
    """The largest share, at most 1, of (N, nu) motions that the limits of energy allow."""
    share = 1.0
    for name, most in setup.limits.energy.items():
        k = setup.designed.index(name)
        begun, more = from_rest[:, k], moved[:, k]
        # |begun + share more|^2 Ts = most
        a, b = float(more @ more), float(begun @ more)
        c = float(begun @ begun) - most / setup.Ts
        if a + 2 * b + c > 0:
            share = min(share, max(0.0, (sqrt(max(b * b - a * c, 0.0)) - b) / a))
    return share
