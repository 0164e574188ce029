"""Where a prediction-error estimate goes and how it varies, in the model set or not.

The limit minimises the exact variance of the prediction error, Linder (2017), (2.52), as a
nonlinear program; the covariance is P = V''^-1 Q V''^-1, (2.54)-(2.56), with the long-run
covariance Q of psi_t eps_t, so that it holds for coloured residuals and biased limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypedDict, Unpack

import numpy as np

from casid.algebra.exact_field import solve
from casid.argument_types import names_wrong_types
from casid.arrays import TINY, Array
from casid.errors import ModelError, SolveError
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.prediction_criterion import PredictionCriterion
from casid.unknown_inputs.limits.second_moments import (
    checked_prefilter,
    product_covariance,
    settled_response,
)

FARTHEST = 0.9999  # of a reflection coefficient
RANDOM_STARTS = 4
_SAME = 1e-7  # relative difference of two minima that are one
_DIED_OUT = 1e-8
_NEAR = 1e-3  # scaled gradient from which Newton steps are taken
_POLISHING = 12


class SearchOptions(TypedDict, total=False):
    """How a minimum is searched, as `MinimumSearch` has it."""

    start: Mapping[str, float] | None
    solver: Solver | None
    random_starts: int


@dataclass(frozen=True, slots=True, eq=False)
class MinimumSearch:
    """How a minimum is searched, as the arguments of `prediction_error_limit`."""

    start: Mapping[str, float] | None = None
    solver: Solver | None = None
    random_starts: int = RANDOM_STARTS


@names_wrong_types(ModelError)
def prediction_error_limit(
    system: LinearSignals,
    output: str,
    inputs: Sequence[str] | Mapping[str, str],
    orders: Orders,
    truth: Mapping[str, float] | None = None,
    *,
    prefilter: Any = None,
    method: str | None = None,
    **search: Unpack[SearchOptions],
) -> Asymptotics:
    """Limit and covariance of the prediction-error estimate of A y = sum (B_i/F_i) u_i + (C/D) e.

    Parameters
    ----------
    system : numbers, static or dynamic.
    output, inputs : signals of the system; inputs may be a mapping from the name that the
        coefficients carry to the signal, {"u": "measured u"}.
    orders : as in `prediction_error`; coefficients are named a1,
        b1[u], c1, d1, f1[u].
    truth : coefficient -> true value.
    prefilter : L(q) of output and inputs alike, as a filter of `LinearSignals.of`.
    method : its name in tables; made up where not given.
    search : start, coefficient -> value the search begins from as well; solver; random_starts, how
        many beside `truth`, `start` and zero.

    Returns
    -------
    Asymptotics; several starts are tried, and a note says where some ended in a higher minimum.

    Raises
    ------
    ModelError
        If a signal or coefficient is not there, or the system has symbols.
    SolveError
        If no start leads to a minimum with C and F inside the stable region.
    IdentifiabilityError
        If the minimum is no point (orders too high); the message names the direction.
    """
    sources = dict(inputs) if isinstance(inputs, Mapping) else {name: name for name in inputs}
    found = prediction_minimum(
        system, output, sources, orders, truth, MinimumSearch(**search), prefilter
    )
    Q = product_covariance(found.psi, found.repeated_eps, found.variances, found.kurtosis)
    text = f"{found.layout.structure} of {output} on {', '.join(sources.values()) or 'nothing'}"
    return found.asymptotics(Q, method or text)


@dataclass(frozen=True, slots=True, eq=False)
class PredictionMinimum:
    """The minimum of the criterion and what is known of it there.

    Attributes
    ----------
    theta : (n,).
    eps, psi : (M, 1, ne), (M, n, ne) responses of the error and of minus its slope.
    inverse : (n, n) of the curvature.
    variances, kurtosis : (ne,) of the externals.
    """

    layout: Layout
    theta: Array
    eps: Array
    psi: Array
    inverse: Array
    variances: Array
    kurtosis: Array
    truth: Mapping[str, float]
    notes: tuple[str, ...]

    @property
    def repeated_eps(self) -> Array:
        """(M, n, ne): the error beside each slope."""
        return np.repeat(self.eps, self.layout.n, axis=1)

    def asymptotics(self, Q: Array, method: str) -> Asymptotics:
        """With the long-run covariance Q (n, n) of what moves the minimum."""
        power = (self.eps[:, 0] * np.conj(self.eps[:, 0])) @ self.variances
        return Asymptotics(
            method,
            self.layout.names,
            self.theta,
            self.inverse @ Q @ self.inverse.T,
            float(np.real(np.mean(power))),
            self.truth,
            self.notes,
        )


def prediction_minimum(
    system: LinearSignals,
    output: str,
    sources: Mapping[str, str],
    orders: Orders,
    truth: Mapping[str, float] | None,
    search: MinimumSearch,
    prefilter: Any = None,
) -> PredictionMinimum:
    """Where the criterion of `prediction_error_limit` is least; arguments and errors as there."""
    if system.symbols:
        raise ModelError(
            f"a prediction-error limit needs numbers; give system.at({{..}}) for "
            f"{', '.join(map(str, system.symbols))}"
        )
    layout = Layout.of(orders, list(sources))
    true = {name: float(value) for name, value in (truth or {}).items()}
    tried = {**true, **(search.start or {})}
    for name in tried:
        if name not in layout.names:
            raise ModelError(
                f"{name} is no coefficient of this structure; it has {', '.join(layout.names)}"
            )
    own = None if prefilter is None else checked_prefilter(prefilter, system)
    variances = np.array(list(system.variances.values()), dtype=float)
    kurtosis = np.array([system.excess_kurtosis.get(n, 0.0) for n in system.externals])
    signals = (output, *sources.values())

    def criterion(points: int) -> PredictionCriterion:
        atoms = [(name, 0, True) for name in signals]
        G = settled_response(system, atoms, list(dict.fromkeys(signals)), own, points)
        return PredictionCriterion(layout, G, variances)

    settled, theta, higher = _settled_minimum(criterion, system, layout, tried, search)
    eps, psi = settled.errors(theta)
    what = f"orders {orders}: the minimum is no point; along it"
    names = [f"d {n}" for n in layout.names]
    inverse = solve(
        settled.curvature(theta), np.eye(layout.n), names, what, "Lower the orders, or excite more"
    )
    notes = (f"{higher} of the starts ended in a higher minimum",) if higher else ()
    return PredictionMinimum(layout, theta, eps, psi, inverse, variances, kurtosis, true, notes)


def _settled_minimum(
    criterion: Callable[[int], PredictionCriterion],
    system: LinearSignals,
    layout: Layout,
    tried: Mapping[str, float],
    search: MinimumSearch,
) -> tuple[PredictionCriterion, Array, int]:
    """The criterion on a grid so fine that responses have died out, its minimum, higher minima.

    Raises
    ------
    SolveError
        If they have not within 2^14 samples.
    """
    starts: list[Array] = []
    higher = 0
    points = _first_points(system, layout)
    while True:
        at = criterion(points)
        starts = starts or _starts(at, tried, search.random_starts)
        theta, higher_now = _minimum(at, starts, search.solver)
        higher = max(higher, higher_now)
        tails = np.abs(np.fft.ifft(np.concatenate(at.errors(theta), axis=1), axis=0))
        tails = np.roll(tails, system.lead, axis=0)
        if tails[len(tails) // 2 :].max() <= _DIED_OUT * tails.max():
            return at, theta, higher
        points = 2 * len(tails)
        if points > 2**15:
            raise SolveError(
                "the predictor at the minimum has a memory beyond 16 000 samples: a root of C or F "
                "is too near the unit circle. Lower its order"
            )
        starts = [theta]


def _first_points(system: LinearSignals, layout: Layout) -> int:
    """Points of the first grid: so many that no delay is aliased."""
    reach = layout.longest_lag + layout.nc + layout.nd + sum(layout.nf)
    points = 256
    while points < 4 * (system.reach + reach + 1):
        points *= 2
    return points


def _starts(
    criterion: PredictionCriterion, given: Mapping[str, float], random_starts: int
) -> list[Array]:
    layout = criterion.layout
    rng = np.random.default_rng(0)
    made: list[Array] = [np.zeros(layout.n)]
    if given:
        made.insert(0, np.array([given.get(n, 0.0) for n in layout.names]))
    if not layout.is_linear:
        for _ in range(random_starts):
            x = np.zeros(layout.n)
            for first, n, stable in criterion.blocks():
                if stable:
                    x[first : first + n] = rng.uniform(-0.9, 0.9, n)
            made.append(criterion.theta_of(x))
    return made


def _minimum(
    criterion: PredictionCriterion, starts: Sequence[Array], solver: Solver | None
) -> tuple[Array, int]:
    """The lowest minimum over the starts, and how many ended higher."""
    layout = criterion.layout
    nlp = Nlp("prediction-error limit")
    edges = np.full(layout.n, np.inf)
    for first, n, stable in criterion.blocks():
        edges[first : first + n] = FARTHEST if stable else np.inf
    for name, edge in zip(layout.names, edges, strict=True):
        nlp.variable(name, 0.0, lower=-edge, upper=edge)
    nlp.minimize(criterion)
    found = []
    for theta in starts:
        x = np.clip(criterion.x_of(theta), -0.99 * edges, 0.99 * edges)
        solution = nlp.solve(solver, list(x), throw=False)
        if solution.scaled_gradient < _NEAR and not (solution.at_lower or solution.at_upper):
            found.append(_polished(criterion, criterion.theta_of(solution.x)))
    if not found:
        raise SolveError(
            f"{layout.structure}: no start led to a minimum with C and F stable; lower the orders, "
            "or give start={..} near the limit"
        )
    values = np.array([criterion.at(theta)[0] for theta in found])
    higher = int(np.sum(values > values.min() * (1 + _SAME) + 1e-14 * criterion.unit))
    return found[int(np.argmin(values))], higher


def _polished(criterion: PredictionCriterion, theta: Array) -> Array:
    """Newton steps with the exact curvature, while they are short and lead downhill."""
    for _ in range(_POLISHING):
        value, gradient, _ = criterion.at(theta)
        curvature = criterion.curvature(theta)
        size = np.sqrt(np.maximum(np.diag(curvature), TINY))
        scaled = curvature / np.outer(size, size)
        if np.linalg.eigvalsh(scaled).min() < 1e-9:
            return theta
        step = -np.linalg.solve(scaled, gradient / size) / size
        if criterion.at(theta + step)[0] > value * (1 + 1e-12):
            return theta
        theta = theta + step
        if np.all(np.abs(step) <= 1e-12 * (1 + np.abs(theta))):
            return theta
    return theta
