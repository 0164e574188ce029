"""Criteria of experiment design as functions of information matrices.

With the information G over (initial states, nuisance parameters, parameters of interest, misfit),
all columns whitened, and its Cholesky factor R'R = G, R upper triangular:

- the information on the last q columns, everything before them free, is S'S with S the last block
  of R (a Schur complement);
- the energy of the misfit that no parameter or initial state of the rival model explains is
  R_nn^2, n the misfit's column (the criterion of T-optimality).

Every score is the logarithm of what grows in proportion to the length of a record, so differences
of scores are ratios of energies, or of seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casid.arrays import Array
from casid.errors import DataError
from casid.experiment_design.thresholds import NUMERICS
from casid.model.expressions import parse


@dataclass(frozen=True, slots=True)
class Target:
    """The quantity scored in one comparison: a misfit energy, or a measure of the covariance.

    Attributes
    ----------
    kind : "misfit", "D", "A", "E", "function" or "each".
    interest : places of the columns of interest; -1, the misfit's own, for "misfit".
    sizes : (q,) the change of each that counts as one.
    gradient : (q,) of a function of the parameters.
    """

    kind: str
    interest: tuple[int, ...]
    sizes: tuple[float, ...] = ()
    gradient: tuple[float, ...] = ()


def score_function(n: int, target: Target, scale: Array) -> Any:
    """G / (scale scale') (n, n) -> scores (m,), logarithms of information; a CasADi function.

    Parameters
    ----------
    scale : (n,) roots of the diagonal of a typical G: the function takes what is left.
    """
    g = ca.SX.sym("G", n, n)
    interest = [i % n for i in target.interest]
    order = [i for i in range(n) if i not in interest] + interest
    a = g[order, order] + NUMERICS.ridge * ca.SX.eye(n)
    r = ca.chol(a)
    q = len(interest)
    first, own = n - q, np.asarray(scale, dtype=float)[order][n - q :]
    if target.kind == "misfit":
        scores = 2 * ca.log(r[n - 1, n - 1]) + 2 * np.log(own[-1])
    elif target.kind == "D":
        scores = 2 / q * sum(ca.log(r[i, i]) for i in range(first, n)) + 2 * np.mean(np.log(own))
    else:
        scores = _of_covariance(_inverse(r[first:, first:]), target, own)
    return ca.Function("score", [g], [ca.densify(scores)])


def _of_covariance(root: Any, target: Target, own: Array) -> Any:
    """Scores of the covariance S^-1 S^-T, by its root S^-1 (q, q) in scaled columns."""
    if target.kind == "function":
        weights = np.asarray(target.gradient) / own
        return -ca.log(ca.sumsqr(root.T @ weights))
    relative = ca.diag(1 / (own * np.asarray(target.sizes))) @ root
    q = len(own)
    if target.kind == "each":
        return -ca.log(ca.sum2(relative * relative))
    if target.kind == "A":
        return -ca.log(ca.sumsqr(relative) / q)
    power, exponent = relative @ relative.T, 1
    while exponent < NUMERICS.eigenvalue:
        power, exponent = power @ power, 2 * exponent
    return -ca.log(ca.trace(power)) / exponent


def _inverse(r: Any) -> Any:
    """Inverse of an upper triangular SX matrix (q, q), by back substitution."""
    q = r.shape[0]
    out = ca.SX.zeros(q, q)
    for j in range(q):
        for i in reversed(range(j + 1)):
            rest = sum((r[i, k] * out[k, j] for k in range(i + 1, j + 1)), ca.SX(0))
            out[i, j] = ((1.0 if i == j else 0.0) - rest) / r[i, i]
    return out


def scores(gram: Array, target: Target) -> Array:
    """(m,) scores of an information matrix (n, n); -inf where there is no information."""
    scale = np.sqrt(np.diag(gram))
    if not np.all(np.isfinite(scale)):
        return np.array([-np.inf])
    scale = np.where(scale > 0, scale, 1.0)
    found = np.asarray(score_function(len(gram), target, scale)(gram / np.outer(scale, scale)))
    return np.where(np.isfinite(found), found, -np.inf).ravel()


def covariance(gram: Array) -> Array:
    """Inverse of the information (n, n); inf on the diagonal where there is none."""
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    lost = scale == 0
    scale = np.where(lost, 1.0, scale)
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale) + np.diag(lost.astype(float)))
    root = vectors / np.sqrt(np.maximum(values, NUMERICS.ridge))
    found = (root @ root.T) / np.outer(scale, scale)
    found[lost, lost] = np.inf
    return np.asarray(found)


def gradient_of(text: str, values: Mapping[str, float]) -> dict[str, float]:
    """Parameter -> derivative of a function of parameters, given as text, at their values.

    Raises
    ------
    ModelError
        If the text is no formula of the parameters.
    DataError
        If the function does not change with them.
    """
    symbols = {n: ca.SX.sym(n) for n in values}
    expression = ca.SX(parse(text, symbols, where="the function to estimate"))
    x = ca.vertcat(*symbols.values())
    slope = ca.Function("slope", [x], [ca.densify(ca.gradient(expression, x))])
    found = np.asarray(slope(list(values.values()))).ravel()
    if not np.all(np.isfinite(found)) or not np.any(found):
        raise DataError(f"{text!r} does not change with the parameters at their values")
    return dict(zip(values, found.tolist(), strict=True))
