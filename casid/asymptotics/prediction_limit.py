"""Where a prediction-error estimate goes and how it varies, in the model set or not.

The limit minimises the exact variance of the prediction error, Linder (2017), (2.52), as a
nonlinear program; the covariance is P = V''^-1 Q V''^-1, (2.54)-(2.56), with the long-run
covariance Q of psi_t eps_t, so that it holds for coloured residuals and biased limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casid.asymptotics.asymptotics import Asymptotics
from casid.asymptotics.exact_field import solve
from casid.asymptotics.linear_signals import LinearSignals
from casid.asymptotics.prediction_criterion import PredictionCriterion
from casid.asymptotics.second_moments import checked_prefilter, product_covariance, settled_response
from casid.errors import ModelError, SolveError
from casid.prediction.polynomial_orders import Layout, Orders
from casid.solving.nlp import Nlp, Solver

Array = NDArray[Any]
FARTHEST = 0.9999  # of a reflection coefficient
RANDOM_STARTS = 4
_SAME = 1e-7  # relative difference of two minima that are one
_DIED_OUT = 1e-8
_NEAR = 1e-3  # scaled gradient from which Newton steps are taken
_POLISHING = 12


def prediction_error_limit(
    system: LinearSignals,
    output: str,
    inputs: Sequence[str] | Mapping[str, str],
    orders: Orders,
    truth: Mapping[str, float] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    prefilter: Any = None,
    solver: Solver | None = None,
    method: str | None = None,
) -> Asymptotics:
    """Limit and covariance of the prediction-error estimate of A y = sum (B_i/F_i) u_i + (C/D) e.

    Parameters
    ----------
    system : numbers, static or dynamic.
    output, inputs : signals of the system; inputs may be a mapping from the name that the
        coefficients carry to the signal, {"u": "measured u"}.
    orders : as in `casid.prediction.polynomial.prediction_error`; coefficients are named a1,
        b1[u], c1, d1, f1[u].
    truth : coefficient -> true value.
    start : coefficient -> value the search begins from as well.
    prefilter : L(q) of output and inputs alike, as a filter of `LinearSignals.of`.

    Returns
    -------
    Asymptotics; several starts are tried, and a note tells where some ended in a higher minimum.

    Raises
    ------
    ModelError
        If a signal or coefficient is not there, or the system has letters.
    SolveError
        If no start leads to a minimum with C and F inside the stable region.
    IdentifiabilityError
        If the minimum is no point (orders too high); the message names the direction.
    """
    if system.symbols:
        raise ModelError(
            f"a prediction-error limit needs numbers; give system.at({{..}}) for "
            f"{', '.join(map(str, system.symbols))}"
        )
    sources = dict(inputs) if isinstance(inputs, Mapping) else {name: name for name in inputs}
    layout = Layout.of(orders, list(sources))
    true = {name: float(value) for name, value in (truth or {}).items()}
    for name in (*true, *(start or {})):
        if name not in layout.names:
            raise ModelError(
                f"{name} is no coefficient of this structure; it has {', '.join(layout.names)}"
            )
    signals = (output, *sources.values())
    atoms = [(name, 0, True) for name in signals]
    names = list(dict.fromkeys(signals))
    variances = np.array(list(system.variances.values()), dtype=float)
    own = None if prefilter is None else checked_prefilter(prefilter, system)
    kurtosis = np.array([system.excess_kurtosis.get(n, 0.0) for n in system.externals])
    starts: list[Array] = []
    higher = 0
    points = 256
    reach = layout.longest_lag + layout.nc + layout.nd + sum(layout.nf)
    while points < 4 * (system.reach + reach + 1):
        points *= 2
    while True:
        G = settled_response(system, atoms, names, own, points)
        criterion = PredictionCriterion(layout, G, variances)
        starts = starts or _starts(criterion, {**true, **(start or {})})
        theta, higher_now = _minimum(criterion, starts, solver)
        higher = max(higher, higher_now)
        eps, psi = criterion.errors(theta)
        tails = np.abs(np.fft.ifft(np.concatenate([eps, psi], axis=1), axis=0))
        if tails[len(G) // 2 :].max() <= _DIED_OUT * tails.max():
            break
        points = 2 * len(G)
        if points > 2**15:
            raise SolveError(
                "the predictor at the minimum has a memory beyond 16 000 samples: a root of C or F "
                "is too near the unit circle. Lower its order"
            )
        starts = [theta]
    curvature = criterion.curvature(theta)
    what = f"orders {orders}: the minimum is no point; along it"
    eye = np.eye(layout.n)
    inverse = solve(
        curvature, eye, [f"d {n}" for n in layout.names], what, "Lower the orders, or excite more"
    )
    tiled = np.repeat(eps, layout.n, axis=1)
    Q = product_covariance(psi, tiled, variances, kurtosis)
    notes = [f"{higher} of the starts ended in a higher minimum"] if higher else []
    return Asymptotics(
        method or f"{layout.structure} of {output} on {', '.join(sources.values()) or 'nothing'}",
        layout.names,
        theta,
        inverse @ Q @ inverse.T,
        float(np.real(np.mean((eps[:, 0] * np.conj(eps[:, 0])) @ variances))),
        true,
        tuple(notes),
    )


def _starts(criterion: PredictionCriterion, given: Mapping[str, float]) -> list[Array]:
    layout = criterion.layout
    rng = np.random.default_rng(0)
    made: list[Array] = [np.zeros(layout.n)]
    if given:
        made.insert(0, np.array([given.get(n, 0.0) for n in layout.names]))
    if not layout.is_linear:
        for _ in range(RANDOM_STARTS):
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
        size = np.sqrt(np.maximum(np.diag(curvature), 1e-300))
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
