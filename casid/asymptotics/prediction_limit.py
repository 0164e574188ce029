"""Where a prediction-error estimate goes and how it varies, in the model set or not.

The limit minimises the exact variance of the prediction error, Linder (2017), (2.52), as a
nonlinear program; the covariance is P = V''^-1 Q V''^-1, (2.54)-(2.56), with the long-run
covariance Q of psi_t eps_t, so that it holds for coloured residuals and biased limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casid.asymptotics.asymptotics import Asymptotics
from casid.asymptotics.exact_field import solve
from casid.asymptotics.linear_signals import LinearSignals
from casid.asymptotics.prediction_criterion import PredictionCriterion, step_down, step_up
from casid.asymptotics.second_moments import product_covariance, settled_response
from casid.errors import ModelError, SolveError
from casid.prediction.polynomial_orders import Layout, Orders
from casid.solving.nlp import Nlp, Solver

Array = NDArray[Any]
FARTHEST = 0.9999  # of a reflection coefficient
RANDOM_STARTS = 4
_SAME = 1e-7  # relative difference of two minima that are one
_DIED_OUT = 1e-10


def prediction_error_limit(
    system: LinearSignals,
    output: str,
    inputs: Sequence[str] | Mapping[str, str],
    orders: Orders,
    truth: Mapping[str, float] | None = None,
    *,
    start: Mapping[str, float] | None = None,
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
    atoms = [(name, 0, False) for name in signals]
    names = list(dict.fromkeys(signals))
    variances = np.array(list(system.variances.values()), dtype=float)
    kurtosis = np.array([system.excess_kurtosis.get(n, 0.0) for n in system.externals])
    starts = _starts(layout, {**true, **(start or {})})
    higher = 0
    points = 256
    while True:
        G = settled_response(system, atoms, names, points=points)
        criterion = PredictionCriterion(layout, G, variances)
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
    curvature = _curvature(criterion, theta)
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


def _blocks(layout: Layout) -> list[tuple[int, int, bool]]:
    """First index, length, and whether it is kept stable, of each polynomial in theta."""
    sizes = [(layout.na, False), *((n, False) for n in layout.nb)]
    sizes += [(layout.nc, True), (layout.nd, False), *((n, True) for n in layout.nf)]
    made, place = [], 0
    for n, stable in sizes:
        made.append((place, n, stable))
        place += n
    return made


def _starts(layout: Layout, given: Mapping[str, float]) -> list[Array]:
    rng = np.random.default_rng(0)
    made: list[Array] = [np.zeros(layout.n)]
    if given:
        made.insert(0, np.array([given.get(n, 0.0) for n in layout.names]))
    if not layout.is_linear:
        for _ in range(RANDOM_STARTS):
            theta = np.zeros(layout.n)
            for first, n, stable in _blocks(layout):
                if stable:
                    theta[first : first + n] = step_up(list(rng.uniform(-0.9, 0.9, n)))
            made.append(theta)
    return made


def _minimum(
    criterion: PredictionCriterion, starts: Sequence[Array], solver: Solver | None
) -> tuple[Array, int]:
    """The lowest minimum over the starts, and how many ended higher."""
    layout = criterion.layout
    nlp = Nlp("prediction-error limit")
    symbols: list[Any] = []
    kept = np.zeros(layout.n, dtype=bool)
    for first, n, stable in _blocks(layout):
        kept[first : first + n] = stable
        edge = FARTHEST if stable else np.inf
        own = [
            nlp.variable(layout.names[first + i], 0.0, lower=-edge, upper=edge) for i in range(n)
        ]
        symbols += step_up(own) if stable else own
    unit = max(
        float(np.real(np.mean((abs(criterion.signals[:, 0]) ** 2) @ criterion.variances))), 1e-300
    )
    nlp.minimize(criterion.variance(ca.vertcat(*symbols)) / unit)
    compiled = nlp.compile(solver)
    found = []
    for theta in starts:
        x = theta.copy()
        for first, n, stable in _blocks(layout):
            if stable and n:
                inside = step_down(theta[first : first + n])
                x[first : first + n] = np.clip(inside, -0.99 * FARTHEST, 0.99 * FARTHEST)
        solution = compiled.solve({}, x, throw=False)
        if solution.is_converged and not (solution.at_lower or solution.at_upper):
            found.append((solution.value, solution.x))
    if not found:
        raise SolveError(
            f"{layout.structure}: no start led to a minimum with C and F stable; lower the orders, "
            "or give start={..} near the limit"
        )
    values = np.array([v for v, _ in found])
    best = found[int(np.argmin(values))][1].copy()
    for first, n, stable in _blocks(layout):
        if stable and n:
            best[first : first + n] = step_up(list(best[first : first + n]))
    higher = int(np.sum(values > values.min() * (1 + _SAME) + 1e-14))
    return best, higher


def _curvature(criterion: PredictionCriterion, theta: Array) -> Array:
    """V'' = E[psi psi'] - E[psi' eps] at theta, (n, n)."""
    x = ca.MX.sym("theta", len(theta))
    hessian, _ = ca.hessian(criterion.variance(x), x)
    return np.array(ca.Function("V2", [x], [hessian])(theta))
