"""The balances of a model as linear regressions in its unknown parameters, and their solution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import DataError, IdentifiabilityError, ModelError
from casid.estimation.measured_motion import Motion
from casid.estimation.simulation.records.signals import Signals
from casid.model.model import Model


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """One balance in one record."""

    record: str
    balance: str
    phi: Array  # (N, d)
    y: Array  # (N,)


class BalanceRegression:
    """Phi theta = Y of every balance, from the model's own expressions."""

    def __init__(self, model: Model, free: Sequence[str]) -> None:
        self.model, self.free = model, list(free)
        x = ca.vertcat(*[model.symbol(s) for s in model.states])
        x_dot = ca.vertcat(*[model.der(s) for s in model.states])
        u = ca.vertcat(*[model.symbol(i) for i in model.inputs])
        p = ca.vertcat(*[model.symbol(i) for i in model.parameters])
        residuals = ca.vertcat(
            *[
                b.inertia * model.der(b.rate) - ca.sum1(ca.vertcat(*b.terms))
                for b in model.balances.values()
            ]
        )
        residuals = _without_unknown_inputs(model, residuals)
        theta = ca.vertcat(*[model.symbol(n) for n in free])
        jacobian = ca.jacobian(residuals, theta)
        self._evaluate = ca.Function(
            "balance", [x, x_dot, u, p], [ca.densify(residuals), ca.densify(ca.vec(jacobian))]
        )
        self._refuse_nonlinear()

    def _parameters(self, known: Mapping[str, float]) -> Array:
        values = {
            q.name: q.value if q.value is not None else q.start
            for q in self.model.parameters.values()
        }
        values.update(known)
        return np.array([values[n] for n in self.model.parameters], dtype=float)

    def _refuse_nonlinear(self) -> None:
        """Compare the derivatives in theta at two values of theta, at random points.

        Judged by numbers, not by structure: a product of parameters may cancel, as the stiffness
        of gravity does in an indirect model.
        """
        model, free = self.model, self.free
        rng = np.random.default_rng(5)
        names = list(model.parameters)
        columns = [names.index(n) for n in free]
        nb = len(model.balances)
        for _ in range(3):
            args = [rng.uniform(0.3, 1.5, self._evaluate.numel_in(i)) for i in range(3)]
            p = self._parameters({})
            p[columns] = rng.uniform(0.3, 1.5, len(free))
            base = np.array(self._evaluate(*args, p)[1]).reshape(len(free), nb)
            for column, name in zip(columns, free, strict=True):
                moved = p.copy()
                moved[column] *= 1.37
                there = np.array(self._evaluate(*args, moved)[1]).reshape(len(free), nb)
                change = np.abs(there - base) > 1e-9 * (np.abs(base) + np.abs(there)) + 1e-12
                if change.any():
                    j, b = np.argwhere(change)[0]
                    other = free[int(j)]
                    pair = name if other == name else f"{other} times {name}"
                    raise ModelError(
                        f"{model.name}: balance {list(model.balances)[int(b)]!r} is not linear in "
                        f"its unknown parameters ({pair}): give one of them a known value, or "
                        "one name to the product, or use casid.identify"
                    )

    def sides(self, d: Signals, motion: Motion) -> tuple[list[Array], list[Array]]:
        """Phi (N, d) and Y (N,) of every balance in one record."""
        p = self._parameters(d.known)
        at = self._evaluate(motion.x.T, motion.x_dot.T, motion.u.T, p)
        r, j = np.array(at[0]), np.array(at[1])
        nb, names = len(self.model.balances), list(self.model.parameters)
        jac = j.reshape(len(self.free), nb, d.N)
        start = np.array([p[names.index(n)] for n in self.free])
        unknown = np.array([n not in d.known for n in self.free])
        phis, ys = [], []
        for b in range(nb):
            full = jac[:, b, :].T
            phi = np.where(unknown, full, 0.0)
            ys.append(phi @ start - r[b])
            phis.append(phi)
        return phis, ys


def _without_unknown_inputs(model: Model, residuals: Any) -> Any:
    """Replace unmeasured inputs by what the eliminating outputs give for them."""
    eliminated = [w for w, _, _ in model._eliminations]
    if not eliminated:
        return residuals
    w = ca.vertcat(*[model.symbol(name) for name in eliminated])
    rows = ca.vertcat(*[r for _, _, r in model._eliminations])
    matrix = ca.jacobian(rows, w)
    constant = ca.substitute(rows, w, ca.SX.zeros(w.numel()))
    return ca.substitute(residuals, w, -ca.solve(matrix, constant))


def weighted_least_squares(
    model: Model, blocks: Sequence[Sequence[Block]], free: Sequence[str]
) -> tuple[Array, dict[str, float]]:
    """Least squares by QR, the balances weighted alike first and by their residuals then."""
    every = [b for row in blocks for b in row]
    names = list(dict.fromkeys(b.balance for b in every))
    sizes = {n: size_of(np.concatenate([b.y for b in every if b.balance == n])) for n in names}
    if not any(sizes.values()):
        raise IdentifiabilityError(
            f"{model.name}: every term of the balances has an unknown factor, so they determine "
            "ratios only; give one parameter (an inertia, say) a known value"
        )
    largest = max(sizes.values())
    weights = {n: 1 / (s or largest) for n, s in sizes.items()}
    theta = _least_squares(model, every, weights, free)
    if len(names) > 1:
        left = {
            n: size_of(np.concatenate([b.y - b.phi @ theta for b in every if b.balance == n]))
            for n in names
        }
        if all(v > 1e-12 * sizes[n] for n, v in left.items()):
            weights = {n: 1 / v for n, v in left.items()}
            theta = _least_squares(model, every, weights, free)
    return theta, weights


def size_of(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _least_squares(
    model: Model, blocks: Sequence[Block], weights: Mapping[str, float], free: Sequence[str]
) -> Array:
    from scipy.linalg import qr, solve_triangular

    phi = np.concatenate([weights[b.balance] * b.phi for b in blocks])
    y = np.concatenate([weights[b.balance] * b.y for b in blocks])
    if not (np.isfinite(phi).all() and np.isfinite(y).all()):
        raise DataError(
            f"{blocks[0].record}: the balances are not finite; look for a division by zero in "
            f"{model.name}"
        )
    if len(y) <= len(free):
        raise DataError(
            f"{blocks[0].record}: {len(y)} samples are too few for {len(free)} parameters; "
            "widen the window or decimate less"
        )
    length = np.linalg.norm(phi, axis=0)
    still = [n for n, s in zip(free, length, strict=True) if s == 0.0]
    if still:
        raise IdentifiabilityError(
            f"{model.name}: {', '.join(still)} moves no balance in "
            f"{', '.join(dict.fromkeys(b.record for b in blocks))}: give it a known value, or "
            "record an experiment that excites it"
        )
    scaled = phi / length
    _, singular, vt = np.linalg.svd(scaled, full_matrices=False)
    if singular[-1] < 1e-9 * singular[0]:
        together = [n for n, v in zip(free, vt[-1], strict=True) if abs(v) > 1e-3]
        raise IdentifiabilityError(
            f"{model.name}: {', '.join(together)} are not separately identifiable from the "
            "balances in these records: give one of them a known value"
        )
    q, r = qr(scaled, mode="economic")
    return np.asarray(solve_triangular(r, q.T @ y) / length)
