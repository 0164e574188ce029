"""Prediction-error estimation of A y = sum_i (B_i/F_i) u_i + (C/D) e.

The criterion 1/2 sum eps^2 (thesis (2.36)-(2.38)) is an NLP in the coefficients alone, whatever the
number of samples. ARX is linear and solved in closed form. The predictor (2.19) divides by C and F:
the search stays where both are stable.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casid.errors import DataError, IdentifiabilityError, ModelError, SolveError
from casid.local_rank import describe_null, local_rank
from casid.nlp import Nlp, Solution, Solver
from casid.polynomial_criterion import PredictionErrors
from casid.polynomial_model import PolynomialModel, one_record
from casid.polynomial_orders import Layout, Orders, PerInput, largest_root
from casid.polynomial_start import candidates, lagged
from casid.uncertainty import sandwich

Array = NDArray[Any]
Errors = Literal["white", "robust"]
ASSUMES = {
    "white": "white innovations, i.e. a true system in the model set: (2.54)-(2.56) with "
    "Q = lambda V''",
    "robust": "residuals of short memory, in the model set or not: (2.54)-(2.56), Q by a Bartlett "
    "sum",
}


def prediction_error(
    y: ArrayLike | Sequence[ArrayLike],
    u: Any,
    orders: Orders,
    *,
    Ts: float = 1.0,
    discard: int | None = None,
    errors: Errors = "white",
    solver: Solver | None = None,
    start: PolynomialModel | None = None,
    throw: bool = True,
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
    Ts : sample time [s], for spectra and `to_control`.
    discard : first residuals of each record that do not count, at most N - 1
        The filters start from rest, which is wrong for a record cut out of a longer one; so by
        default the longest lag and the time in which 1/(C F) settles to 1 % at the start values
        (at most a fifth of the record) do not count. 0 takes signals as zero before the record
        and counts every residual (conditional least squares).
    errors : "white" for the classical covariance, "robust" for the sandwich
    solver : default ``Solver("ipopt")``; where C = D = F = 1, closed-form least squares by default.
    start : a model of the same orders to start from; its own start values otherwise.
    throw : raise if no optimum is reached; else return it with `is_converged` False.

    Raises
    ------
    DataError
        If shapes differ, samples are not finite, or too few.
    ModelError
        If an order is negative or does not fit the inputs.
    IdentifiabilityError
        If the inputs do not excite what is asked: names the direction.
    SolveError
        If no optimum is reached, or it lies where the predictor is not stable.

    Notes
    -----
    Consistent in open and closed loop if the true system is in the model set; with G alone in it
    (OE, a wrong noise model) in open loop only (Ljung 1999, sections 8.4 and 13.4).
    """
    data, inputs = _records(y, u)
    layout = Layout.of(orders, inputs)
    if layout.n == 0:
        raise ModelError("every order is 0: nothing to estimate; give at least one above 0")
    if errors not in ASSUMES:
        raise ModelError(f"errors = {errors!r}; choose 'white' or 'robust'")
    if not (np.isfinite(Ts) and Ts > 0):
        raise DataError(f"sample time Ts = {Ts!r}; give a number of seconds above 0")
    least = layout.longest_lag if discard != 0 else 0
    _refuse_short(data, layout, least if discard is None else discard)
    _refuse_unexciting(data, layout)
    if layout.is_linear and solver is None:
        return _closed_form(data, layout, Ts, discard, errors)
    points = _starts(data, layout, start)
    chosen = _discards(data, layout, points[0][1], discard)
    criterion = PredictionErrors(layout, data, chosen)
    ranked = sorted(
        ((criterion.evaluate(theta).value, i) for i, (_, theta, _) in enumerate(points)),
        key=lambda item: (not np.isfinite(item[0]), item[0]),
    )
    best: Solution | None = None
    label, notes = "", ()
    for value, i in ranked[:3]:
        if not np.isfinite(value):
            continue
        solution = _minimise(criterion, points[i][1], solver, data)
        if best is None or (solution.is_converged, -solution.value) > (
            best.is_converged,
            -best.value,
        ):
            best, label, notes = solution, points[i][0], points[i][2]
        if best.is_converged:
            break
    if best is None:
        raise SolveError(
            f"{layout.structure}: the criterion is not finite at any start value; scale y and u to "
            "a size near one, or give start="
        )
    if throw and not best.is_converged:
        raise SolveError(_failure(layout, best))
    return _model(criterion, best, Ts, errors, label, notes, data)


def arx(
    y: Any, u: Any = None, *, na: int, nb: PerInput = 0, nk: PerInput = 1, **options: Any
) -> PolynomialModel:
    """A y = B u + e by least squares (thesis (2.39)); options as `prediction_error`."""
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


def _records(y: Any, u: Any) -> tuple[list[tuple[Array, dict[str, Array]]], tuple[str, ...]]:
    several = isinstance(y, list | tuple) and len(y) > 0 and np.ndim(y[0]) > 0
    ys = list(y) if several else [y]
    if not several:
        us = [u]
    elif u is None:
        us = [None] * len(ys)
    elif isinstance(u, list | tuple) and len(u) == len(ys):
        us = list(u)
    else:
        raise DataError(
            f"y is a list of {len(ys)} records; give u as a list of {len(ys)} entries beside it"
        )
    data: list[tuple[Array, dict[str, Array]]] = []
    inputs: tuple[str, ...] | None = None
    for k, (one_y, one_u) in enumerate(zip(ys, us, strict=True)):
        try:
            data.append(one_record(one_y, one_u, inputs))
        except DataError as error:
            raise DataError(f"record {k + 1}: {error}" if several else str(error)) from None
        inputs = tuple(data[-1][1]) if inputs is None else inputs
    return data, inputs or ()


def _refuse_short(data: Any, layout: Layout, discard: Any) -> None:
    if isinstance(discard, bool) or int(discard) != discard or discard < 0:
        raise DataError(
            f"discard = {discard!r}; give the whole number of first samples that do not count"
        )
    for k, (y, _) in enumerate(data):
        if len(y) <= max(discard, layout.longest_lag):
            raise DataError(
                f"record {k + 1} has {len(y)} samples, the predictor reaches back "
                f"{layout.longest_lag} and {discard} do not count; leave the record out, or lower "
                "the orders"
            )
        if not np.any(y != y[0]):
            raise DataError(
                f"record {k + 1}: y is constant ({y[0]:g}); there is nothing to fit. Check the "
                "channel's cable and mapping, or leave the record out"
            )
    left = sum(len(y) - discard for y, _ in data)
    if left <= layout.n:
        raise DataError(
            f"{left} residuals cannot pay for {layout.n} coefficients; give longer records or "
            "lower the orders"
        )


def _refuse_unexciting(data: Any, layout: Layout) -> None:
    """The lagged inputs that B/F needs are linearly independent (persistently exciting)."""
    if not layout.inputs:
        return
    counts = [b + f for b, f in zip(layout.nb, layout.nf, strict=True)]
    names = [
        f"{i}[t-{k}]" if k else f"{i}[t]"
        for i, nk, c in zip(layout.inputs, layout.nk, counts, strict=True)
        for k in range(nk, nk + c)
    ]
    first = max(nk + c - 1 for nk, c in zip(layout.nk, counts, strict=True))
    gram = np.zeros((len(names), len(names)))
    for y, u in data:
        begin = min(first, len(y) - 1)
        parts = [
            lagged(u[i], nk, c, begin) if begin >= nk + c - 1 else np.zeros((0, c))
            for i, nk, c in zip(layout.inputs, layout.nk, counts, strict=True)
        ]
        if all(len(p) for p in parts):
            phi = np.hstack(parts)
            gram += phi.T @ phi
    length = np.sqrt(np.diag(gram))
    rank = local_rank(gram, np.zeros(len(names)), names, 1 / np.where(length > 0, length, 1.0))
    if rank.is_full:
        return
    constant = [
        f"input {i} is constant ({u[i][0]:g}) in record {k + 1}"
        for k, (_, u) in enumerate(data)
        for i in layout.inputs
        if not np.any(u[i] != u[i][0])
    ]
    directions = [
        " ".join(f"{'+' if v > 0 else '-'} {abs(v):.3g} {n}" for n, v in d.items())
        for d in rank.null
    ]
    raise IdentifiabilityError(
        f"{layout.structure}: the inputs excite {rank.rank} of the {rank.unknowns} lags that B"
        f"{' and F ask' if any(layout.nf) else ' asks'} for; "
        f"{' and '.join(f'{d} = 0' for d in directions)} over the record"
        f"{'; ' + ', '.join(constant) if constant else ''}. Record an experiment with a richer "
        "input, or lower nb" + (" and nf" if any(layout.nf) else "")
    )


def _discards(data: Any, layout: Layout, theta: Array, wanted: int | None) -> list[int]:
    if wanted is not None:
        return [wanted] * len(data)
    p = layout.split(theta)
    settle = 0
    for f in p.F or [np.ones(1)]:
        radius = max(largest_root(p.C), largest_root(f))
        if radius > 1e-6:
            settle = max(settle, int(np.ceil(np.log(0.01) / np.log(min(radius, 0.99999)))))
    return [layout.longest_lag + min(settle, (len(y) - layout.longest_lag) // 5) for y, _ in data]


# -- solving ------------------------------------------------------------------------------------


def _starts(data: Any, layout: Layout, start: PolynomialModel | None) -> list[Any]:
    found: list[Any] = []
    if start is not None:
        if start.names != layout.names:
            raise ModelError(
                f"start has the coefficients {', '.join(start.names)}, the orders ask for "
                f"{', '.join(layout.names)}; give a model of the same orders and inputs"
            )
        found.append(("the model given", np.array(start.theta), ()))
        return found
    return candidates(data, layout)


def _minimise(
    criterion: PredictionErrors, theta: Array, solver: Solver | None, data: Any
) -> Solution:
    layout = criterion.layout
    nlp = Nlp(layout.structure)
    for name, value in zip(layout.names, theta.tolist(), strict=True):
        nlp.variable(name, value, scale=max(abs(value), 1e-3))
    nlp.minimize(criterion)
    at = criterion.evaluate(theta)
    power = sum(float(y @ y) for y, _ in data)
    if at.value < 1e-24 * power:
        # Data without noise: the start reproduces them to rounding, and there is no slope left.
        return _standing(criterion, theta, "start reproduces the data to rounding")
    solution = nlp.solve(solver, theta.tolist(), throw=False, natural_scales=True)
    if not solution.is_converged and np.isfinite(solution.value):
        again = nlp.solve(solver, solution.x.tolist(), throw=False, natural_scales=True)
        if again.value <= solution.value:
            return again
    return solution


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


def _failure(layout: Layout, solution: Solution) -> str:
    p = layout.split(solution.x)
    near = [("C", largest_root(p.C))]
    near += [(f"F[{i}]", largest_root(f)) for i, f in zip(layout.inputs, p.F, strict=True)]
    name, radius = max(near, key=lambda item: item[1])
    why = solution.mend
    if radius > 0.999:
        lower = "nc" if name == "C" else "nf"
        why = (
            f"the search ran to a root of {name} of modulus {radius:.6f}, on the unit circle, "
            f"where the predictor is no longer stable. Lower {lower}, do not difference or detrend "
            "the data more than they need, or add the missing dynamics"
        )
    return (
        f"{layout.structure}: {solution.solver} stopped with {solution.status} after "
        f"{solution.iterations} iterations (scaled gradient {solution.scaled_gradient:.1e}): {why}"
    )


def _closed_form(
    data: Any, layout: Layout, Ts: float, discard: int | None, errors: Errors
) -> PolynomialModel:
    """ARX and FIR: linear least squares by an orthogonal factorisation."""
    criterion = PredictionErrors(layout, data, _discards(data, layout, np.zeros(layout.n), discard))
    jacobian, y = criterion.jacobian(np.zeros(layout.n))
    length = np.linalg.norm(jacobian, axis=0)
    rank = local_rank(
        jacobian.T @ jacobian,
        np.zeros(layout.n),
        layout.names,
        1 / np.where(length > 0, length, 1.0),
    )
    if not rank.is_full:
        raise IdentifiabilityError(f"{layout.structure}: {describe_null(rank)}")
    theta = -np.linalg.lstsq(jacobian, y, rcond=None)[0]
    return _model(
        criterion, _standing(criterion, theta, "closed form"), Ts, errors, "none needed", (), data
    )


# -- the result ---------------------------------------------------------------------------------


def _model(
    criterion: PredictionErrors,
    solution: Solution,
    Ts: float,
    errors: Errors,
    label: str,
    notes: tuple[str, ...],
    data: Any,
) -> PolynomialModel:
    layout, theta, N = criterion.layout, np.array(solution.x), criterion.N
    n = layout.n
    variance = 2 * solution.value / max(N - n, 1)
    said = list(notes)
    root = np.sqrt(np.maximum(np.diag(solution.hessian), 1e-300))
    unit = solution.hessian / np.outer(root, root)
    smallest = float(np.linalg.eigvalsh(unit)[0])
    if smallest < 1e-7:
        said.append(
            "polynomials nearly cancel (smallest eigenvalue of the scaled information "
            f"{smallest:.1e}): the orders are too high, and errors of single coefficients large"
        )
    if errors == "white":
        inverse = np.linalg.pinv(unit, rcond=1e-15, hermitian=True)
        covariance = variance * inverse / np.outer(root, root)
    else:
        covariance, _ = sandwich(solution.hessian, criterion.scores(theta), np.ones(n, dtype=bool))
    p = layout.split(theta)
    stretch = [("C", p.C), *((f"F[{i}]", f) for i, f in zip(layout.inputs, p.F, strict=True))]
    for name, polynomial in stretch:
        if (radius := largest_root(polynomial)) > 0.999:
            said.append(
                f"{name} has a root of modulus {radius:.6f}: transients last longer than "
                f"{int(1 / max(1 - radius, 1e-6))} samples, and normal errors are doubtful"
            )
    for name, polynomial in (("A", p.A), ("D", p.D)):
        if (radius := largest_root(polynomial)) >= 1:
            said.append(f"{name} has a root of modulus {radius:.4f}: the model itself is unstable")
    residuals = criterion.residuals(theta)
    spread = sum(
        float(np.sum((y[d:] - y[d:].mean()) ** 2))
        for (y, _), d in zip(data, criterion.discard, strict=True)
    )
    for r in residuals:
        r.flags.writeable = False
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
        covariance=covariance,
        assumes=ASSUMES[errors],
        noise_variance=variance,
        loss=solution.value / N,
        fit=100 * (1 - np.sqrt(2 * solution.value / spread)) if spread > 0 else 0.0,
        N=N,
        Ts=float(Ts),
        status=solution.status,
        is_converged=solution.is_converged,
        iterations=solution.iterations,
        scaled_gradient=solution.scaled_gradient,
        start=label,
        residuals=residuals,
        discarded=criterion.discard,
        notes=tuple(said),
    )
