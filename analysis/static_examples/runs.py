"""Monte Carlo of the static benchmark: every estimator of Examples 3.1-3.10 and 4.2 at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from analysis.static_examples.formulas import ClosedForm
from casid.arrays import Array
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.regression import Regression, split_term


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Estimates of many records beside what theory says of them.

    Attributes
    ----------
    mean, sd : (d,) over the runs; sd is multiplied by sqrt(N).
    mean_off, variance_off : (d,) distance from theory in Monte Carlo standard errors.
    """

    mean: Array
    sd: Array
    mean_off: Array
    variance_off: Array


def draws(values: Mapping[str, float], runs: int, N: int, seed: int = 36) -> dict[str, Array]:
    """Samples (runs, N) of every signal of the benchmark."""
    rng = np.random.default_rng(seed)
    d1, d2, tu, tO, e = (
        math.sqrt(values[k]) * rng.standard_normal((runs, N))
        for k in ("l1", "l2", "lu", "lO", "le")
    )
    uK, uU = d1 + values["beta"] * tu, values["alpha"] * d1 + d2 + tu
    return {
        "delta1": d1,
        "delta2": d2,
        "u_K": uK,
        "u_U": uU,
        "y_U": uU + e,
        "u_I": uU + e,
        "y_O": values["bK"] * uK + values["bU"] * uU + tO,
        "u_hat": values["a1"] * d1 + values["a2"] * d2,
        "delta1 + delta2": d1 + d2,
    }


def beside_theory(
    form: ClosedForm, theory: Asymptotics, data: Mapping[str, Array], alpha: float
) -> Runs:
    """One estimator on every record, and how far it lies from its limit and covariance."""
    theta = _estimates(form.regression, data, alpha)
    runs, N = data["y_O"].shape
    P = np.diag(theory.covariance).astype(float)
    mean, variance = theta.mean(axis=0), N * theta.var(axis=0, ddof=1)
    limit = theory.limit.astype(float)
    return Runs(
        mean,
        np.sqrt(variance),
        (mean - limit) / np.sqrt(P / N / runs),
        (variance / P - 1) / math.sqrt(2 / runs),
    )


def _estimates(r: Regression, data: Mapping[str, Array], alpha: float) -> Array:
    own = dict(data)
    for name, stage in r.generated.items():
        psi = [own[split_term(t)[1]] for t in stage.known]
        gamma = _solved(own[split_term(stage.measured)[1]], psi, psi)
        if stage.is_known:
            gamma = np.tile([alpha, 1.0], (len(gamma), 1))
        own[name] = np.sum(np.array([gamma[:, [i]] * p for i, p in enumerate(psi)]), axis=0)
    phi = [own[split_term(t)[1]] for t in r.regressors.values()]
    zeta = phi if r.instruments is None else [own[split_term(t)[1]] for t in r.instruments]
    return _solved(own[split_term(r.output)[1]], phi, zeta)


def _solved(y: Array, phi: list[Array], zeta: list[Array]) -> Array:
    Phi, Zeta = np.stack(phi, axis=1), np.stack(zeta, axis=1)
    left = Zeta @ np.swapaxes(Phi, 1, 2)
    return np.asarray(np.linalg.solve(left, Zeta @ y[:, :, None])[:, :, 0])
