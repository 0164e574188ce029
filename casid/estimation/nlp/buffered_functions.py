"""Derivatives and optimality of a program as CasADi functions that write to fixed buffers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.nlp.solution import Evaluation, is_at_bound


class Buffered:
    """A CasADi function on arrays that it keeps, dense, columns one after another."""

    def __init__(
        self,
        function: Any,
        arguments: Mapping[str, Array],
        results: Mapping[str, Array] | None = None,
    ) -> None:
        self._function = function  # the buffer does not keep it alive
        self._buffer, self._call = function.buffer()
        self.arguments = dict(arguments)
        for name, array in self.arguments.items():
            self._buffer.set_arg(function.index_in(name), array.data)
        self.results = {
            name: (results or {}).get(name, np.zeros(function.nnz_out(i)))
            for i, name in enumerate(function.name_out())
        }
        for name, array in self.results.items():
            assert len(array) == function.nnz_out(name) == function.numel_out(name), name
            self._buffer.set_res(function.index_out(name), array.data)

    def __call__(self) -> None:
        """Evaluate on what the arguments hold, into the results."""
        self._call()

    def stats(self) -> Mapping[str, Any]:
        """The solver's statistics of the last call."""
        try:
            return dict(self._buffer.stats())
        except RuntimeError:  # sqpmethod has no statistics after a QP that failed
            return {"return_status": "Subproblem_Failed", "iter_count": 0}


def evaluation_of(out: Mapping[str, Array], n: int) -> Evaluation:
    """Copies of the arrays that the derivatives were written to."""
    return Evaluation(
        float(out["f"][0]),
        out["gradient"].copy(),
        out["hessian"].reshape(n, n).copy(),
        out["g"].copy(),
        out["jacobian"].reshape(-1, n, order="F").copy(),
    )


_NAMES = ["f", "gradient", "hessian", "g", "jacobian"]


def derivatives_of(function: Any, symbol: Any) -> Any:
    """(x, p) -> criterion, gradient, Hessian, constraints, their Jacobian; all dense."""
    x, p = (symbol.sym(name, function.numel_in(i)) for i, name in enumerate("xp"))
    f, g = function(x, p)
    hessian, gradient = ca.hessian(f, x)
    results = [ca.densify(e) for e in (f, gradient, hessian, g, ca.jacobian(g, x))]
    return ca.Function("derivatives", [x, p], results, ["x", "p"], _NAMES)


def curvature_of(function: Any, symbol: Any) -> Any:
    """(x, p, lam) -> Hessian of the Lagrangian f + lam'g."""
    x, p = (symbol.sym(name, function.numel_in(i)) for i, name in enumerate("xp"))
    lam = symbol.sym("lam", function.numel_out(1))
    f, g = function(x, p)
    return ca.Function("curvature", [x, p, lam], [ca.densify(ca.hessian(f + lam.T @ g, x)[0])])


def preparation_of(derivatives: Any, symbol: Any, scale: Array, box: Any) -> Any:
    """(x, p) -> what the solver begins with, and a number that is finite if f and gradient are."""
    x, p = (symbol.sym(name, derivatives.numel_in(i)) for i, name in enumerate("xp"))
    f, gradient, hessian, _, jacobian = derivatives(x, p)
    # The steepest is 100, where Ipopt's own scaling leaves off: less lets its barrier rule.
    unit = 1e-2 * ca.fmax(ca.norm_inf(gradient * scale), ca.norm_inf(ca.diag(hessian) * scale**2))
    slope = ca.vertcat(
        *[ca.mmax(ca.fabs(jacobian[i, :].T * scale)) for i in range(len(box[2]))], symbol(0, 1)
    )
    unit, slope = (ca.if_else((0 < e) * (e < np.inf), e, 1.0) for e in (unit, slope))
    return ca.Function(
        "preparation",
        [x, p],
        [
            x / scale,
            box[2] / slope,
            box[3] / slope,
            ca.vertcat(p, unit, slope),
            f + ca.sum1(gradient),
        ],
        ["x", "p"],
        ["x0", "lbg", "ubg", "units", "finite"],
    )


def optimality_of(derivatives: Any, symbol: Any, scale: Array, box: Any) -> Any:
    """(z, p, lam, units) -> x, its derivatives and how far it is from an optimum.

    The measure is that of `judged`, with the solver's multipliers `lam` (m,) of the
    scaled program.
    """
    lower, upper, low, high = box
    n, m = len(scale), len(low)
    size = derivatives.numel_in(1)
    z, p, lam = symbol.sym("z", n), symbol.sym("p", size), symbol.sym("lam", m)
    units = symbol.sym("units", size + 1 + m)
    x = ca.fmin(ca.fmax(z * scale, lower), upper)
    f, gradient, hessian, g, jacobian = derivatives(x, p)
    h, weighs = ca.diag(hessian), ca.fmax(ca.fabs(x), scale)
    level = ca.fabs(f) + ca.norm_inf(gradient * weighs)
    safe = ca.if_else(level > 0, level, 1.0)
    curved = h * weighs**2 > 1e-12 * level
    root = ca.sqrt(ca.if_else(curved, h, 1.0))
    weight = ca.if_else(curved, 1 / root, weighs / ca.sqrt(safe))
    unit = ca.if_else(curved, ca.fmax(ca.sqrt(ca.fabs(f)), 1e-4 * root * weighs), ca.sqrt(safe))
    # Only a constraint at its limit has a multiplier, and it pushes inwards.
    tolerance = 1e-6 * ca.fmax(ca.mtimes(ca.fabs(jacobian), weighs), TINY)
    _, objective, rows = ca.vertsplit(units, [0, size, size + 1, size + 1 + m])
    pull = lam * objective / rows
    at_low, at_high = ca.fabs(low - g) < tolerance, ca.fabs(high - g) < tolerance
    pull = ca.if_else(
        low == high,
        pull,
        ca.if_else(at_low, ca.fmin(pull, 0.0), 0.0) + ca.if_else(at_high, ca.fmax(pull, 0.0), 0.0),
    )
    slope = (gradient + ca.mtimes(jacobian.T, pull)) * weight
    held_low = is_at_bound(x - lower, gradient, scale, abs(lower), f)
    held_high = is_at_bound(upper - x, -gradient, scale, abs(upper), f)
    slope = ca.if_else(held_low, ca.fmin(slope, 0.0), slope)
    slope = ca.if_else(held_high, ca.fmax(slope, 0.0), slope)
    concave = ca.mmax((h * weighs**2 < -1e-12 * level) * (1 - held_low) * (1 - held_high))
    violation = ca.mmax(ca.vertcat(0.0, low - g, g - high))
    relative = ca.mmax(ca.vertcat(0.0, (low - g) / tolerance, (g - high) / tolerance)) * 1e-6
    return ca.Function(
        "optimality",
        [z, p, lam, units],
        [
            *[ca.densify(e) for e in (x, f, gradient, hessian, g, jacobian)],
            ca.if_else(concave, np.inf, ca.norm_inf(slope / unit)),
            ca.densify(violation),
            ca.densify(relative),
            ca.densify(pull),
            ca.densify(held_low + 2 * held_high),
        ],
        ["z", "p", "lam", "units"],
        ["x", *_NAMES, "scaled_gradient", "violation", "relative", "pull", "held"],
    )
