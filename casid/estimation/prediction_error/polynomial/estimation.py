"""Prediction-error estimation of A y = sum_i (B_i/F_i) u_i + (C/D) e.

The criterion 1/2 sum eps^2 (Linder 2017, (2.36)-(2.38)) is an NLP in the coefficients alone,
whatever the number of samples. ARX is linear and solved in closed form. The predictor (2.19)
divides by C and F: the search stays where both are stable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casid.arrays import TINY, Array
from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError
from casid.estimation.covariance import sandwich
from casid.estimation.nlp.nlp import Nlp
from casid.estimation.nlp.solution import Solution
from casid.estimation.nlp.solver import Solver, as_solver
from casid.estimation.prediction_error.polynomial.criterion import PredictionErrors
from casid.estimation.prediction_error.polynomial.excitation import (
    dependent_columns,
    require_excitation,
)
from casid.estimation.prediction_error.polynomial.misfit import Misfit, residual_input_correlation
from casid.estimation.prediction_error.polynomial.model import PolynomialModel, Search
from casid.estimation.prediction_error.polynomial.notes import (
    NEAR,
    at_circle,
    doubts,
    failure,
    long_transients,
    offsets,
)
from casid.estimation.prediction_error.polynomial.orders import (
    Layout,
    Orders,
    PerInput,
    is_whole,
    settling,
)
from casid.estimation.prediction_error.polynomial.records import records_of
from casid.estimation.prediction_error.polynomial.settings import (
    ASSUMES,
    Errors,
    PolynomialSettings,
)
from casid.estimation.prediction_error.polynomial.start_values import Candidate, Data, candidates

CANCEL = 0.5  # of scaled information, in samples: with less, roots may cancel by accident
NO_NOISE = 1e-24  # of the power of y: the rest is rounding


@dataclass(frozen=True, slots=True, eq=False)
class Units:
    """What the data were divided by before solving."""

    y: float
    factors: Array  # (n,), theta = factors * (theta of the scaled data)


def prediction_error(
    y: ArrayLike | Sequence[ArrayLike],
    u: Any,
    orders: Orders,
    settings: PolynomialSettings | None = None,
    **options: Any,
) -> PolynomialModel:
    """Estimate a polynomial model by minimising the one-step prediction error.

    Parameters
    ----------
    y : (N,) array, or a list of them, one for each record
        Records share the coefficients; each starts from its own rest. Means are to be taken off
        beforehand (or an input of ones be given).
    u : None, (N,) array, (N, nu) array, or mapping from input to (N,); a list of these for a list
        of records. Inputs without a name are called "u", or "u1", "u2", ...
    orders : Orders
    settings, options : fields of `PolynomialSettings`, together or by name.

    Raises
    ------
    DataError
        If shapes differ, samples are not finite, or too few.
    ModelError
        If an order is negative or does not fit the inputs.
    IdentifiabilityError
        If the inputs do not excite all coefficients: names the direction.
    SolveError
        If no optimum is reached, or it lies where the predictor is not stable.

    Notes
    -----
    Consistent in open and closed loop if the true system is in the model set; with G alone in it
    (OE, a wrong noise model) in open loop only (Ljung 1999, sections 8.4 and 13.4).

    Example
    -------
    >>> import numpy as np
    >>> from casid import Orders
    >>> from casid.estimation.prediction_error.polynomial.estimation import prediction_error
    >>> rng = np.random.default_rng(3)
    >>> u, y = rng.normal(size=500), np.zeros(500)
    >>> for t in range(1, 500):
    ...     y[t] = 0.8 * y[t - 1] + 0.5 * u[t - 1]
    >>> model = prediction_error(y + 0.1 * rng.normal(size=500), u, Orders(nb=1, nf=1))
    >>> model.structure, round(model["f1[u]"], 1), round(model["b1[u]"], 1)
    ('OE', -0.8, 0.5)
    """
    s = replace(settings or PolynomialSettings(), **options)
    raw, inputs = records_of(y, u)
    layout = Layout.of(orders, inputs)
    if layout.n == 0:
        raise ModelError("every order is 0: nothing to estimate; give at least one above 0")
    solver = None if s.solver is None else as_solver(s.solver)
    _refuse_short(raw, layout, s.discard)
    data, units = _near_one(raw, layout)
    counts = [nb + nf for nb, nf in zip(layout.nb, layout.nf, strict=True)]
    require_excitation(
        raw,
        {i: (k, c) for i, k, c in zip(inputs, layout.nk, counts, strict=True)},
        "B and F need" if any(layout.nf) else "B needs",
    )
    if layout.is_linear and solver is None:
        criterion = PredictionErrors(
            layout, data, _discards(data, layout, np.zeros(layout.n), s.discard)
        )
        best = _closed_form(criterion)
        return _model(criterion, data, best, units, s, "none needed", offsets(raw))
    points = candidates(data, layout) if s.start is None else [_given(s.start, layout, units)]
    criterion = PredictionErrors(layout, data, _discards(data, layout, points[0][1], s.discard))
    best, label, notes = _best(criterion, points, solver)
    if s.throw and not best.is_converged:
        raise SolveError(failure(layout, best))
    notes = (*notes, *offsets(raw))
    if s.discard is None:
        notes = (*notes, *long_transients(layout, best.x, raw, criterion.discard))
    return _model(criterion, data, best, units, s, label, notes)


def arx(
    y: Any, u: Any = None, *, na: int, nb: PerInput = 0, nk: PerInput = 1, **options: Any
) -> PolynomialModel:
    """A y = B u + e by least squares (Linder 2017, (2.39)); options as `prediction_error`."""
    return prediction_error(y, u, Orders(na=na, nb=nb, nk=nk), **options)


def armax(
    y: Any, u: Any, *, na: int, nb: PerInput, nc: int, nk: PerInput = 1, **options: Any
) -> PolynomialModel:
    """A y = B u + C e by prediction error; options as `prediction_error`."""
    return prediction_error(y, u, Orders(na=na, nb=nb, nc=nc, nk=nk), **options)


def oe(
    y: Any, u: Any, *, nb: PerInput, nf: PerInput, nk: PerInput = 1, **options: Any
) -> PolynomialModel:
    """Output error, y = (B/F) u + e, by prediction error; options as `prediction_error`."""
    return prediction_error(y, u, Orders(nb=nb, nf=nf, nk=nk), **options)


def bj(
    y: Any,
    u: Any,
    *,
    nb: PerInput,
    nc: int,
    nd: int,
    nf: PerInput,
    nk: PerInput = 1,
    **options: Any,
) -> PolynomialModel:
    """Box-Jenkins, y = (B/F) u + (C/D) e, by prediction error; options as `prediction_error`."""
    return prediction_error(y, u, Orders(nb=nb, nc=nc, nd=nd, nf=nf, nk=nk), **options)


# -- data ---------------------------------------------------------------------------------------


def _refuse_short(data: Data, layout: Layout, discard: Any) -> None:
    first = layout.longest_lag if discard is None else discard
    if not is_whole(first):
        raise DataError(
            f"discard = {discard!r}; give the whole number of first samples that do not count"
        )
    for k, (y, _) in enumerate(data):
        where = f"record {k + 1}: " if len(data) > 1 else ""
        if len(y) <= max(first, layout.longest_lag):
            raise DataError(
                f"{where}{len(y)} samples, but the predictor reaches back {layout.longest_lag} and "
                f"the first {first} do not count; leave the record out, or lower the orders"
            )
        if not np.any(y != y[0]):
            raise DataError(
                f"{where}y is constant ({y[0]:g}); there is nothing to fit. Check the channel's "
                "cable and mapping, or leave the record out"
            )
    left = sum(len(y) - first for y, _ in data)
    if left <= layout.n:
        raise DataError(
            f"{left} residuals are too few for {layout.n} coefficients; give longer records or "
            "lower the orders"
        )


def _near_one(data: Data, layout: Layout) -> tuple[Data, Units]:
    """Signals of size near one, and the units taken out: powers of two, so no digit is lost."""

    def unit(parts: list[Array]) -> float:
        power = sum(float(p @ p) for p in parts) / sum(len(p) for p in parts)
        return float(2.0 ** round(np.log2(power) / 2)) if power > 0 else 1.0

    of_y = unit([y for y, _ in data])
    of_u = {i: unit([u[i] for _, u in data]) for i in layout.inputs}
    scaled = [(y / of_y, {i: u[i] / of_u[i] for i in layout.inputs}) for y, u in data]
    factors = np.ones(layout.n)
    place = layout.na
    for i, nb in zip(layout.inputs, layout.nb, strict=True):
        factors[place : place + nb] = of_y / of_u[i]
        place += nb
    return scaled, Units(of_y, factors)


def _discards(data: Data, layout: Layout, theta: Array, wanted: int | None) -> list[int]:
    if wanted is not None:
        return [wanted] * len(data)
    p = layout.split(theta)
    settle = settling(p.C, *p.F)
    return [layout.longest_lag + min(settle, (len(y) - layout.longest_lag) // 5) for y, _ in data]


# -- solving ------------------------------------------------------------------------------------


def _given(start: PolynomialModel, layout: Layout, units: Units) -> Candidate:
    if not isinstance(start, PolynomialModel):
        raise ModelError(
            f"start is a {type(start).__name__}; give a model as prediction_error returned it"
        )
    if start.names != layout.names or tuple(start.nk.values()) != layout.nk:
        raise ModelError(
            f"start has the coefficients {', '.join(start.names)}, the orders need "
            f"{', '.join(layout.names)}; give a model of the same orders and inputs"
        )
    return "the model given", np.array(start.theta) / units.factors, ()


def _best(
    criterion: PredictionErrors, points: list[Candidate], solver: Solver | None
) -> tuple[Solution, str, tuple[str, ...]]:
    """The optimum reached from the best start; from the next ones where that fails."""
    values = [criterion.evaluate(theta).value for _, theta, _ in points]
    order = [i for i in np.argsort(values).tolist() if np.isfinite(values[i])]
    if not order:
        raise SolveError(
            f"{criterion.layout.structure}: the criterion is not finite at any start value; look "
            "for outliers in y and u, or give start="
        )
    tried: list[tuple[Solution, int]] = []
    for i in order[:4]:
        tried.append((_minimise(criterion, points[i][1], solver), i))
        least = float(_information(tried[-1][0])[0][0])
        if tried[-1][0].is_converged and least * criterion.N > CANCEL:
            break
    best, chosen = min(tried, key=lambda item: (not item[0].is_converged, item[0].value))
    label, _, notes = points[chosen]
    lower = [s for s, _ in tried if s.value < best.value and not s.is_converged]
    if lower:
        name, radius = at_circle(criterion.layout, min(lower, key=lambda s: s.value).x)
        gain = 1 - min(s.value for s in lower) / best.value
        notes = (
            *notes,
            f"another start went to a root of {name} of modulus {radius:.6f} with a loss lower by "
            f"{100 * gain:.2g} %: the optimum given is a local one",
        )
    return best, label, notes


def _minimise(criterion: PredictionErrors, theta: Array, solver: Solver | None) -> Solution:
    layout = criterion.layout
    if criterion.evaluate(theta).value < NO_NOISE * criterion.N:
        # Data without noise: the start reproduces them to rounding, and there is no slope left.
        return _standing(criterion, theta, "exact: the start reproduces the data")
    nlp = Nlp(layout.structure)
    for name, value in zip(layout.names, theta.tolist(), strict=True):
        nlp.variable(name, value, scale=max(abs(value), 1e-3))
    nlp.minimize(criterion)
    solution = nlp.solve(solver, theta.tolist(), throw=False, natural_scales=True)
    if not solution.is_converged and at_circle(layout, solution.x)[1] < NEAR:
        again = nlp.solve(solver, solution.x.tolist(), throw=False, natural_scales=True)
        if again.value <= solution.value:
            return again
    return solution


def _information(solution: Solution) -> tuple[Array, Array, Array]:
    """Eigenvalues and vectors of the Gauss-Newton matrix scaled to unit diagonal, and the scale."""
    root = np.sqrt(np.maximum(np.diag(solution.hessian), TINY))
    values, vectors = np.linalg.eigh(solution.hessian / np.outer(root, root))
    return values, vectors, root


def _standing(criterion: PredictionErrors, theta: Array, status: str) -> Solution:
    at = criterion.evaluate(theta)
    return Solution(
        names=criterion.layout.names,
        x=theta,
        value=at.value,
        status=status,
        iterations=0,
        scaled_gradient=0.0,
        constraint_violation=0.0,
        at_lower=(),
        at_upper=(),
        hessian=at.hessian,
        constraint_jacobian=np.zeros((0, len(theta))),
        solver="least squares",
    )


def _closed_form(criterion: PredictionErrors) -> Solution:
    """ARX and FIR: linear least squares by an orthogonal factorisation."""
    layout = criterion.layout
    jacobian, y = criterion.jacobian(np.zeros(layout.n))
    rank, equations = dependent_columns(jacobian.T @ jacobian, layout.names)
    if not rank.is_full:
        raise IdentifiabilityError(
            f"{layout.structure}: the record determines {rank.rank} of {rank.unknowns} "
            f"coefficients; the regressors of {', '.join(layout.names)} are dependent, "
            f"{equations}. "
            "Lower the orders (data without noise have one order only), or record a richer input"
        )
    theta = -np.linalg.lstsq(jacobian, y, rcond=None)[0]
    return _standing(criterion, theta, "closed form")


# -- the result ---------------------------------------------------------------------------------


def _model(
    criterion: PredictionErrors,
    data: Data,
    solution: Solution,
    units: Units,
    settings: PolynomialSettings,
    label: str,
    notes: tuple[str, ...],
) -> PolynomialModel:
    """The estimate in the data's own units, with its covariance."""
    layout = criterion.layout
    misfit = _misfit(criterion, data, solution, units)
    variance = 2 * solution.value / max(criterion.N - layout.n, 1)
    covariance, smallest = _covariance(criterion, solution, settings.errors, variance)
    theta = np.array(solution.x) * units.factors
    p = layout.split(theta)
    for array in (theta, covariance, *misfit.residuals):
        array.flags.writeable = False
    no_noise = 2 * solution.value < NO_NOISE * criterion.N
    return PolynomialModel(
        structure=layout.structure,
        A=p.A,
        B=dict(zip(layout.inputs, p.B, strict=True)),
        C=p.C,
        D=p.D,
        F=dict(zip(layout.inputs, p.F, strict=True)),
        nk=dict(zip(layout.inputs, layout.nk, strict=True)),
        names=layout.names,
        theta=theta,
        covariance=covariance * np.outer(units.factors, units.factors),
        assumes=ASSUMES[settings.errors],
        Ts=float(settings.Ts),
        misfit=misfit,
        search=Search(
            solution.status,
            solution.is_converged,
            solution.iterations,
            solution.scaled_gradient,
            label,
        ),
        notes=(*notes, *doubts(layout, p, smallest, no_noise)),
    )


def _covariance(
    criterion: PredictionErrors, solution: Solution, errors: Errors, variance: float
) -> tuple[Array, float]:
    """Covariance (n, n) of the scaled coefficients, and the information's smallest eigenvalue."""
    values, vectors, root = _information(solution)
    if errors == "white":
        # A direction that is not excited gets a huge error, not the none of a pseudo-inverse.
        q = vectors / np.sqrt(np.maximum(values, 1e-16))
        return variance * (q @ q.T) / np.outer(root, root), float(values[0])
    free = np.ones(len(root), dtype=bool)
    return sandwich(solution.hessian, criterion.scores(solution.x), free)[0], float(values[0])


def _misfit(criterion: PredictionErrors, data: Data, solution: Solution, units: Units) -> Misfit:
    """Residuals in the data's own units, and what sums them up."""
    N, power = criterion.N, units.y**2
    residuals = tuple(r * units.y for r in criterion.residuals(solution.x))
    pairs = list(zip(residuals, data, criterion.discard, strict=True))
    counting = [r[d:] for r, _, d in pairs]
    correlation = {
        i: residual_input_correlation(counting, [u[i][d:] for _, (_, u), d in pairs])
        for i in criterion.layout.inputs
    }
    return Misfit(
        noise_variance=2 * solution.value / max(N - criterion.layout.n, 1) * power,
        loss=solution.value / N * power,
        fit=100 * (1 - float(np.sqrt(2 * solution.value / criterion.spread))),
        N=N,
        residuals=residuals,
        discarded=criterion.discard,
        input_correlation=correlation,
    )
