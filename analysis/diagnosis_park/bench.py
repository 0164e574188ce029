"""One record's system with its true nominal parameters: variants of it, and what noise leaves.

What the noise leaves of a difference of outputs is whitened by the Kalman filter of the system
linearised along its nominal motion, with the true noise of sensors, measured inputs and
disturbances: innovations of unit variance, independent, whatever the start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tests.support.park.effects import Effect, Scales, sensed
from tests.support.park.simulator import Acting, Array, System, simulate, staged

SKIP = 10
"""First samples that count for nothing: what lags and delays remember is not in the record."""


@dataclass(frozen=True, slots=True, eq=False)
class Variant:
    """A column: changes of parameters (relative) and initial states (in spreads), and an effect."""

    phi: Array  # (n_theta + nx,)
    effect: Effect | None = None
    size: Array = field(default_factory=lambda: np.zeros(0))
    hyper: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """What a variant does: outputs (n, ny), outputs at the steps before sensor effects, states."""

    variant: Variant
    y: Array
    fine: Array  # (2 steps, ny)
    x: Array  # (nx, n)
    U: Array  # (steps, 3, nu + disturbances)


@dataclass(slots=True, eq=False)
class Bench:
    """A system at its true nominal values with the recorded inputs of `n` samples."""

    system: System
    theta: Mapping[str, float]
    x0: Array  # (nx,)
    u: Array  # (nu, N) recorded
    beside: Mapping[str, Array]  # (N,) each, standardised
    n: int

    @property
    def n_phi(self) -> int:
        return len(self.theta) + len(self.x0)

    def null(self) -> Variant:
        return Variant(np.zeros(self.n_phi))

    def stages(self) -> Array:
        """(steps, 3, nu + disturbances, 1) with disturbances at rest."""
        s = self.system
        rows = [
            staged(u[: self.n], i.hold, s.substeps) for u, i in zip(self.u, s.inputs, strict=True)
        ]
        rows += [np.zeros_like(rows[0]) for _ in s.disturbances]
        return np.stack(rows, axis=-1)[..., None]

    def outputs(self, variants: Sequence[Variant]) -> Array:
        """(n, ny, K) without noise, columns in the order of `variants`."""
        return np.stack([m.y for m in self.motions(variants)], axis=-1)

    def motions(self, variants: Sequence[Variant]) -> list[Motion]:
        """Each variant's motion without noise, in the order of `variants`."""
        order = sorted(range(len(variants)), key=lambda i: _key(variants[i]))
        out: dict[int, Motion] = {}
        for is_input in (True, False):
            part = [i for i in order if (_stage(variants[i]) == "input") is is_input]
            if part:
                moved = self._simulated([variants[i] for i in part])
                out |= dict(zip(part, moved, strict=True))
        return [out[i] for i in range(len(variants))]

    def columns(self, variants: Sequence[Variant]) -> tuple[Array, dict[str, Array]]:
        phi = np.stack([v.phi for v in variants], axis=1)
        p = {name: value * (1 + phi[i]) for i, (name, value) in enumerate(self.theta.items())} | {
            n: np.array([v]) for n, v in self.system.more.get("known", {}).items()
        }
        spread = np.array([sd for _, sd in self.system.start.values()])
        return self.x0[:, None] + spread[:, None] * phi[len(self.theta) :], p

    def acting(self, variants: Sequence[Variant]) -> list[Acting]:
        """The effects of columns that are in the order of their effects."""
        out: list[Acting] = []
        at = 0
        while at < len(variants):
            effect, end = variants[at].effect, at
            while end < len(variants) and variants[end].effect is effect:
                end += 1
            if effect is not None:
                size = np.stack([v.size for v in variants[at:end]], axis=1)
                hyper = np.array([v.hyper for v in variants[at:end]])
                out.append(Acting(effect, slice(at, end), size, hyper))
            at = end
        return out

    def _simulated(self, variants: Sequence[Variant]) -> list[Motion]:
        s, acting = self.system, self.acting(variants)
        x0, p = self.columns(variants)
        U = self.stages()
        if any(a.effect.stage == "input" for a in acting):
            U = np.repeat(U, len(variants), axis=-1)
            for a in acting:
                j = self.index_of_input(a.effect)
                U[:, :, j, a.columns] = a.effect.law(a.size, self.u[j, : self.n])
        beside = {c: staged(z[: self.n], "foh", s.substeps) for c, z in self.beside.items()}
        with np.errstate(all="ignore"):
            Y, X = simulate(s, x0, p, U, acting, beside=beside, clock=(0.0, self.horizon))
            y = sensed(Y, acting)[:: 2 * s.substeps]
        return [
            Motion(v, y[:, :, i], Y[:, :, i], X[:-1, :, i].T, U[..., min(i, U.shape[3] - 1)])
            for i, v in enumerate(variants)
        ]

    @property
    def horizon(self) -> float:
        return float(self.u.shape[1] * self.system.Ts)

    def index_of_input(self, effect: Effect) -> int:
        return [i.name for i in self.system.inputs].index(effect.channel)


def _stage(v: Variant) -> str:
    return "" if v.effect is None else v.effect.stage


def _key(v: Variant) -> int:
    return 0 if v.effect is None else id(v.effect)


def scales_of(bench: Bench) -> Scales:
    """Sizes of forces, rates, positions and channels of the nominal record."""
    s = bench.system
    U, x0, p = bench.stages(), *bench.columns([bench.null()])
    Y, X = simulate(s, x0, p, U)
    x, u = X[:-1, :, 0].T, U[:: s.substeps, 0, :, 0].T
    n_b = 1 + max(max(place.signs) for place in s.places)
    p1 = {name: np.broadcast_to(v, (x.shape[1],)) for name, v in p.items()}
    padded = np.concatenate([x, np.zeros((2, x.shape[1]))])

    def motion(f: Array) -> Array:
        rows = s.rate(padded, u, p1, f)
        return np.stack([np.broadcast_to(r, (x.shape[1],)) for r in rows])

    still = motion(np.zeros((n_b, x.shape[1])))
    force, rate, position = {}, {}, {}
    for place in s.places:
        b = next(iter(place.signs))
        push = np.zeros((n_b, x.shape[1]))
        push[b] = 1.0
        moved, gain = place.of(still, place.rate), place.of(motion(push) - still, place.rate)
        force[place.name] = float(np.sqrt(np.mean(moved**2)) / np.mean(abs(gain)))
        r = place.of(x, place.rate) - place.operating
        rate[place.name] = float(np.sqrt(np.mean(r**2)))
        if place.position is not None:
            position[place.name] = float(np.max(abs(place.of(x, place.position))))
    signals = {i.name: v for i, v in zip(s.inputs, bench.u, strict=True)}
    signals |= {o.name: Y[:, j, 0] for j, o in enumerate(s.outputs)}
    largest = {name: float(np.max(abs(v))) for name, v in signals.items()}
    rms = {name: float(np.std(v)) for name, v in signals.items()}
    return Scales(force, rate, position, largest, rms)


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """Gains of the Kalman filter along a nominal motion."""

    F: Array  # (n, ns, ns)
    H: Array  # (n, ny, ns)
    gains: Array  # (n, ns, ny)
    roots: Array  # (n, ny, ny): inverse Cholesky factors of the innovations' covariance
    moving: bool

    def __call__(self, r: Array) -> Array:
        """(n, ny, K) differences -> (n ny, K) innovations in units of their noise."""
        out = np.einsum("kij,kjc->kic", self.roots, r) if not self.moving else np.empty_like(r)
        if self.moving:
            z = np.zeros((self.F.shape[1], r.shape[2]))
            for k in range(len(r)):
                e = r[k] - self.H[k] @ z
                out[k] = self.roots[k] @ e
                z = self.F[k] @ (z + self.gains[k] @ e)
        out[:SKIP] = 0.0
        return np.asarray(out.reshape(-1, r.shape[2]))


def whitener_of(bench: Bench) -> Whitener:
    """The whitener of a record's true noise."""
    s = bench.system
    n, nx, ny = bench.n, len(bench.x0), len(s.outputs)
    noisy = [i for i, one in enumerate(s.inputs) if one.sd > 0.0]
    sources: list[tuple[int, float, float, float]] = [(i, 0.0, 0.0, s.inputs[i].sd) for i in noisy]
    sources += [(len(s.inputs) + i, *d.coefficients(s.Ts)) for i, d in enumerate(s.disturbances)]
    local = Local(bench, bench.motions([bench.null()])[0])
    A, C = local.dynamics()
    ns = nx + 2 * len(sources)
    F, H, G = np.zeros((n, ns, ns)), np.zeros((n, ny, ns)), np.zeros((n, ns, len(sources)))
    F[:, :nx, :nx], H[:, :, :nx] = A, C
    P = np.zeros((ns, ns))
    for i, (j, a1, a2, sd) in enumerate(sources):
        hold = s.inputs[j].hold if j < len(s.inputs) else "foh"
        size = s.inputs[j].sd if j < len(s.inputs) else s.disturbances[j - len(s.inputs)].sd
        B0, B1, D = local.source(j, size, hold)
        d = nx + 2 * i
        F[:, :nx, d], F[:, :nx, d + 1] = B0 + B1 * a1, B1 * a2
        F[:, d, d], F[:, d, d + 1], F[:, d + 1, d] = a1, a2, 1.0
        G[:, :nx, i], G[:, d, i] = B1 * sd, sd
        H[:, :, d] = D
        rho = a1 / (1 - a2)
        v = sd**2 / (1 - a1 * rho - a2 * (a1 * rho + a2))
        P[d : d + 2, d : d + 2] = v * np.array([[1.0, rho], [rho, 1.0]])
    R = np.diag([o.sd**2 for o in s.outputs])
    gains, roots = np.zeros((n, ns, ny)), np.zeros((n, ny, ny))
    for k in range(n):
        S = H[k] @ P @ H[k].T + R
        gains[k] = np.linalg.solve(S, H[k] @ P).T
        roots[k] = np.linalg.inv(np.linalg.cholesky(S))
        P = P - gains[k] @ S @ gains[k].T
        P = F[k] @ P @ F[k].T + G[k] @ G[k].T
        P = 0.5 * (P + P.T)
    return Whitener(F, H, gains, roots, bool(sources))


class Local:
    """Steps from every sample of a variant's motion at once, and their derivatives."""

    def __init__(self, bench: Bench, motion: Motion) -> None:
        self.bench, self.at = bench, motion.variant
        s, n = bench.system, bench.n
        wide = {c: staged(z[:n], "foh", s.substeps) for c, z in bench.beside.items()}
        self.horizon, self.y, self.x = bench.horizon, motion.y, motion.x
        self.fine = motion.fine[:, :, None]
        self.U = self._by_sample(motion.U)
        self.z = {c: self._by_sample(w) for c, w in wide.items()}
        self.t = s.Ts * np.arange(n, dtype=np.float64)

    def _by_sample(self, signal: Array) -> Array:
        """(steps, ...) to (substeps, ..., n)."""
        sub = self.bench.system.substeps
        return np.moveaxis(signal.reshape(self.bench.n, sub, *signal.shape[1:]), 0, -1)

    def step(
        self,
        dx: Array | float = 0.0,
        *,
        phi: Array | None = None,
        U: Array | None = None,
        effect: tuple[Effect, Array, float] | None = None,
    ) -> tuple[Array, Array]:
        """Next states (nx, n) and outputs (ny, n) of all samples, something changed."""
        s, n, at = self.bench.system, self.bench.n, self.at
        _, p = self.bench.columns([at if phi is None else Variant(phi)])
        if effect is None and at.effect is not None:
            effect = (at.effect, at.size, at.hyper)
        acting = []
        if effect is not None and effect[0].stage in ("force", "parameter"):
            size = np.repeat(effect[1][:, None], n, axis=1)
            acting = [Acting(effect[0], slice(0, n), size, np.full(n, effect[2]))]
        with np.errstate(all="ignore"):
            Y, X = simulate(
                s,
                self.x + dx,
                {k: np.broadcast_to(v, (n,)) for k, v in p.items()},
                self.U if U is None else U,
                acting,
                beside=self.z,
                clock=(self.t, self.horizon),
            )
        return X[-1], Y[0]

    def dynamics(self) -> tuple[Array, Array]:
        """A (n, nx, nx) and C (n, ny, nx)."""
        scale = np.maximum(np.std(self.x, axis=1), 1e-6) * 1e-4
        sides = []
        for i, one in enumerate(scale):
            dx = float(one) * np.eye(len(self.x))[i][:, None]
            sides.append(_halved(self.step(dx), self.step(-dx), float(one)))
        return tuple(np.moveaxis(np.stack(m, axis=-1), 1, 0) for m in zip(*sides, strict=True))  # type: ignore[return-value]

    def source(self, j: int, sd: float, hold: str) -> tuple[Array, Array, Array]:
        """B0, B1 (n, nx) of a noisy signal now and at the next sample, and D (n, ny)."""
        sub = self.bench.system.substeps
        part = (np.arange(sub)[:, None] + np.array([0.0, 0.5, 1.0])) / sub
        ahead = part if hold == "foh" else np.zeros_like(part)
        found = []
        for weight in (1 - ahead, ahead):
            dU = np.zeros_like(self.U)
            dU[:, :, j] = 1e-2 * sd * weight[..., None]
            found.append(_halved(self.step(U=self.U + dU), self.step(U=self.U - dU), 1e-2 * sd))
        return found[0][0].T, found[1][0].T, found[0][1].T

    def responses(self, changes: Sequence[tuple[Array, Array]], start: bool = True) -> Array:
        """Outputs (n, ny, nx + changes) to a unit of each initial state and each change.

        A change gives what it adds to the next states (nx, n) and to the outputs (ny, n).
        """
        A, C = self.dynamics()
        nx, ny, n = len(self.x), C.shape[1], len(A)
        first = nx if start else 0
        b, d = np.zeros((n, nx, first + len(changes))), np.zeros((n, ny, first + len(changes)))
        for i, (moved, seen) in enumerate(changes):
            b[:, :, first + i], d[:, :, first + i] = moved.T, seen.T
        z = np.zeros((nx, first + len(changes)))
        z[:, :first] = np.eye(nx)[:, :first]
        out = np.empty_like(d)
        for k in range(n):
            out[k] = C[k] @ z + d[k]
            z = A[k] @ z + b[k]
        return out

    def of_parameters(self) -> list[tuple[Array, Array]]:
        eps, eye = 1e-4, np.eye(self.bench.n_phi)
        at = self.at.phi
        return [
            _halved(self.step(phi=at + eps * eye[i]), self.step(phi=at - eps * eye[i]), eps)
            for i in range(len(self.bench.theta))
        ]

    def of_sizes(
        self, effect: Effect, size: Array, hyper: float, h: Array, base: tuple[Array, Array]
    ) -> list[tuple[Array, Array]]:
        """Derivatives with respect to the sizes of a law of force, a parameter, or an input."""
        found = []
        for i in range(effect.n):
            if effect.stage == "input":
                j = self.bench.index_of_input(effect)
                law = effect.law(np.array([[size[0] + h[0]]]), self.bench.u[j, : self.bench.n])
                U = np.array(self.U)
                U[:, :, j] = self._by_sample(law[..., 0])
                moved = self.step(U=U)
            else:
                moved = self.step(effect=(effect, size + h[i] * np.eye(effect.n)[i], hyper))
            found.append(((moved[0] - base[0]) / h[i], (moved[1] - base[1]) / h[i]))
        return found

    def through_sensor(self, moved: Array) -> Array:
        """What a sensor effect makes of small changes of the outputs (n, ny, K)."""
        effect = self.at.effect
        if effect is None or effect.stage != "sensor":
            return moved
        sub, K = self.bench.system.substeps, moved.shape[2]
        fine = np.repeat(moved, 2 * sub, axis=0)
        size = np.repeat(self.at.size[:, None], K, axis=1)
        eps = 1e-4 / np.maximum(np.max(abs(fine), axis=(0, 1)), 1e-12)
        eps = eps * np.max(abs(self.fine))
        above, below = (effect.law(size, self.fine + side * eps * fine) for side in (1, -1))
        return np.asarray((above - below)[:: 2 * sub] / (2 * eps))


def _halved(
    above: tuple[Array, Array], below: tuple[Array, Array], eps: float
) -> tuple[Array, Array]:
    return (above[0] - below[0]) / (2 * eps), (above[1] - below[1]) / (2 * eps)


def projected(rows: Array, tangent: Array) -> Array:
    """What of the columns of `rows` is orthogonal to the columns of `tangent`."""
    scale = np.linalg.norm(tangent, axis=0)
    q, r = np.linalg.qr(tangent[:, scale > 0] / scale[scale > 0])
    keep = abs(np.diag(r)) > 1e-9
    q = q[:, keep]
    return np.asarray(rows - q @ (q.T @ rows))


def sensitivities(bench: Bench, white: Whitener, motion: Motion) -> Array:
    """Whitened derivatives with respect to `phi` and to the size."""
    local, m, at = Local(bench, motion), len(bench.theta), motion.variant
    changes = local.of_parameters()
    effect = at.effect
    h = np.zeros(0)
    if effect is not None and not effect.fixed:
        h = np.maximum(1e-4 * abs(at.size), 1e-6 * effect.limit)
    direct = effect is not None and effect.stage in ("force", "parameter", "input")
    if effect is not None and direct and len(h):
        changes += local.of_sizes(effect, at.size, at.hyper, h, local.step())
    moved = local.through_sensor(local.responses(changes))
    nx = len(bench.x0)
    spread = np.array([sd for _, sd in bench.system.start.values()])
    columns = [moved[:, :, nx : nx + m], moved[:, :, :nx] * spread, moved[:, :, nx + m :]]
    if effect is not None and not direct and len(h):
        columns[2] = np.stack([_of_size(local, i, h) for i in range(effect.n)], axis=-1)
    if effect is not None and effect.fixed:
        columns[2] = np.zeros((*local.y.shape, effect.n))
    return white(np.concatenate(columns, axis=2))


def _of_size(local: Local, i: int, h: Array) -> Array:
    """Derivative with respect to the size of a sensor effect, or of a part that swings along."""
    at, effect = local.at, local.at.effect
    assert effect is not None
    size = at.size + h[i] * np.eye(effect.n)[i]
    if effect.stage == "sensor":
        y = effect.law(size[:, None], local.fine)[:: 2 * local.bench.system.substeps, :, 0]
    else:
        y = local.bench.outputs([replace(at, size=size)])[:, :, 0]
    return np.asarray((y - local.y) / h[i])
