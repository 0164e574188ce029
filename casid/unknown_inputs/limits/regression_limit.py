"""Limit and asymptotic covariance of a linear regression, in one or two stages.

The estimate solves f_N = (1/N) sum zeta_t eps_t = 0, Linder (2017), (2.41) with alpha(x) = x; its
limit solves E f = 0, (2.53), and N Cov -> F^-1 Q F^-T, (2.57)-(2.59), with F = dE f/dtheta and
with the long-run covariance Q of zeta_t eps_t at the limit, residuals coloured or not. A first
stage is one more block of equations f, so that its uncertainty, and its correlation with the second
stage, are in Q and F; (3.48)-(3.50) leave them out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from casid.algebra.exact_field import null_vector, solve
from casid.argument_types import names_wrong_types
from casid.arrays import Array
from casid.errors import IdentifiabilityError, ModelError
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.linear_expressions import as_expression
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.regression import (
    FirstStage,
    Regression,
    Term,
    split_term,
    term_text,
    terms_text,
)
from casid.unknown_inputs.limits.second_moments import (
    Atom,
    SecondMoments,
    checked_prefilter,
    second_moments,
)


@names_wrong_types(ModelError)
def regression_limit(
    system: LinearSignals,
    regression: Regression,
    truth: Mapping[str, Any] | None = None,
    *,
    method: str | None = None,
) -> Asymptotics:
    """Limit, covariance and residual variance of a regression on the signals of a system.

    Parameters
    ----------
    system : static with symbols gives formulas, cancelled; with numbers, or dynamic, numbers.
    truth : coefficient -> true value (number, text, sympy), for bias and mean square error.
    method : its name in tables; made up where not given.

    Raises
    ------
    ModelError
        If a signal is not there.
    IdentifiabilityError
        If regressors or instruments are linearly dependent; the message names the combination
        that is not identifiable.

    Example
    -------
    >>> import casid
    >>> system = casid.LinearSignals.of({"u": "r + w", "y": "b*u + e"}, {"r": 1, "w": 1, "e": "l"})
    >>> print(casid.regression_limit(system, casid.Regression("y", {"b": "r"}), {"b": "b"}))
    LS of y on r
      coefficient  limit  bias  N x variance
      -----------  -----  ----  ------------
      b                b     0      b**2 + l
      residual variance b**2 + l
    """
    true = {n: as_expression(v, f"truth of {n}") for n, v in (truth or {}).items()}
    for name in true:
        if name not in regression.regressors:
            raise ModelError(
                f"truth of {name}: no coefficient of this regression, which has "
                f"{', '.join(regression.regressors)}"
            )
    equations = _Equations(system, regression)
    limit, covariance, variance = equations.solve()
    field = equations.moments.field
    if field is not None:
        limit, covariance = field.expressions(limit), field.expressions(covariance)
        variance = field.expressions(np.array([variance], dtype=object))[0]
    return Asymptotics(
        method or method_text(regression),
        tuple(regression.regressors),
        limit,
        covariance,
        variance,
        true,
    )


def method_text(regression: Regression) -> str:
    """The estimator in words."""
    way = "LS" if regression.instruments is None else "IV"
    on = terms_text(list(regression.regressors.values()))
    text = f"{way} of {term_text(regression.output)} on {on}"
    if regression.instruments is not None:
        text += f" with {terms_text(regression.instruments)}"
    return text + (", prefiltered" if regression.prefilter is not None else "")


@dataclass(frozen=True, slots=True, eq=False)
class _Form:
    """A signal a0 x + sum_p gamma_p a_p x: linear in the first-stage coefficients."""

    at_limit: Array  # (n,)
    slopes: Mapping[int, Array]  # index of gamma -> (n,)


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    """One first-stage regression: the rows of its equations."""

    first: int  # index of its first gamma
    known: Array  # (k, n)
    residual: Array  # (n,) at the limit
    normal: Array  # (k, k) E psi psi'
    is_known: bool


class _Equations:
    """The stacked estimating equations of both stages."""

    def __init__(self, system: LinearSignals, regression: Regression) -> None:
        self.regression = regression
        prefilter = regression.prefilter
        if prefilter is not None:
            prefilter = checked_prefilter(prefilter, system)
        self._filtered = prefilter is not None
        self.generated = dict(regression.generated)
        for name in self.generated:
            if name in (*system.externals, *system.names):
                raise ModelError(f"generated signal {name} is a signal of the system; rename it")
        atoms: dict[Atom, None] = {}
        for term, filtered in self._terms():
            atoms |= dict.fromkeys(self._atoms(term, filtered))
        self.moments: SecondMoments = second_moments(system, list(atoms), prefilter)
        self.stages: dict[str, _Stage] = {}
        self.gammas: dict[str, Array] = {}
        self.n_gamma = 0
        for name, stage in self.generated.items():
            self._fit(name, stage)

    # -- rows of atoms -----------------------------------------------------------------------

    def _terms(self) -> list[tuple[Term, bool]]:
        r = self.regression
        plain = [(t, False) for s in self.generated.values() for t in (s.measured, *s.known)]
        model = [(t, self._filtered) for t in (r.output, *r.regressors.values())]
        return [*plain, *model, *((t, False) for t in r.instruments or ())]

    def _atoms(self, term: Term, filtered: bool) -> list[Atom]:
        _, name, lag = split_term(term)
        if name not in self.generated:
            return [(name, lag, filtered)]
        known = [split_term(t) for t in self.generated[name].known]
        return [(n, lag + k, filtered) for _, n, k in known]

    def _row(self, term: Term, filtered: bool) -> Array:
        sign, name, lag = split_term(term)
        return self.moments.row([((name, lag, filtered), int(sign))])

    def _form(self, term: Term, filtered: bool) -> _Form:
        sign, name, lag = split_term(term)
        if name not in self.generated:
            return _Form(self._row(term, filtered), {})
        stage, gamma = self.stages[name], self.gammas[name]
        parts = [split_term(t) for t in self.generated[name].known]
        rows = [
            self.moments.row([((n, lag + k, filtered), int(sign * own))]) for own, n, k in parts
        ]
        total = sum((row * g for g, row in zip(gamma, rows, strict=True)), 0 * rows[0])
        return _Form(total, {stage.first + i: row for i, row in enumerate(rows)})

    # -- first stages ------------------------------------------------------------------------

    def _fit(self, name: str, stage: FirstStage) -> None:
        labels = [term_text(t) for t in stage.known]
        known = np.array([self._row(t, False) for t in stage.known])
        measured = self._row(stage.measured, False)
        second = self.moments.second
        normal = known @ second @ known.T
        right = (known @ second @ measured)[:, None]
        remedy = "Leave one of them out"
        gamma = solve(
            normal, right, labels, f"first stage of {name}: its signals are dependent", remedy
        )[:, 0]
        residual = measured - gamma @ known
        self.stages[name] = _Stage(self.n_gamma, known, residual, normal, stage.is_known)
        self.gammas[name] = gamma
        self.n_gamma += len(labels)

    # -- second stage ------------------------------------------------------------------------

    def solve(self) -> tuple[Array, Array, Any]:
        """Limit (d,), covariance (d, d) and residual variance."""
        r, second = self.regression, self.moments.second
        labels = [term_text(t) for t in r.regressors.values()]
        y = self._row(r.output, self._filtered)
        phi = [self._form(t, self._filtered) for t in r.regressors.values()]
        zeta = phi if r.instruments is None else self._instruments(phi)
        Phi, Zeta = (np.array([f.at_limit for f in forms]) for forms in (phi, zeta))
        names = [f"{c} ({t})" for c, t in zip(r.regressors, labels, strict=True)]
        if r.instruments is None:
            what = f"the regressors {', '.join(labels)} depend on each other, and the combination"
            what += " of coefficients along it is not identifiable"
            remedy, shown = "Leave one out, or excite the system further", labels
        else:
            shown = [f"d {name}" for name in names]
            what = "the instruments do not move the regressors apart; this change of the "
            what += "coefficients is not identifiable"
            remedy = (
                "Give instruments that reach every regressor, such as further references or lags"
            )
        left = Zeta @ second @ Phi.T
        if r.instruments is not None:
            self._require_moved(left, shown, what, remedy)
        theta = solve(left, (Zeta @ second @ y)[:, None], shown, what, remedy)[:, 0]
        residual = y - theta @ Phi
        A, B, W = self._influence(phi, zeta, Zeta, residual, theta, left)
        Q = self.moments.product_covariance(A, B)
        return theta, W @ Q @ W.T, self.moments.variance(residual)

    def _require_moved(self, left: Array, shown: list[str], what: str, remedy: str) -> None:
        """Refuse instruments with which the equations are singular: the null direction of them."""
        direction = null_vector(left)
        if direction is not None:
            moves = zip(direction, shown, strict=True)
            text = ", ".join(f"{name} = {_rounded(v)}" for v, name in moves if v != 0)
            raise IdentifiabilityError(f"{what}: {text}. {remedy}")

    def _instruments(self, phi: list[_Form]) -> list[_Form]:
        terms = list(self.regression.instruments or ())
        if len(terms) == len(phi):
            return [self._form(t, False) for t in terms]
        # More instruments than regressors: each regressor projected on all of them.
        forms = [self._form(t, False) for t in terms]
        if any(f.slopes for f in forms) or any(f.slopes for f in phi):
            raise ModelError(
                "more instruments than regressors beside a first stage; give as many instruments "
                "as regressors"
            )
        known = np.array([f.at_limit for f in forms])
        second = self.moments.second
        normal = known @ second @ known.T
        labels = [term_text(t) for t in terms]
        zeta = []
        for i, f in enumerate(phi):
            right = (known @ second @ f.at_limit)[:, None]
            gamma = solve(
                normal, right, labels, "the instruments depend on each other", "Leave one out"
            )[:, 0]
            residual = f.at_limit - gamma @ known
            self.stages[f"regressor {i}"] = _Stage(self.n_gamma, known, residual, normal, False)
            slopes = {self.n_gamma + k: row for k, row in enumerate(known)}
            self.n_gamma += len(known)
            zeta.append(_Form(gamma @ known, slopes))
        return zeta

    def _influence(
        self,
        phi: list[_Form],
        zeta: list[_Form],
        Zeta: Array,
        residual: Array,
        theta: Array,
        left: Array,
    ) -> tuple[Array, Array, Array]:
        """Products A x, B x and weights W with theta_hat - limit ~ W mean(A x * B x)."""
        second, d = self.moments.second, len(phi)
        rows_A, rows_B, blocks = [], [], []
        eye = self.moments.zeros(d, d) + np.eye(d, dtype=int)
        inverse = solve(left, eye, [str(i) for i in range(d)], "", "")
        for stage in self.stages.values():
            if stage.is_known:
                continue
            k = len(stage.known)
            slope = self.moments.zeros(d, k)  # d E[zeta eps] / d gamma
            for p in range(k):
                index = stage.first + p
                moved = self.moments.zeros(len(residual))
                for t, f in zip(theta, phi, strict=True):
                    if index in f.slopes:
                        moved = moved + f.slopes[index] * t
                slope[:, p] = -(Zeta @ second @ moved)
                for i, f in enumerate(zeta):
                    if index in f.slopes:
                        slope[i, p] += f.slopes[index] @ second @ residual
            if not np.any(slope != 0):
                continue
            labels = [str(i) for i in range(k)]
            blocks.append(inverse @ solve(stage.normal.T, slope.T, labels, "", "").T)
            rows_A.append(stage.known)
            rows_B.append(np.tile(stage.residual, (k, 1)))
        rows_A.append(Zeta)
        rows_B.append(np.tile(residual, (d, 1)))
        blocks.append(inverse)
        return np.concatenate(rows_A), np.concatenate(rows_B), np.concatenate(blocks, axis=1)


def _rounded(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
