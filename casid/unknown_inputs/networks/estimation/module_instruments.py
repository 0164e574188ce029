"""Instrumental variables: moments with signals of the references, solved for modules by an NLP.

Extended instruments (2.42)-(2.43) of Linder (2017) on the regression of `module_regression`, with
instruments and prefilters as in Algorithm 2.1. The references are in no equation error, so that
moments are consistent whatever the confounders; prefilters change the variance alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.errors import CasidError, IdentifiabilityError, SolveError
from casid.estimation.local_rank import local_rank
from casid.estimation.moments.equations.moment_covariance import moment_covariance
from casid.estimation.moments.equations.moment_equations import MomentEquations, moment_equations
from casid.estimation.moments.equations.moment_nlp import Condensed, PhysicalNlp
from casid.estimation.moments.equations.parts import Part
from casid.estimation.moments.stages.noise_models import noise_models
from casid.estimation.nlp.solution import Solution
from casid.estimation.nlp.solver import Solver
from casid.estimation.prediction_error.polynomial.orders import Layout, Orders
from casid.linear.sampled.difference_equation import DifferenceEquation
from casid.model.declarations import Parameter
from casid.model.quantities import p_statement
from casid.unknown_inputs.networks.estimation.module_data import ModuleData
from casid.unknown_inputs.networks.estimation.module_fit import ModuleFit, without_noise
from casid.unknown_inputs.networks.estimation.module_regression import module_regression
from casid.unknown_inputs.networks.estimation.reference_instruments import reference_instruments

ROUNDS = 4  # of prefilters; the estimate settles in two or three
SETTLED = 0.02  # standard errors
PLAUSIBLE = 1e-4  # p of the surplus moments at which an end is taken for the optimum
WEAK = 10.0  # F below which instruments are called weak (Staiger & Stock 1997)
ASSUMES = (
    "references independent of the equation error, which has zero mean and finite memory, at the "
    "last prefilter"
)


def default_instrument_lags(n: int, references: int, N: int) -> int:
    """Lags of each reference: three moments a coefficient, at least 10; a heuristic."""
    return int(np.clip(-(-3 * n // references), 10, max(N // (20 * references), 10)))


def by_instruments(
    data: ModuleData,
    orders: Orders,
    lags: int | None,
    starts: list[Callable[[], Array]],
    *,
    prefilter_order: int = 10,
    solver: Solver | None = None,
) -> ModuleFit:
    """Estimate from moments with instruments made of the references.

    Parameters
    ----------
    orders : C and D are not used.
    lags : of the references themselves as instruments instead, as `reference_instruments`.
    starts : each gives theta to start from, or raises a CasidError; the best end is taken.
    prefilter_order : of the autoregression that whitens the equation error; 0 for no prefilter.

    Raises
    ------
    DataError
        If the record is too short for the lags.
    IdentifiabilityError
        If a combination of coefficients is not identifiable from the moments.
    SolveError
        If no start leads to an optimum.
    """
    plain = without_noise(orders)
    layout = Layout.of(plain, tuple(data.inputs))
    equation = module_regression(layout, "y", data.Ts)
    part = Part(data.name, equation, {}, frozenset(), {"y": data.y, **data.inputs}, {}, data.Ts)
    few = default_instrument_lags(layout.n, len(data.references), data.N)
    simulated, what = reference_instruments(data, equation, lags, few)
    moments = moment_equations(part, simulated)
    program = _Program(equation, solver)
    best = _from_all(program, moments, starts, layout)
    covariance = program.covariance(moments, best.x)
    remarks: list[str] = []
    filters: list[Any] = [None]
    rounds = 0
    for rounds in range(1, ROUNDS + 1 if prefilter_order else 1):
        theta = program.theta(best.x)
        filters, _ = noise_models([part], [theta], filters, (prefilter_order, 0), remarks, rounds)
        if filters[0] is None:
            break
        moments = moment_equations(part, simulated, filters[0])
        again = program.solve(moments, best.x)
        if not again.is_converged:
            remarks.append("the program did not settle with a refined prefilter")
            break
        covariance = program.covariance(moments, again.x)
        moved = np.abs(again.x - best.x) / np.sqrt(np.diag(covariance))
        best = again
        if np.max(moved) < SETTLED:
            break
    evidence, weak = _evidence(program, moments, best.x, what)
    evidence["prefilter"] = f"AR({prefilter_order}), {rounds} rounds" if prefilter_order else "none"
    return ModuleFit(layout, best.x, covariance, ASSUMES, (*remarks, *weak), evidence)


def _evidence(
    program: _Program, moments: MomentEquations, x: Array, what: str
) -> tuple[dict[str, str], list[str]]:
    """The evidence of the moments and instruments at x, and a remark if these are weak."""
    evidence = program.evidence(moments, x)
    strength = program.strength(moments, x)
    evidence["instruments"] = f"{what}; weakest combination has F = {strength:.3g}"
    if strength >= WEAK:
        return evidence, []
    remark = (
        f"weak instruments (F = {strength:.3g} < {WEAK:g}): the estimate leans to least "
        "squares and its errors are too small; excite more, or lower the orders"
    )
    return evidence, [remark]


def _from_all(
    program: _Program, moments: MomentEquations, starts: list[Callable[[], Array]], layout: Layout
) -> Solution:
    ends: list[Solution] = []
    why: list[str] = []
    for start in starts:
        try:
            end = program.solve(moments, start()[: layout.n])
        except CasidError as reason:
            why.append(str(reason))
            continue
        if end.is_converged:
            ends.append(end)
            if program.p_value(moments, end.x) > PLAUSIBLE:
                break
        else:
            why.append(f"{end.status}: {end.remedy}")
    if not ends:
        raise SolveError(
            "no start led to an optimum of the moment equations: "
            f"{'; '.join(dict.fromkeys(why))}. Lower the orders, or give references that excite "
            "the inputs more"
        )
    return min(ends, key=lambda s: s.value)


class _Program:
    """min 1/2 ||R (Y - Phi g(theta))||^2 with the two-stage weight R of the moments."""

    def __init__(self, equation: DifferenceEquation, solver: Solver | None) -> None:
        self._equation, self._solver = equation, solver
        free = [Parameter(n, "1", start=0.1) for n in equation.parameters]
        self._nlp = PhysicalNlp([equation], free, [frozenset()], solver=solver, name="module")

    def theta(self, x: Array) -> Array:
        """Coefficients of the regression."""
        return np.asarray(self._equation.g(x), dtype=np.float64).ravel()

    def solve(self, moments: MomentEquations, x: Array) -> Solution:
        root = moments.root_weight("2sls", self.theta(x), None)
        data = [Condensed.of(moments, root)]
        values = [dict.fromkeys(self._equation.parameters, 0.0)]
        return self._nlp.solve(data, values, x.tolist(), throw=False)

    def _slope(self, moments: MomentEquations, x: Array) -> tuple[Array, Array]:
        root = moments.root_weight("2sls", self.theta(x), None)
        J = np.asarray(self._equation.jacobian(x)[1])
        return root, root @ moments.Phi @ J

    def covariance(self, moments: MomentEquations, x: Array) -> Array:
        """(2.57)-(2.59), (n, n)."""
        root, slope = self._slope(moments, x)
        names = self._equation.parameters
        rank = local_rank(slope.T @ slope, x, names, np.ones(len(x)))
        if not rank.is_full:
            raise IdentifiabilityError(
                f"the references identify {rank.rank} of {rank.unknowns} coefficients: "
                f"{'; '.join(', '.join(d) for d in rank.null)} move together. Lower the orders, or "
                "excite another node"
            )
        M = np.linalg.pinv(slope) @ root
        S = moment_covariance([moments], [self.theta(x)], [moments.name])
        return np.asarray(M @ S @ M.T)

    def strength(self, moments: MomentEquations, x: Array) -> float:
        """F statistic of the combination of regressors least correlated with the instruments."""
        J = np.asarray(self._equation.jacobian(x)[1])
        w = moments.whitener()
        own = np.linalg.cholesky(J.T @ moments.second[1:, 1:] @ J)
        canonical = np.linalg.svd(w @ moments.Phi @ J @ np.linalg.inv(own).T, compute_uv=False)
        share = float(min(canonical[-1] ** 2, 1 - 1e-12))
        return moments.N * share / (1 - share) / len(w)

    def evidence(self, moments: MomentEquations, x: Array) -> dict[str, str]:
        """How many moments, and the test of overidentification (Sargan 1958)."""
        statistic, degrees = self._surplus(moments, x)
        return {
            "moments": f"{len(x) + degrees} for {len(x)} coefficients",
            "overidentified": f"chi squared {statistic:.1f} of {degrees} degrees, "
            f"{p_statement(self.p_value(moments, x))}",
        }

    def p_value(self, moments: MomentEquations, x: Array) -> float:
        """Probability of so large a misfit of the surplus moments where nothing is wrong."""
        from scipy.stats import chi2

        statistic, degrees = self._surplus(moments, x)
        return float(chi2.sf(statistic, degrees)) if degrees > 0 else 1.0

    def _surplus(self, moments: MomentEquations, x: Array) -> tuple[float, int]:
        theta = self.theta(x)
        left = moments.root_weight("2sls", theta, None) @ (moments.Y - moments.Phi @ theta)
        return float(left @ left), len(left) - len(x)
