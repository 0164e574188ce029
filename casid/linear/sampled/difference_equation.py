"""The difference equation of one output: the linear regression that identification fits.

A discretised linear model is, output by output, a matrix fraction with a diagonal denominator,

    y_t + a_1 y_{t-1} + ... + a_n y_{t-n} = sum_j (b_j0 u_j,t + ... + b_jn u_j,t-n) + error,   (1)

Linder (2017), (5.16)-(5.18). Some of its coefficients are bound to each other whatever the physical
parameters are: b_1 = 0 and b_2 = -b_0 for a rate that returns to zero. Those affine relations are
found, in exact rational arithmetic for the substitutions, and used: what remains is

    left_t = sum_i theta_i column_i,t + error,    theta = g(theta_p),                          (2)

with as few columns as the structure allows, y_t = [-y_{t-1}, -y_{t-2}, u_t - u_{t-2}] theta in
(7.35) of Linder (2017).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casid.algebra.elimination import solve
from casid.algebra.leverrier import faddeev_leverrier
from casid.arrays import Array
from casid.errors import ModelError
from casid.linear.common_denominator import parameter_vector
from casid.linear.hulls.affine_hull import AffineHull, affine_hull
from casid.linear.hulls.parameter_draws import Range
from casid.linear.linear_model import LinearModel, TransferMatrix, linearise
from casid.linear.sampled.discretisation import (
    SUBSTITUTIONS,
    check_method,
    discretise,
    matrix_of,
    substitution,
)
from casid.linear.sampled.lagged_columns import Column
from casid.linear.sampled.structural_relations import (
    common_degree,
    hold_relations,
    rational_relations,
)
from casid.model.declarations import Parameter
from casid.model.model import Model

Expr = Any  # a CasADi SX expression


@dataclass(frozen=True, eq=False)
class DifferenceEquation:
    """The regression (2) of one output, and its coefficients as functions of the parameters.

    Attributes
    ----------
    inputs : the inputs that act on this output.
    Ts, method : sample time [s], one of `casid.linear.sampled.discretisation.METHODS`.
    left : the output, plus what enters with a known coefficient.
    columns : the regressors, one for each coefficient; structural relations are used up.
    coefficients : their names: "a1", "a2", "b0[accel]", ...
    parameters : all parameters of the model, in its order.
    g : SX function, parameters (np,) -> coefficients (ntheta,).
    relations : (R, ntheta + 1), all coefficients of (1), a_0 = 1 first and then a_1 .., b_.0 ..,
        input by input, as combinations of [1, theta].
    transfer : the continuous transfer functions behind it.
    notes : what a reader should know.
    """

    name: str
    output: str
    inputs: tuple[str, ...]
    Ts: float
    method: str
    left: Column
    columns: tuple[Column, ...]
    coefficients: tuple[str, ...]
    parameters: tuple[str, ...]
    g: ca.Function
    relations: Array
    transfer: TransferMatrix
    description: tuple[Parameter, ...]
    notes: tuple[str, ...] = ()

    @property
    def order(self) -> int:
        """The largest lag."""
        return max(c.order for c in (self.left, *self.columns))

    @property
    def known(self) -> dict[str, float]:
        """The known parameters' values."""
        return {q.name: q.value for q in self.description if q.value is not None}

    def vector(self, values: Mapping[str, float] | None = None) -> Array:
        """The parameters (np,) in order; known ones have their value unless given here."""
        return parameter_vector(self.name, self.description, values or {})

    def theta(self, values: Mapping[str, float] | None = None) -> Array:
        """The coefficients (ntheta,) at these parameter values.

        Raises
        ------
        ModelError
            If a value is missing, a name unknown, or a coefficient not finite there.
        """
        theta = np.array(self.g(self.vector(values))).ravel()
        if not np.isfinite(theta).all():
            raise ModelError(
                f"{self.name}: coefficient {self.coefficients[int(np.argmin(np.isfinite(theta)))]} "
                "is not finite at these parameter values; an inertia is zero there, or a pole "
                "lies where the discretisation has none (bilinear: s = 2/Ts)"
            )
        return theta

    @cached_property
    def jacobian(self) -> ca.Function:
        """Parameters (np,) -> coefficients (ntheta,), their derivatives (ntheta, np)."""
        p = ca.SX.sym("p", len(self.parameters))
        theta = self.g(p)
        return ca.Function("jacobian", [p], [theta, ca.densify(ca.jacobian(theta, p))])

    def constraints(
        self,
        free: Sequence[str] | str,
        values: Mapping[str, float] | None = None,
        *,
        ranges: Mapping[str, Range] | None = None,
    ) -> AffineHull:
        """The linear constraints B theta = b that hold for every value of the free parameters.

        Parameters
        ----------
        free : names of the parameters that vary.
        values : the other parameters' values; a known one has its own unless given here. A free one
            varies about the value given here, its own, or its start.
        ranges : name -> (low, high) for the draws of a free parameter, see `casid.affine_hull`.

        Raises
        ------
        ModelError, IdentifiabilityError
            As `casid.affine_hull`.
        """
        free = (free,) if isinstance(free, str) else tuple(free)
        centres = {q.name: q.start for q in self.description if q.name in free}
        return affine_hull(
            self.g,
            self.parameters,
            centres | self.known | dict(values or {}),
            free,
            ranges=ranges,
            coefficients=self.coefficients,
        )

    def polynomials(self, theta: Array) -> tuple[Array, dict[str, Array]]:
        """All coefficients of (1) from the reduced ones.

        Returns
        -------
        a (n+1,), a_0 = 1, and for each input b (n+1,), ascending powers of q^-1.
        """
        full = self.relations @ np.concatenate([[1.0], self._checked(theta)])
        parts = full.reshape(1 + len(self.inputs), -1)
        return parts[0], dict(zip(self.inputs, parts[1:], strict=True))

    def continuous(self, theta: Array) -> tuple[Array, dict[str, Array]]:
        """The continuous transfer functions with these discrete coefficients: (7.36).

        Returns
        -------
        Denominator (n+1,), monic, and for each input the numerator (n+1,), descending powers of s.

        Raises
        ------
        ModelError
            If no continuous system has these coefficients: a pole of the discrete system where the
            substitution has s = infinity, or, for a hold, at 0 or on the negative real axis.

        Notes
        -----
        Exact for the substitutions. For "zoh" and "foh" it takes a matrix logarithm and its
        principal branch: right if all poles are slower than the Nyquist frequency.
        """
        a, b = self.polynomials(theta)
        if self.method in SUBSTITUTIONS:
            h = _inverse_substitution(len(a) - 1, self.Ts, self.method)
            rows = np.array([a, *b.values()]) @ h
        else:
            rows = _unheld(self.name, np.array([a, *b.values()]), self.Ts, self.method)
        lead = rows[0, 0]
        if abs(lead) <= 1e-14 * np.abs(rows[0]).max():
            raise ModelError(
                f"{self.name}: no continuous system of order {len(a) - 1} has these coefficients "
                f"under {self.method}; take another method, or a model of lower order"
            )
        rows = rows / lead
        for row, b in zip(rows[1:], self._numerators(), strict=True):
            row[_vanishing(b)] = 0.0
        return rows[0], dict(zip(self.inputs, rows[1:], strict=True))

    def poles(self, theta: Array) -> Array:
        """The discrete poles, (n,) complex."""
        return np.asarray(np.roots(self.polynomials(theta)[0]), dtype=complex)

    def _numerators(self) -> list[Expr]:
        return [self.transfer.numerators[0][self.transfer.inputs.index(u)] for u in self.inputs]

    def _checked(self, theta: Array) -> Array:
        theta = np.asarray(theta, dtype=float).ravel()
        if len(theta) != len(self.coefficients):
            raise ModelError(
                f"{self.name}: {len(theta)} coefficients given for {len(self.coefficients)}; "
                f"they are {', '.join(self.coefficients)}"
            )
        return theta

    def __repr__(self) -> str:
        return (
            f"<DifferenceEquation {self.output} from {', '.join(self.inputs) or 'itself'}: "
            f"{', '.join(self.coefficients)}; {self.method}, Ts = {self.Ts:g} s>"
        )

    def __str__(self) -> str:
        terms = [f"{n} ({c.name})" for n, c in zip(self.coefficients, self.columns, strict=True)]
        lines = [repr(self), f"  {self.left.name} = {' + '.join(terms) or '0'} + error"]
        return "\n".join([*lines, *(f"  note: {n}" for n in self.notes)])


def difference_equation(
    model: Model | LinearModel, output: str, Ts: float, *, method: str = "bilinear"
) -> DifferenceEquation:
    """The difference equation of one output of a linear model; a nonlinear one is linearised at 0.

    Parameters
    ----------
    model : a model, or what `linear_model.linearise` made of it about another equilibrium; the
        signals are deviations from that then.
    Ts : sample time [s].
    method : "bilinear", "forward", "backward" (substitutions), "zoh" or "foh" (exact holds).

    Raises
    ------
    ModelError
        As `linearise` and `discretise`, or if the output depends on no state and no input.
    """
    check_method(method, Ts)
    linear = model if isinstance(model, LinearModel) else linearise(model)
    transfer = linear.transfer(output)
    driven = [j for j, b in enumerate(transfer.numerators[0]) if b.nnz()]
    inputs = tuple(transfer.inputs[j] for j in driven)
    if not inputs and transfer.order == 0:
        raise ModelError(
            f"{linear.name}: output {output} depends on no input and no state, so there is nothing "
            "to fit; check its expression"
        )
    polynomials = [transfer.denominator, *(transfer.numerators[0][j] for j in driven)]
    discrete = discretise(transfer, Ts, method)
    if method in SUBSTITUTIONS:
        relations, independent = rational_relations(polynomials, transfer.p, Ts, method)
        theta = _substituted_theta(polynomials, independent, Ts, method)
    else:
        relations, independent = hold_relations(transfer, driven, Ts, method, discrete)
        every = [discrete.denominator, *(discrete.numerators[0][j] for j in driven)]
        flat = [e for b in every for e in ca.vertsplit(b)]
        theta = [flat[i] for i in independent[1:]]
    lags = range(transfer.order + 1)
    names = [*(f"a{k}" for k in lags), *(f"b{k}[{u}]" for u in inputs for k in lags)]
    # The taps of (1) moved to the left: y_t + sum a y - sum b u.
    taps = [(output, k, 1.0) for k in lags] + [(u, k, -1.0) for u in inputs for k in lags]
    notes = [*linear.notes, *_stability_note(transfer, discrete, method)]
    notes += _common_factor_note(polynomials, transfer.p, output) if inputs else []
    theta_p = [ca.densify(ca.vertcat(*theta))]
    return DifferenceEquation(
        name=f"{linear.name}, {output}",
        output=output,
        inputs=inputs,
        Ts=float(Ts),
        method=method,
        left=_combined(taps, relations[:, 0]),
        columns=tuple(_combined(taps, -relations[:, i]) for i in range(1, relations.shape[1])),
        coefficients=tuple(names[i] for i in independent[1:]),
        parameters=transfer.parameters,
        g=ca.Function("g", [transfer.p], theta_p, ["theta_p"], ["theta"], {"cse": True}),
        relations=relations,
        transfer=transfer,
        description=transfer.description,
        notes=tuple(notes),
    )


# -- inside ------------------------------------------------------------------------------------


def _substituted_theta(
    polynomials: Sequence[Expr], independent: list[int], Ts: float, method: str
) -> list[Expr]:
    """The independent coefficients, each divided by the first."""
    n = polynomials[0].numel() - 1
    K = matrix_of(substitution(n, Fraction(repr(float(Ts))), method))
    images = [K.T @ b for b in polynomials]
    flat = [b[k] for b in images for k in range(n + 1)]
    return [flat[i] / flat[0] for i in independent[1:]]


def _vanishing(column: Expr) -> Array:
    """True at the structural zeros of an SX column."""
    return np.asarray(ca.DM(column.sparsity(), 1.0).full().ravel() == 0.0)


def _combined(taps: Sequence[tuple[str, int, float]], weights: Array) -> Column:
    """A column with these taps, each weighted, named as it is written."""
    kept = [(c, k, s * float(w)) for (c, k, s), w in zip(taps, weights, strict=True) if w != 0.0]
    text = ""
    for channel, lag, weight in kept:
        size = "" if abs(weight) == 1.0 else f"{abs(weight):.6g} "
        sign = "-" if weight < 0 else "+"
        text += f" {sign} " if text else ("-" if weight < 0 else "")
        text += f"{size}{channel}[t-{lag}]" if lag else f"{size}{channel}[t]"
    return Column(text, tuple(kept))


def _common_factor_note(polynomials: Sequence[Expr], p: Expr, output: str) -> list[str]:
    shared = common_degree(polynomials, p)
    return [
        f"numerators and denominator share a factor of degree {shared} for all parameters, so "
        f"noise-free columns are collinear; drop {shared} state(s) that {output} does not need"
    ] * (shared > 0)


def _stability_note(transfer: TransferMatrix, discrete: Any, method: str) -> list[str]:
    """A note where forward Euler makes a stable system unstable at the nominal parameters."""
    if method != "forward":
        return []
    nominal = transfer.nominal()
    continuous = np.roots(np.array(transfer.function.call([nominal])[0]).ravel())
    poles = np.roots(np.array(discrete.function.call([nominal])[0]).ravel())
    if not len(poles) or not np.isfinite(poles).all() or continuous.real.max() >= 0:
        return []
    if np.abs(poles).max() <= 1.0:
        return []
    needed = float(np.min(-2.0 * continuous.real / np.abs(continuous) ** 2))
    return [
        f"forward Euler is unstable at the start values, a pole at {np.abs(poles).max():.4g} "
        f"although the model is stable; sample faster than {needed:.3g} s or use bilinear"
    ]


def _inverse_substitution(n: int, Ts: float, method: str) -> Array:
    """The inverse of `substitution`, (n+1, n+1), computed exactly."""
    K = substitution(n, Fraction(repr(float(Ts))), method)
    eye = [[Fraction(int(i == j)) for j in range(n + 1)] for i in range(n + 1)]
    return np.array([[float(v) for v in row] for row in solve(K, eye) or ()])


def _unheld(name: str, rows: Array, Ts: float, method: str) -> Array:
    """Continuous polynomials (1 + nu, n+1) of discrete ones, by the matrix logarithm."""
    from scipy.linalg import expm, logm

    n = rows.shape[1] - 1
    a, b = rows[0], rows[1:]
    if n == 0:
        return rows
    phi = np.zeros((n, n))
    phi[:, 0] = -a[1:]
    phi[: n - 1, 1:] = np.eye(n - 1)
    poles = np.linalg.eigvals(phi)
    bad = poles[(np.abs(poles) < 1e-12) | ((poles.real < 0) & (np.abs(poles.imag) < 1e-12))]
    if len(bad):
        raise ModelError(
            f"{name}: a discrete pole lies at {bad[0].real:.4g}, which no real continuous system "
            f"under {method} has; use method='bilinear', or a model of lower order"
        )
    A = np.real(logm(phi))
    eye, zero = np.eye(n), np.zeros((n, n))
    block = np.block([[A, eye, zero], [zero, zero, eye], [zero, zero, zero]])
    e = expm(block)
    g1, g2 = e[:n, n : 2 * n], e[:n, 2 * n :]
    if method == "zoh":
        g2 = zero
    inward = b[:, 1:].T - np.outer(a[1:], b[:, 0])  # (n, nu), with D = b[:, 0]
    B = np.linalg.solve(g1 - g2 + phi @ g2, inward)
    D = b[:, 0] - (g2 @ B)[0]
    denominator, adjugate = faddeev_leverrier(A, eye, 1.0, np.trace)
    numerators = [D * denominator[0]]
    numerators += [(M @ B)[0] + c * D for M, c in zip(adjugate, denominator[1:], strict=True)]
    scale = Ts ** -np.arange(n + 1.0)
    return np.asarray(np.real(np.vstack([denominator, np.array(numerators).T])) * scale)
