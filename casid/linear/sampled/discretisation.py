"""Transfer functions in q^-1, as expressions of the physical parameters.

Bilinear transform and the two Euler methods substitute a fraction of degree one for s (Ts = T):

    bilinear  s = (2/T) (1 - x)/(1 + x),   forward  s = (1 - x)/(T x),   backward  s = (1 - x)/T

with x = q^-1. The exact holds sample the continuous response to inputs that are constant ("zoh")
or straight lines ("foh") between samples; their matrix exponential is a Pade approximant with
scaling and squaring in CasADi expressions, so that coefficients can be differentiated, too.

Source: Linder (2017), (5.15)-(5.17); Astrom and Wittenmark, Computer-Controlled Systems (1997).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from numbers import Real
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import ModelError, nearest
from casid.linear.common_denominator import CommonDenominator
from casid.linear.linear_model import (
    LinearModel,
    TransferMatrix,
    adjugate_polynomials,
)

Expr = Any  # a CasADi SX expression

METHODS = ("bilinear", "forward", "backward", "zoh", "foh")
SUBSTITUTIONS = ("bilinear", "forward", "backward")

# Pade [7/7]: rounding error only while the norm of A T / 2^squarings is below 0.95
# (Higham 2005, The scaling and squaring method for the matrix exponential revisited, table 2.3).
_PADE = (17297280.0, 8648640.0, 1995840.0, 277200.0, 25200.0, 1512.0, 56.0, 1.0)
_PADE_NORM = 0.95
_MARGIN = 4.0  # how much faster than at the nominal parameters the system may get


@dataclass(frozen=True, eq=False, kw_only=True)
class DiscreteTransfer(CommonDenominator):
    """Transfer functions in x = q^-1 with a common denominator, functions of the parameters.

    Attributes
    ----------
    denominator : (n+1,) SX, ascending powers of q^-1, the first entry 1.
    numerators : [output][input] -> (n+1,) SX, ascending powers of q^-1.
    """

    Ts: float
    method: str

    def poles(self, values: Mapping[str, float] | None = None) -> Array:
        """The poles in the q plane, (n,) complex."""
        return np.asarray(np.roots(self.evaluate(values)[0]), dtype=complex)

    def __repr__(self) -> str:
        return (
            f"<DiscreteTransfer {self.name}: {', '.join(self.outputs)} from "
            f"{', '.join(self.inputs) or 'nothing'}, order {self.order}, {self.method}, "
            f"Ts = {self.Ts:g} s>"
        )


def discretise(
    system: LinearModel | TransferMatrix, Ts: float, method: str = "bilinear"
) -> DiscreteTransfer:
    """Discretise a linear model, or transfer functions that need not be proper.

    Parameters
    ----------
    Ts : sample time [s].
    method : one of `METHODS`.

    Raises
    ------
    ModelError
        For an unknown method, a sample time that is not positive, or an improper transfer function
        with a method that cannot take it (forward Euler, the holds).

    Notes
    -----
    The substitutions are rational in the parameters. The holds are exact to rounding where no
    pole is more than 4 times as fast as at the parameters' nominal values.
    """
    check_method(method, Ts)
    transfer = system.transfer() if isinstance(system, LinearModel) else system
    if method in SUBSTITUTIONS:
        denominator, numerators = _substituted(transfer, Ts, method)
    else:
        denominator, numerators = _held(transfer, Ts, method)
    return DiscreteTransfer(
        name=transfer.name,
        Ts=Ts,
        method=method,
        denominator=denominator,
        numerators=numerators,
        p=transfer.p,
        inputs=transfer.inputs,
        outputs=transfer.outputs,
        parameters=transfer.parameters,
        description=transfer.description,
    )


def check_method(method: str, Ts: Any) -> None:
    """Refuse a method that does not exist, or a sample time that is not a positive number."""
    if method not in METHODS:
        raise ModelError(f"there is no discretisation {method!r}{nearest(method, METHODS)}")
    is_number = isinstance(Ts, Real) or (isinstance(Ts, np.ndarray) and Ts.ndim == 0)
    if not (is_number and math.isfinite(Ts) and Ts > 0.0):
        raise ModelError(f"the sample time is {Ts!r}; give a positive number of seconds, as 0.01")


def substitution(n: int, Ts: Any, method: str) -> list[list[Any]]:
    """The matrix K (n+1, n+1) of a substitution on polynomials of degree n, exact.

    `Ts` is a Fraction or a sympy symbol, and so are the entries.

    sum_k d_k s^(n-k), multiplied by a power of T (1 + x) or T x, is sum_j (d K)_j x^j:
    row k of K holds the coefficients of h^k (1 - x)^(n-k) e(x)^k, with h = T/2 and e = 1 + x for
    the bilinear transform, h = T and e = x (forward) or 1 (backward).
    """
    h = Ts / 2 if method == "bilinear" else Ts
    e = {"bilinear": [1, 1], "forward": [0, 1], "backward": [1, 0]}[method]
    rows = []
    for k in range(n + 1):
        row = [1]
        for factor in [[1, -1]] * (n - k) + [e] * k:
            row = [
                (row[i] if i < len(row) else 0) * factor[0] + (row[i - 1] if i else 0) * factor[1]
                for i in range(len(row) + 1)
            ]
        rows.append([h**k * c for c in row[: n + 1]])
    return rows


def pade_exponential(A: Expr, squarings: int) -> Expr:
    """exp(A) of a square SX matrix, by the [7/7] Pade approximant of A / 2^squarings."""
    n = A.size1()
    scaled = A / 2.0**squarings
    eye = ca.SX.eye(n)
    b = _PADE
    A2 = scaled @ scaled
    A4 = A2 @ A2
    A6 = A4 @ A2
    odd = scaled @ (b[7] * A6 + b[5] * A4 + b[3] * A2 + b[1] * eye)
    even = b[6] * A6 + b[4] * A4 + b[2] * A2 + b[0] * eye
    result = _eliminated(even - odd, even + odd)
    for _ in range(squarings):
        result = result @ result
    return result


def hold_matrices(A: Expr, squarings: int, method: str) -> tuple[Expr, Expr, Expr]:
    """Phi = exp(A), and G1, G2 with x+ = Phi x + (G1 - G2) B u + G2 B u+ for A, B times Ts.

    G1 is the integral of exp(A s) over one sample; G2 = 0 for "zoh" and the integral of
    exp(A s) (1 - s) for "foh" (C. F. Van Loan, 1978, Computing integrals involving the matrix
    exponential).
    """
    n = A.size1()
    eye, zero = ca.SX.eye(n), ca.SX(n, n)
    if method == "zoh":
        block = ca.blockcat([[A, eye], [zero, zero]])
        e = pade_exponential(block, squarings)
        return e[:n, :n], e[:n, n:], zero
    block = ca.blockcat([[A, eye, zero], [zero, zero, eye], [zero, zero, zero]])
    e = pade_exponential(block, squarings)
    return e[:n, :n], e[:n, n : 2 * n], e[:n, 2 * n :]


# -- inside ------------------------------------------------------------------------------------


def _substituted(
    transfer: TransferMatrix, Ts: float, method: str
) -> tuple[Expr, tuple[tuple[Expr, ...], ...]]:
    if method == "forward":
        _require_proper(transfer, "forward Euler")
    longest = [b.numel() for row in transfer.numerators for b in row]
    n = max([transfer.denominator.numel(), *longest]) - 1
    K = matrix_of(substitution(n, Fraction(repr(float(Ts))), method))

    def image(polynomial: Expr) -> Expr:
        padded = ca.SX(n + 1, 1)
        padded[n + 1 - polynomial.numel() :] = polynomial
        return ca.sparsify(K.T @ padded)

    denominator = image(transfer.denominator)
    lead = denominator[0]
    return denominator / lead, tuple(
        tuple(image(b) / lead for b in row) for row in transfer.numerators
    )


def _held(
    transfer: TransferMatrix, Ts: float, method: str
) -> tuple[Expr, tuple[tuple[Expr, ...], ...]]:
    """Every transfer function realised on one companion matrix, states in units of Ts^k."""
    _require_proper(transfer, f"an exact hold ({method})")
    n, nu = transfer.order, len(transfer.inputs)
    flat = [b[b.numel() - 1 - n :] for row in transfer.numerators for b in row]
    a = transfer.denominator
    A, B, D = ca.SX(n, n), ca.SX(n, len(flat)), ca.SX(1, len(flat))
    for k in range(1, n + 1):
        A[k - 1, 0] = -a[k] * Ts**k
        if k < n:
            A[k - 1, k] = 1.0
        for j, b in enumerate(flat):
            B[k - 1, j] = (b[k] - a[k] * b[0]) * Ts**k
    for j, b in enumerate(flat):
        D[0, j] = b[0]
    if n == 0:
        return ca.SX(1), tuple(tuple(row) for row in transfer.numerators)
    A, B, D = ca.sparsify(A), ca.sparsify(B), ca.sparsify(D)
    phi, g1, g2 = hold_matrices(A, _squarings(transfer, Ts), method)
    # The state minus G2 B u has no u+ in it: y = C z + (D + C G2 B) u.
    B_now = (g1 - g2 + phi @ g2) @ B
    D = D + g2[0, :] @ B
    denominator, adjugate = adjugate_polynomials(phi)
    rows = [denominator[0] * D] + [
        adjugate[k - 1][0, :] @ B_now + denominator[k] * D for k in range(1, n + 1)
    ]
    table = ca.vertcat(*rows)
    columns = [table[:, j] for j in range(len(flat))]
    ny = len(transfer.outputs)
    return denominator, tuple(tuple(columns[i * nu : (i + 1) * nu]) for i in range(ny))


def _require_proper(transfer: TransferMatrix, what: str) -> None:
    if not transfer.is_proper:
        raise ModelError(
            f"{transfer.name}: a transfer function to {', '.join(transfer.outputs)} is improper "
            f"(it differentiates its input), which {what} cannot discretise; use bilinear or "
            "backward, or take the derivative of that input as the input"
        )


def _squarings(transfer: TransferMatrix, Ts: float) -> int:
    """How often to square: the fastest pole times Ts near the nominal parameters, with a margin."""
    nominal = transfer.nominal()
    rng = np.random.default_rng(4)
    speeds = []
    for k in range(5):
        factor = np.exp(rng.uniform(-0.7, 0.7, transfer.p.numel())) if k else 1.0
        point = nominal * factor if len(nominal) else rng.uniform(0.2, 1.7, transfer.p.numel())
        a = np.array(transfer.function.call([point])[0]).ravel()
        if np.isfinite(a).all():
            speeds.append(float(np.abs(np.roots(a)).max(initial=0.0)) * Ts)
    # A balanced companion matrix has about twice the norm of its fastest pole.
    norm = 2.0 * _MARGIN * max(speeds, default=1.0)
    return max(0, math.ceil(math.log2(max(norm, 1e-9) / _PADE_NORM)))


def matrix_of(rows: Sequence[Sequence[Fraction]]) -> Any:
    """A sparse CasADi matrix of fractions, structural zeros where they are 0."""
    return ca.sparsify(ca.DM([[float(c) for c in row] for row in rows]))


def _eliminated(matrix: Expr, rhs: Expr) -> Expr:
    """Solve matrix @ z = rhs by Gauss elimination without pivoting: matrix is near a multiple of 1.

    CasADi's own symbolic solve takes a QR decomposition, several times the operations.
    """
    n = matrix.size1()
    a = ca.SX(ca.horzcat(matrix, rhs))
    for j in range(n):
        row = a[j, :] / a[j, j]
        a[j, :] = row
        for i in range(n):
            if i != j and a[i, j].nnz():
                a[i, :] = a[i, :] - a[i, j] * row
    return ca.sparsify(a[:, n:])
