"""Least squares weighted by the spectrum of its own residual.

With a residual of covariance Gamma, T its sensitivities, the estimate that minimises

    r' Gamma^-1 r                                                                              (1)

has the covariance (T' Gamma^-1 T)^-1, the least there is (A. C. Aitken, Proc. Roy. Soc. Edinburgh
55 (1935) 42-48); plain least squares has (T'T)^-1 T' Gamma T (T'T)^-1. Gamma is that of an
autoregression of each output's residual (`residual_autoregressions`), estimated once: more steps
change nothing in the limit (Goldberger 1962). Where noise has a resonance, or drifts slowly, (1) is
the better estimate by far. That the spectrum is an estimate adds to its covariance

    2 sum_j d_j d_j',                                                                          (2)

d_j what the estimate moves by with a standard error of the spectrum in one of its independent
directions, and Student's t to its interval (Kenward and Roger, Biometrics 53 (1997) 983-997).

Where the residual is no noise but what the model lacks, (1) fits other frequencies than least
squares, and the simulation becomes worse. Plain least squares is then kept. Two tests say so. Both
estimate the same only if the model is right: their difference then has the covariance V_plain -
V_weighted (J. A. Hausman, Econometrica 46 (1978) 1251-1271). And noise does not depend on the
motion: powers of the outputs (J. B. Ramsey, J. R. Stat. Soc. B 31 (1969) 350-371) and sensitivities
that grow with time or with an output's size, as of parameters that change, explain nothing of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_distribution

from casid.arrays import TINY, Array, basis_of, scaled_inverse
from casid.estimation.nlp.solver import Solver
from casid.estimation.noise.residual_autoregressions import (
    MOVED,
    Autoregression,
    coloured_covariance,
    moved_by_errors,
    orders_text,
    student_factors,
)
from casid.estimation.simulation.minimization import Fit, minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError
from casid.model.quantities import p_statement

GAIN = 1.1
"""Standard errors of least squares over those of the weighted estimate, of any parameter, from
which it is made: below that a second estimate changes nothing that a user would see."""
CONTRADICTED = 1e-3
"""Probability, by either test, below which the residual is no noise."""
WORSE = 1.05
"""RMS error of the simulation over that of least squares, of any output, beyond which it is not
made: noise that wanders as slowly as the motion explains any difference, and a misfit looks so."""
APART = 0.02
"""Eigenvalue of the difference of their correlations below which they are one estimate."""
_NEAR = Solver(options={"ipopt.mu_strategy": "monotone", "ipopt.mu_init": 1e-6})
"""A fit that begins next to its minimum."""


@dataclass(frozen=True, slots=True, eq=False)
class SpectralWeights:
    """An estimate weighted by the spectrum of the residual.

    Attributes
    ----------
    fit : the minimum of (1), whose criterion whitens.
    models : the autoregressions, one an output.
    added : (n, n) (2).
    wider : (n,) factors of Student's t, 1 at active bounds.
    gained : the parameter that becomes the most certain, and by what factor.
    """

    fit: Fit
    models: list[Autoregression]
    added: Array
    wider: Array
    gained: tuple[str, float] = ("", 1.0)

    @property
    def text(self) -> str:
        """What was done and why, in a sentence."""
        name, factor = self.gained
        return (
            f"the residual is coloured (autoregression of order {orders_text(self.models)}); "
            f"weighted by its spectrum, the estimate of {name} has {1 / factor:.2g} times the "
            "standard error of plain least squares"
        )

    def covariance(self, free: Array) -> Array:
        """(n, n) of the estimate: the inverse of its information, (2), and Student's t."""
        known = _covariance(self.fit.solution.hessian, free) + self.added * np.outer(free, free)
        return np.asarray(known * np.outer(self.wider, self.wider))


def weighted_by_spectrum(fit: Fit) -> SpectralWeights | str:
    """The weighted estimate beside one of least squares, or why there is none.

    Empty where nobody would see a difference: a residual that is white or whose spectrum makes no
    parameter much more certain.

    Parameters
    ----------
    fit : minimum of the simulation error, not whitened.
    """
    criterion, solution = fit.criterion, fit.solution
    if criterion.segments > 1 or solution.constraint_jacobian.size or not solution.is_converged:
        return ""
    free = solution.is_free
    plain = coloured_covariance(fit, free)
    mine = [
        i
        for i, v in enumerate(criterion.variables)
        if free[i] and v.source in criterion.model.parameters
    ]
    if plain is None or not mine:
        return ""
    of_plain, models = plain
    if not all(map(_is_stationary_beside, models, _samples(criterion))):
        return ""  # of a line, say: what its error does to the estimate is not known
    plain_errors = np.sqrt(np.maximum(np.diag(of_plain)[mine], TINY))
    weighted = _whitened(criterion, models, fit)
    at_fit = _covariance(weighted.evaluate(fit.x).hessian, free)
    if np.max(plain_errors / np.sqrt(np.maximum(np.diag(at_fit)[mine], TINY))) < GAIN:
        return ""
    found = minimize_simulation_error(weighted, solver=_NEAR, check_rank=False)
    if not found.solution.is_converged or not np.array_equal(found.solution.is_free, free):
        return ""
    result = SpectralWeights(found, models, *_of_spectrum(criterion, models, found))
    covariance = result.covariance(free)
    gains = plain_errors / np.sqrt(np.maximum(np.diag(covariance)[mine], TINY))
    best = int(np.argmax(gains))
    if gains[best] < GAIN:
        return ""
    why = (
        _why_worse(criterion, fit.x, found.x)
        or _why_no_noise(found, mine)
        or _why_not_the_same(fit, found, mine, of_plain, covariance)
    )
    if why:
        return f"the residual is coloured, but {why}: the model is incomplete (casid diagnose)"
    return replace(result, gained=(criterion.names[mine[best]], float(gains[best])))


def _whitened(
    criterion: SimulationError, models: Sequence[Autoregression], fit: Fit
) -> SimulationError:
    """(1) for the autoregressions of the outputs; samples that are missing are passed over."""
    data = criterion.data

    def whiten(columns: Array, experiment: int) -> Array:
        """Columns (N, ny, ...) of an experiment whitened output by output."""
        out = np.zeros_like(columns)
        for i, (model, there) in enumerate(zip(models, data[experiment].used.T, strict=True)):
            out[there, i] = model.whiten(columns[there, i])
        return out

    return criterion.of_records(
        criterion.experiments, weights=criterion.weights, whiten=whiten, start=fit.values
    )


def _samples(criterion: SimulationError) -> list[int]:
    """Samples that each output has."""
    return [int(n) for n in np.sum([d.used.sum(axis=0) for d in criterion.data], axis=0)]


def _is_stationary_beside(model: Autoregression, samples: int) -> bool:
    """True of an autoregression that its own error does not carry to the unit circle."""
    moved = [model, *moved_by_errors(model, samples)]
    return all(bool(np.all(np.abs(m.reflections) < 1.0)) for m in moved)


def _of_spectrum(
    plain: SimulationError, models: Sequence[Autoregression], found: Fit
) -> tuple[Array, Array]:
    """(2) and the factors of Student's t: what the errors of the autoregressions give to a fit."""
    free = found.solution.is_free
    data = [(plain.columns(found.x, e), d.used) for e, d in enumerate(plain.data)]
    samples = _samples(plain)

    def equations(models: Sequence[Autoregression]) -> tuple[Array, Array]:
        """Gradient (n,) and information (n, n) under other autoregressions."""
        gradient, information = np.zeros(len(found.x)), np.zeros((len(found.x),) * 2)
        for (r, t), used in data:
            for i, m in enumerate(models):
                k = used[:, i]
                white = m.whiten(np.column_stack([r[k, i], t[k, i]]))
                gradient += white[:, 1:].T @ white[:, 0]
                information += white[:, 1:].T @ white[:, 1:]
        return gradient, information

    def under(models: Sequence[Autoregression]) -> Array:
        return _covariance(equations(models)[1], free)

    at_fit, _ = equations(models)
    added = np.zeros((len(free),) * 2)
    for i, m in enumerate(models):
        for moved in moved_by_errors(m, samples[i]):
            there = [moved if k == i else other for k, other in enumerate(models)]
            gradient, information = equations(there)
            move = _covariance(information, free) @ (gradient - at_fit) / MOVED
            added += 2 * np.outer(move, move)
    return added, np.where(free, student_factors(under, models, samples), 1.0)


def _covariance(hessian: Array, free: Array) -> Array:
    """(n, n) of an efficient estimate: the inverse of its information."""
    index = np.flatnonzero(free)
    both = np.ix_(index, index)
    out = np.zeros(hessian.shape)
    out[both] = scaled_inverse(hessian[both])
    return out


def _why_worse(criterion: SimulationError, plain: Array, weighted: Array) -> str:
    """Why a weighted estimate simulates worse than noise would have it do."""
    squares = []
    for x in (plain, weighted):
        runs = [criterion.simulated(x, e).residual for e in range(len(criterion.data))]
        squares.append(np.sum([np.sum(r**2, axis=0) for r in runs], axis=0))
    ratio = float(np.sqrt(np.max(squares[1] / np.maximum(squares[0], TINY))))
    if ratio <= WORSE:
        return ""
    return f"weighted by its spectrum the simulation errs by {ratio:.3g} times as much"


def _why_not_the_same(
    plain: Fit, weighted: Fit, mine: Sequence[int], of_plain: Array, of_weighted: Array
) -> str:
    """Why both estimates differ by more than noise explains, by their covariances (n, n).

    Compared in the directions in which they differ: in the others both are the same estimate.
    """
    both = np.ix_(mine, mine)
    moved = (weighted.x - plain.x)[mine]
    errors = np.sqrt(np.maximum(np.diag(of_plain)[mine], TINY))
    shares = moved / errors
    values, axes = np.linalg.eigh((of_plain - of_weighted)[both] / np.outer(errors, errors))
    differs = values > APART
    z = (axes.T @ shares)[differs]
    if chi2.sf(np.sum(z**2 / values[differs]), max(int(differs.sum()), 1)) >= CONTRADICTED:
        return ""
    worst = int(np.argmax(np.abs(shares)))
    return (
        f"weighted by its spectrum {plain.criterion.names[mine[worst]]} moves by "
        f"{abs(shares[worst]):.2g} standard errors, more than noise explains"
    )


def _why_no_noise(weighted: Fit, mine: Sequence[int]) -> str:
    """Why the whitened residual is no noise: an F test of what depends on the motion."""
    criterion, free = weighted.criterion, weighted.solution.is_free
    parts = [_of_motion(criterion, weighted.x, e, free, mine) for e in range(len(criterion.data))]
    residual, tangent, motion = (np.concatenate(part) for part in zip(*parts, strict=True))
    basis = basis_of(tangent)
    residual = residual - basis @ (basis.T @ residual)
    of_motion = basis_of(motion - basis @ (basis.T @ motion))
    explained = float(np.sum((of_motion.T @ residual) ** 2))
    columns = of_motion.shape[1]
    rest = len(residual) - basis.shape[1] - columns
    if rest < 1 or not columns:
        return ""
    left = max(float(residual @ residual) - explained, TINY)
    p = float(f_distribution.sf((explained / columns) / (left / rest), columns, rest))
    return f"follows the motion ({p_statement(p, '.1g')})" if p < CONTRADICTED else ""


def _of_motion(
    criterion: SimulationError, x: Array, experiment: int, free: Array, mine: Sequence[int]
) -> tuple[Array, Array, Array]:
    """Whitened residual (M,), its sensitivities (M, n), and what depends on the motion (M, m)."""
    d, run = criterion.data[experiment], criterion.simulated(x, experiment)
    weights = criterion.weights[None, :, None]
    size = (run.y - run.y.mean(axis=0)) / np.maximum(run.y.std(axis=0), TINY)
    powers = np.stack([size**2, size**3], axis=2)  # (N, ny, 2)
    own = np.einsum("kic,ij->kijc", powers, np.eye(size.shape[1])).reshape(*size.shape, -1)
    ramp = np.linspace(-1.0, 1.0, d.N)[:, None, None]
    changing = run.jacobian[:, :, mine]
    columns = [own, changing * ramp, changing * (size**2)[:, :, None]]
    stack = [run.residual[:, :, None], run.jacobian[:, :, free], *columns]
    white = np.concatenate(stack, axis=2) * weights * d.used[:, :, None]
    white = (criterion.whiten(white, experiment) if criterion.whiten else white)[d.used]
    n = 1 + int(free.sum())
    return white[:, 0], white[:, 1:n], white[:, n:]
