"""The explicit form dx/dt = f(x, u, theta), y = h(x, u, theta), and the elimination behind it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from casid.errors import ModelError


@dataclass(frozen=True, slots=True)
class Explicit:
    """SX right-hand sides and outputs, and the symbols they are made of."""

    x: Any
    u: Any
    p: Any
    f: Any
    h: Any
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    eliminated: Mapping[str, Any] = field(default_factory=dict)


def solved_for(z: Any, residuals: Sequence[Any], model: str, n_first: int) -> Any:
    """Solve residuals = 0, linear in the symbols z (n,), for z; the first `n_first` are inputs.

    Raises
    ------
    ModelError
        If the equations are not linear in a symbol, or do not determine it.
    """
    residual = ca.vertcat(*residuals)
    matrix = ca.jacobian(residual, z)
    names = [str(z[j]) for j in range(z.numel())]
    curved = ca.vec(matrix)
    nonlinear = [n for n, met in zip(names, ca.which_depends(curved, z), strict=True) if met]
    if nonlinear:
        raise ModelError(
            f"{model}: the equations are not linear in {', '.join(nonlinear)}, so the "
            "solution is not unique; give the branch, eliminate(..., solution=expression)"
        )
    rhs = -ca.substitute(residual, z, ca.SX.zeros(z.numel()))
    return _linear_solve(matrix, rhs, model, names, n_first)


def check_branch(
    model: str, expression: Any, measured: Any, unknown: Any, solution: Any, using: str
) -> None:
    """Refuse a solution for `unknown` that does not give the output `using` back; ModelError."""
    back = ca.substitute(expression, unknown, solution) - measured
    symbols = ca.symvar(ca.veccat(expression, measured, solution))
    rng = np.random.default_rng(1)
    error = ca.Function("b", symbols, [back])
    values = [error(*rng.uniform(0.1, 0.9, len(symbols))) for _ in range(5)]
    finite = [abs(float(v)) for v in values if np.isfinite(float(v))]
    if not finite or max(finite) > 1e-8:
        raise ModelError(
            f"{model}: the solution given for {unknown} does not satisfy the output "
            f"{using}; it must give {using} back when it is substituted"
        )


def _undetermined(model: str, lacking: str, inputs: list[str], is_stated: bool) -> ModelError:
    """The error about a symbol that no equation is left for, although one may state it."""
    text = f"{model}: the equations do not determine {lacking}; "
    if lacking in inputs:
        return ModelError(
            f"{text}an unknown input can only be eliminated with an output that responds to it at "
            "once, as an accelerometer does to a force. Where the motion alone is measured that "
            f"{lacking} causes, make that motion an input of what it drives (model.input) and "
            f"leave out the balance that {lacking} acts in, or let a disturbance stand for it "
            f"in identify (--disturbance {lacking}:first)"
        )
    if not (inputs and is_stated):
        return ModelError(
            f"{text}an inertia must not be zero, and an unknown input is eliminated with an output "
            "that responds to it"
        )
    gone = " and ".join(inputs)
    return ModelError(
        f"{text}with {gone} eliminated it cancels: its balance has it in the same sum with {gone} "
        f"as the output has. Where its position is measured from what {gone} moves, such as the "
        "ground, measure it from a fixed point, with what acts there as the unknown input"
    )


def _linear_solve(matrix: Any, rhs: Any, model: str, names: list[str], n_first: int) -> Any:
    """Solve matrix @ z = rhs by symbolic Gauss elimination that keeps zeros zero.

    Pivots are judged at random points: structurally non-zero entries may vanish identically.
    """
    n = len(names)
    a = [[matrix[i, j] for j in range(n)] for i in range(n)]
    b = [rhs[i] for i in range(n)]
    size = _pivot_size(ca.symvar(ca.veccat(matrix, rhs)))
    order: list[int] = []
    borrowed: list[str] = []  # inputs solved from a balance, which then has to be made up for
    rows = list(range(n))
    for j in range(n):
        # An eliminated input is solved from its own output where that names it outright, and from
        # its balance where the output responds to it through a derivative alone.
        sizes = {i: size(a[i][j]) for i in rows}
        own = [i for i in rows if i < n_first and sizes[i] > 0.0] if j < n_first else []
        best = max(own or rows, key=sizes.__getitem__)
        if j < n_first and not own:
            borrowed.append(names[j])
        if sizes[best] == 0.0:
            stated = max(size(matrix[i, j]) for i in range(n)) > 0.0
            raise _undetermined(model, (borrowed or [names[j]])[0], names[:n_first], stated)
        rows.remove(best)
        order.append(best)
        met = [c for c in range(j + 1, n) if not a[best][c].is_zero()]
        for i in rows:
            if not a[i][j].is_zero():
                factor, a[i][j] = a[i][j] / a[best][j], ca.SX(0)
                for c in met:
                    a[i][c] = a[i][c] - factor * a[best][c]
                b[i] = b[i] - factor * b[best]
    return _back_substituted([a[i] for i in order], [b[i] for i in order])


def _pivot_size(symbols: Sequence[Any]) -> Callable[[Any], float]:
    """0 for an entry that vanishes identically; larger for one that is a simpler pivot.

    What vanishes leaves rounding errors, which beside a point are others; of an entry that does
    not, however small its unit makes it, the value there is next to the same. The points are so
    close that an entry which happens to be nearly zero at one of them is no rounding error.
    """
    rng = np.random.default_rng(7)
    points = rng.uniform(0.2, 1.7, (len(symbols), 8))
    both = ca.DM(np.hstack([points, points * (1 + 1e-10)]))
    together = ca.vertcat(*symbols)

    def size(entry: Any) -> float:
        """Rank of an entry as a pivot: constants, then short expressions; 0 if unsafe."""
        if entry.is_zero():
            return 0.0
        if entry.is_constant():
            return 2.0
        at, beside = np.array(ca.Function("v", [together], [entry])(both)).reshape(2, -1)
        if np.any(np.abs(beside - at) > 1e-3 * np.abs(at)) or not np.any(at):
            return 0.0
        return 1.0 / (1.0 + ca.n_nodes(entry))

    return size


def _back_substituted(upper: Sequence[Sequence[Any]], rhs: Sequence[Any]) -> Any:
    """The solution z (n,) of an upper triangular system, its zeros left out of the sums."""
    n = len(rhs)
    z: list[Any] = [ca.SX(0)] * n
    for j in reversed(range(n)):
        total = rhs[j]
        for c in range(j + 1, n):
            if not upper[j][c].is_zero():
                total = total - upper[j][c] * z[c]
        z[j] = total / upper[j][j]
    return ca.vertcat(*z)
