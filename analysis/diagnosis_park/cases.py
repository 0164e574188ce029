"""Records of the park: drawn by system, seed and number, so that each can be made again alone.

What is hidden is drawn from a stated prior: the kind evenly among those that the system can show,
then the place, the instant or frequency from a grid, the size by the energy that it is to show.
lambda is the energy of the whitened misfit that no nominal parameter and no initial state can take
away, in the fitted part of the record.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from analysis.diagnosis_park.bench import (
    SKIP,
    Bench,
    Variant,
    Whitener,
    projected,
    scales_of,
    sensitivities,
    whitener_of,
)
from analysis.diagnosis_park.oracle import minimised
from tests.support.park.effects import (
    SAMPLES,
    Effect,
    catalogue_of,
    sensed,
    spoilt,
    unlisted_of,
)
from tests.support.park.simulator import Acting, Array, Feedback, System, simulate, staged

FITTED = 0.7
"""Share of a record that a diagnosis fits by default."""

LEAD = 60
"""Samples before the record, which lags and delays remember."""

ENERGIES = {"single": (100.0, 3000.0), "large": (1e5, 1e7), "unlisted": (100.0, 3000.0)}
"""Ranges of lambda, even in the logarithm."""

CYCLE = ("single", "null", "single", "single", "unlisted", "single", "null", "large")
"""Parts, by turns."""


@dataclass(frozen=True, slots=True)
class Case:
    """One record to be made."""

    system: str
    seed: int
    number: int

    @property
    def part(self) -> str:
        return CYCLE[self.number % len(CYCLE)]

    def generator(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, zlib.crc32(self.system.encode()), self.number])


@dataclass(slots=True, eq=False)
class Hidden:
    """A record, measured, and what is true about it."""

    case: Case
    bench: Bench  # with the recorded inputs, of the fitted part
    y: Array  # (N, ny) recorded
    channels: dict[str, Array]  # all recorded channels
    units: dict[str, str]
    catalogue: list[Effect]
    white: Whitener
    effect: Effect | None = None
    kind: str = "none"
    where: str = ""
    size: Array = field(default_factory=lambda: np.zeros(0))
    hyper: float = 0.0
    energy: float = 0.0
    names: list[tuple[str, str]] = field(default_factory=list)  # what counts as right


def make(case: Case, system: System) -> Hidden:
    """Draw and simulate a case."""
    rng = case.generator()
    drawn = _drawn(system, rng)
    still = _record_of(system, drawn, rng, None)  # nothing hidden, no noise: to size effects on
    bench = still.bench
    scales = scales_of(bench)
    catalogue = catalogue_of(system, scales)
    white = whitener_of(bench)
    hidden = Hidden(case, bench, still.y, {}, {}, catalogue, white)
    spoil, energy = "", 0.0
    if case.part != "null":
        low, high = np.log(ENERGIES[case.part])
        energy = float(np.exp(rng.uniform(low, high)))
        pool = unlisted_of(system, scales) if case.part == "unlisted" else catalogue
        spoil = _drawn_effect(hidden, pool, energy, rng)
    truth = (
        None
        if hidden.effect is None
        else Variant(np.zeros(bench.n_phi), hidden.effect, hidden.size, hidden.hyper)
    )
    made = _record_of(system, drawn, rng, truth, noisy=True)
    hidden.bench, hidden.y = made.bench, made.y
    hidden.channels, hidden.units = made.channels, made.units
    hidden.catalogue = catalogue
    if truth is not None:
        hidden.energy = _energy(replace_inputs(bench, made.bench), white, truth)
    if spoil:
        _spoil(hidden, spoil, energy, rng)
    hidden.white = whitener_of(hidden.bench) if system.law else white
    return hidden


def replace_inputs(bench: Bench, other: Bench) -> Bench:
    """A bench with the recorded inputs and start of another."""
    return replace(bench, u=other.u, x0=other.x0)


@dataclass(slots=True, eq=False)
class _Made:
    bench: Bench
    y: Array
    channels: dict[str, Array]
    units: dict[str, str]


def _drawn(system: System, rng: np.random.Generator) -> dict[str, Any]:
    """Parameters, inputs and start of a case, LEAD samples longer than the record."""
    spread = float(system.more.get("spread", 0.1))
    theta = {k: v * float(np.exp(spread * rng.uniform(-1, 1))) for k, v in system.theta.items()}
    M = system.N + LEAD
    u = np.stack([i.signal(rng, M, system.Ts) for i in system.inputs])
    beside = {c.name: c.signal(rng, M, system.Ts) for c in system.beside}
    x0 = np.array([m + sd * rng.standard_normal() for m, sd in system.start.values()])
    return {"theta": theta, "u": u, "beside": beside, "x0": x0}


def _record_of(
    system: System,
    drawn: Mapping[str, Any],
    rng: np.random.Generator,
    truth: Variant | None,
    *,
    noisy: bool = False,
) -> _Made:
    """The record of a drawn case with an effect in it."""
    M, sub, lead = system.N + LEAD, system.substeps, LEAD * system.Ts
    theta, u = drawn["theta"], np.array(drawn["u"])
    z = {c: (v - v[LEAD:].mean()) / v[LEAD:].std() for c, v in drawn["beside"].items()}
    full = Bench(system, theta, drawn["x0"], u, z, M)
    noise = np.zeros((M, len(system.outputs)))
    U = full.stages()
    if noisy:
        noise = rng.standard_normal(noise.shape) * [o.sd for o in system.outputs]
        for i, d in enumerate(system.disturbances):
            U[:, :, len(system.inputs) + i, 0] = staged(d.draw(rng, M, system.Ts), "foh", sub)
    acting = []
    if truth is not None and truth.effect is not None:
        acting = [Acting(truth.effect, slice(0, 1), truth.size[:, None], np.array([truth.hyper]))]
        if truth.effect.stage == "input":
            j = [i.name for i in system.inputs].index(truth.effect.channel)
            U[:, :, j] = truth.effect.law(acting[0].size, u[j])
    feedback = Feedback(system.law, noise, u[0], _actuator(system, acting)) if system.law else None
    x0, p = full.columns([full.null()])
    staged_z = {c: staged(v, "foh", sub) for c, v in z.items()}
    clock = (-lead, system.N * system.Ts)
    Y, X = simulate(system, x0, p, U, acting, beside=staged_z, feedback=feedback, clock=clock)
    y = sensed(Y, acting)[:: 2 * sub, :, 0] + noise
    if feedback is not None:
        u[0] = feedback.commanded
    sd = np.array([[i.sd] for i in system.inputs]) * noisy
    u = (u + sd * rng.standard_normal(u.shape))[:, LEAD:]
    beside = {c: v[LEAD:] for c, v in z.items()}
    n = round(FITTED * system.N)
    bench = Bench(system, theta, X[LEAD, :, 0], u, beside, n)
    channels = {i.name: row for i, row in zip(system.inputs, u, strict=True)}
    channels |= {o.name: y[LEAD:, j] for j, o in enumerate(system.outputs)}
    channels |= {c: v[LEAD:] for c, v in drawn["beside"].items()}
    units = {c.name: c.unit for c in (*system.inputs, *system.beside)}
    units |= {o.name: o.unit for o in system.outputs}
    return _Made(bench, y[LEAD:], channels, units)


def _actuator(system: System, acting: Sequence[Acting]) -> Callable[[Array], Array]:
    """What acts of a command: the command, or what a hidden effect makes of it."""
    for a in acting:
        if a.effect.stage == "input" and a.effect.channel == system.inputs[0].name:
            return partial(a.effect.law, a.size)
    return lambda u: staged(u, system.inputs[0].hold, system.substeps)[:, :, None]


# -- how large ------------------------------------------------------------------------------------


def _drawn_effect(
    hidden: Hidden, pool: list[Effect], energy: float, rng: np.random.Generator
) -> str:
    """Choose an effect that can show the energy, or the most of it that any can.

    Returns
    -------
    the kind of an effect that spoils samples, or "".
    """
    while energy > ENERGIES["single"][0]:
        spoil = _chosen(hidden, pool, energy, rng)
        if spoil is not None:
            return spoil
        energy /= 3.0
    raise RuntimeError(f"{hidden.bench.system.name}: no effect shows in this record")


def _chosen(
    hidden: Hidden, pool: list[Effect], energy: float, rng: np.random.Generator
) -> str | None:
    """One of forty draws of an effect that can show the energy; None where none can."""
    system = hidden.bench.system
    kinds = sorted({e.kind for e in pool})
    if hidden.case.part == "single":
        kinds += [k for k in SAMPLES if k not in system.more.get("without", ())]
    for _ in range(40):
        kind = str(rng.choice(kinds))
        if kind in SAMPLES:
            hidden.kind = kind
            hidden.where = str(rng.choice([o.name for o in system.outputs]))
            hidden.names = [(kind, hidden.where)]
            return kind
        among = [e for e in pool if e.kind == kind]
        effect = among[int(rng.integers(len(among)))]
        hyper = float(rng.choice(effect.grid))
        size = size_for(hidden, effect, hyper, energy, rng)
        if size is not None:
            hidden.effect, hidden.size, hidden.hyper = effect, size, hyper
            hidden.kind, hidden.where, hidden.names = kind, effect.where, effect.names
            return ""
    return None


def size_for(
    hidden: Hidden, effect: Effect, hyper: float, energy: float, rng: np.random.Generator
) -> Array | None:
    """The size with which an effect shows an energy, in a direction drawn; None where it cannot."""
    direction = rng.standard_normal(effect.n)
    direction = direction / np.linalg.norm(direction)
    if effect.n == 1:
        direction = np.ones(1) if effect.positive else np.sign(direction)
    bench, white = hidden.bench, hidden.white
    if effect.fixed:
        one = Variant(np.zeros(bench.n_phi), effect, direction, hyper)
        shown = _energy(bench, white, one)
        return direction if 0.5 * energy < shown < 50 * energy else None
    sizes = effect.limit * np.geomspace(1e-6, 1.0, 19)
    nominal = bench.motions([bench.null()])[0]
    tangent, y0 = sensitivities(bench, white, nominal), nominal.y[:, :, None]
    variants = [Variant(np.zeros(bench.n_phi), effect, s * direction, hyper) for s in sizes]
    moved = white(bench.outputs(variants) - y0)
    good = np.isfinite(moved).all(axis=0)
    energies = np.full(len(sizes), np.nan)
    energies[good] = np.sum(projected(moved[:, good], tangent) ** 2, axis=0)
    good &= energies > 1e-9
    for _ in range(2):
        at = np.flatnonzero(good & (energies > energy))
        if not len(at) or at[0] == 0 or not good[at[0] - 1]:
            return None
        i = at[0]
        logs = np.log(energies[i - 1 : i + 1] / energy)
        part = float(-logs[0] / (logs[1] - logs[0]))
        size = float(sizes[i - 1] ** (1 - part) * sizes[i] ** part) * direction
        got = _energy(bench, white, Variant(np.zeros(bench.n_phi), effect, size, hyper))
        if not np.isfinite(got) or got <= 0:
            return None
        if 0.7 < got / energy < 1.4:
            return size
        energies = energies * got / energy
    return size if 0.4 < got / energy < 2.5 else None


def _energy(bench: Bench, white: Whitener, truth: Variant) -> float:
    """lambda: what the best nominal parameters and start leave of the misfit without noise."""
    y = bench.outputs([truth])[:, :, 0]
    if not np.isfinite(y).all():
        return float("nan")
    return minimised(bench, white, y, [bench.null()], iterations=4)[0][1]


def _spoil(hidden: Hidden, kind: str, energy: float, rng: np.random.Generator) -> None:
    """Spoil samples of the recorded channel so that what was changed has the energy."""
    system, n = hidden.bench.system, hidden.bench.n
    j = [o.name for o in system.outputs].index(hidden.where)
    sd, y = system.outputs[j].sd, hidden.y[:, j].copy()

    def shown(new: Array) -> float:
        return float(np.sum((new - y)[SKIP:n] ** 2) / sd**2)

    if kind == "outliers":
        level = sd * max(float(np.sqrt(max(energy, 500.0) / (0.01 * n))), 6.0)
        new = spoilt(kind, y, level, rng)
    else:
        levels = np.geomspace(1e-3, 0.7, 60)
        tried = [spoilt(kind, y, level, rng) for level in levels]
        new = next((t for t in tried if shown(t) > energy), tried[-1])
    hidden.y[:, j] = new
    hidden.channels[hidden.where] = new
    hidden.energy = shown(new)
