"""The map g from the free parameters of a stage to its coefficients.

All parts of a stage stacked, theta = g(theta_p; what is known of each part): values, slopes, the
linear constraints that the image obeys, the inverse, and a refusal where parameters are not
identifiable, whatever the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import TINY, Array
from casid.errors import IdentifiabilityError, ModelError
from casid.estimation.local_rank import describe_null, local_rank
from casid.linear.hulls.affine_hull import affine_hull
from casid.linear.sampled.difference_equation import DifferenceEquation
from casid.model.declarations import Parameter


class CoefficientMap:
    """The stacked coefficients of a stage's parts as functions of its free parameters.

    Parameters
    ----------
    equations : of each part.
    free : the parameters that are estimated, with bounds.
    fixed : of each part, the free names that are known there (its load case).
    """

    def __init__(
        self,
        equations: Sequence[DifferenceEquation],
        free: Sequence[Parameter],
        fixed: Sequence[frozenset[str]],
        *,
        name: str,
    ) -> None:
        self.equations, self.fixed, self.name = list(equations), list(fixed), name
        self.parameters = list(free)
        self.free = tuple(p.name for p in free)
        self._stack, self._stack_jacobian = self._stacked()
        self._at_once = _AtOnce(self._stack, self._stack_jacobian)
        self._hull: Any = None

    def _stacked(self) -> tuple[Any, Any]:
        """g of all parts as a function of the free parameters and of each part's known ones."""
        x = ca.SX.sym("x", len(self.free))
        known, rows = [], []
        for e, fixed in zip(self.equations, self.fixed, strict=True):
            k = ca.SX.sym("k", len(e.parameters))
            p = ca.vertcat(
                *[
                    x[self.free.index(q)] if q in self.free and q not in fixed else k[i]
                    for i, q in enumerate(e.parameters)
                ]
            )
            known.append(k)
            rows.append(e.g(p))
        stack = ca.vertcat(*rows)
        f = ca.Function("g", [x, ca.vertcat(*known)], [ca.densify(stack)])
        j = ca.Function("dg", [x, ca.vertcat(*known)], [ca.densify(ca.jacobian(stack, x))])
        return f, j

    def theta(self, theta_p: Array, values: Sequence[Mapping[str, float]]) -> Array:
        """theta of all parts, stacked."""
        return self._at_once.g(theta_p, self._known_vector(values))

    def jacobian(self, theta_p: Array, values: Sequence[Mapping[str, float]]) -> Array:
        """d theta / d theta_p of all parts, (sum ntheta, nfree)."""
        return np.asarray(self._stack_jacobian(theta_p, self._known_vector(values)))

    def _known_vector(self, values: Sequence[Mapping[str, float]]) -> Array:
        return np.concatenate(
            [[v[q] for q in e.parameters] for e, v in zip(self.equations, values, strict=True)]
        )

    def require_identifiable(self, start: Array, values: Sequence[Mapping[str, float]]) -> None:
        """Refuse parameters that g does not identify, whatever the data.

        Raises
        ------
        IdentifiabilityError
            With the direction that changes nothing, and the remedy.
        """
        rng = np.random.default_rng(11)
        best = None
        for k in range(3):
            x = start if k == 0 else start * np.exp(0.2 * rng.standard_normal(len(start)))
            x = np.where(x == 0.0, 0.1 * (k + 1), x)
            J = self.jacobian(x, values)
            if not np.all(np.isfinite(J)):
                continue
            # Coefficients such as a1 and a2 differ from a constant by little: scale the rows by
            # what the parameters move them.
            J = J / np.maximum(np.max(np.abs(J * x), axis=1, keepdims=True), TINY)
            rank = local_rank(J.T @ J, x, self.free, np.abs(x))
            if rank.is_full:
                return
            best = best or rank
        if best is not None:
            raise IdentifiabilityError(
                f"{self.name}: rank {best.rank} of {best.unknowns} free parameters in "
                f"{', '.join(dict.fromkeys(e.output for e in self.equations))}: "
                f"{describe_null(best)}"
            )

    def inverse(
        self, theta: Array, values: Sequence[Mapping[str, float]], start: Array, metric: Array
    ) -> Array:
        """theta_p inside its bounds with g(theta_p) nearest to theta in ||metric (theta - g)||."""
        k = self._known_vector(values)
        low = np.array([p.lower for p in self.parameters])
        high = np.array([p.upper for p in self.parameters])
        x = start.copy()

        image = self._at_once
        r, J = image(x, k, theta, metric)
        for _ in range(60):
            scale = np.where(x == 0.0, 1.0, np.abs(x))
            step = scale * _least_squares(J * scale, r)
            factor = 1.0
            while factor > 1e-6:
                new = np.minimum(np.maximum(x + factor * step, low), high)
                r_new, J_new = image(new, k, theta, metric)
                if np.isfinite(r_new).all() and r_new @ r_new <= (1 - 1e-4 * factor) * (r @ r):
                    break
                factor /= 2
            else:
                break
            moved = np.max(np.abs(new - x) / scale)
            x, r, J = new, r_new, J_new
            if moved < 1e-12:
                break
        return x

    def constraints(
        self, values: Sequence[Mapping[str, float]], start: Array
    ) -> tuple[Array, Array]:
        """B and b of this stage at what is known now.

        How many there are is decided once, with care; other known values move their coefficients,
        which follow from a few points of the image.
        """
        known = self._known_vector(values)
        if self._hull is None:
            x = ca.SX.sym("x", len(self.free))
            g = ca.Function("g", [x], [self._stack(x, known)])
            hull = affine_hull(
                g, self.free, dict(zip(self.free, start.tolist(), strict=True)), self.free
            )
            if hull.nonlinear:
                raise ModelError(
                    f"{self.name}: the image of {', '.join(self.free)} is not an affine set "
                    f"({len(self.free)} parameters, {hull.dimension} dimensions): linear "
                    "constraints alone do not keep the physical parameterisation. Use "
                    "form='eliminated' or 'lifted'"
                )
            rng = np.random.default_rng(5)
            spread = np.exp(1.5 * rng.standard_normal((40, len(self.free))))
            points = (np.where(start == 0.0, 1.0, start) * spread).T
            self._hull = (known, hull.B, hull.b, points, self._stack.map(points.shape[1]))
        at, B, b, points, mapped = self._hull
        if np.array_equal(at, known):
            return B, b
        image = np.asarray(mapped(points, np.tile(known[:, None], points.shape[1]))).T
        rows = np.column_stack([image, np.ones(len(image))])
        scale = np.max(np.abs(rows), axis=0)
        null = np.linalg.svd(rows / scale)[2][len(rows[0]) - len(b) :] / scale
        null /= np.max(np.abs(null[:, :-1]), axis=1, keepdims=True)
        return null[:, :-1], -null[:, -1]

    def split(self, stacked: Array) -> list[Array]:
        """Stacked coefficients (sum ntheta,) by part."""
        sizes = np.cumsum([len(e.coefficients) for e in self.equations])
        return list(np.split(stacked, sizes[:-1]))


def _least_squares(A: Array, b: Array) -> Array:
    """x with the smallest ||A x - b||; by the normal equations where they are sound, being faster.

    An error of such a step is made good by the next one.
    """
    size = np.sqrt(np.einsum("ij,ij->j", A, A))
    if size.all():
        try:
            x = np.linalg.solve(A.T @ A / np.outer(size, size), A.T @ b / size)
        except np.linalg.LinAlgError:
            x = np.full(len(size), np.inf)
        if abs(x).max() < 1e6 * np.sqrt(b @ b):
            return np.asarray(x / size)
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0])


class _AtOnce:
    """The residual metric (theta - g) and its slope at theta_p, by buffers of CasADi."""

    def __init__(self, stack: Any, jacobian: Any) -> None:
        self._functions = stack, jacobian
        self.x, self.known = np.zeros(stack.numel_in(0)), np.zeros(stack.numel_in(1))
        self._g, self._slope = np.zeros(stack.numel_out(0)), np.zeros(jacobian.numel_out(0))
        self._calls = []
        self._buffers = []
        for f, out in ((stack, self._g), (jacobian, self._slope)):
            assert f.nnz_out(0) == f.numel_out(0), "a sparse result has no place for its zeros"
            buffer, call = f.buffer()
            buffer.set_arg(0, self.x.data)
            buffer.set_arg(1, self.known.data)
            buffer.set_res(0, out.data)
            self._buffers.append(buffer)
            self._calls.append(call)

    def __reduce__(self) -> Any:
        return _AtOnce, self._functions

    def g(self, x: Array, known: Array) -> Array:
        """theta."""
        self.x[:], self.known[:] = x, known
        self._calls[0]()
        return self._g.copy()

    def __call__(self, x: Array, known: Array, theta: Array, metric: Array) -> tuple[Array, Array]:
        """(metric (theta - g(x)), metric dg/dx)."""
        self.x[:], self.known[:] = x, known
        for call in self._calls:
            call()
        slope = self._slope.reshape(len(self.x), -1).T
        return metric @ (theta - self._g), metric @ slope
