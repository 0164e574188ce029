"""Two stages: inputs predicted from references, then a prediction-error estimate.

The first stage regresses each input on L lags of every reference, u = sum h_m r(t-m) + rest; the
second is a prediction-error estimate with sum h_m r(t-m) as its input (Linder 2017, section 3.5 and
Example 3.8; Van den Hof and Schrama 1993). Both have their part in the covariance:

    theta_hat - theta ~ V''^-1 mean( psi eps + sum_m M_m dh_m )
    dh_m = mean( r(t-m) rest ) / lambda

with M_m = E d(psi eps)/dh_m. References are white externals, so that their lags are orthogonal and
the second sum is the mean of one product v(t) rest(t), v = sum_m M_m r(t-m) / lambda.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

import numpy as np

from casid.argument_types import names_wrong_types
from casid.arrays import TINY, Array
from casid.errors import IdentifiabilityError, ModelError
from casid.estimation.prediction_error.polynomial.orders import Orders
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.prediction_criterion import PredictionCriterion
from casid.unknown_inputs.limits.prediction_limit import (
    MinimumSearch,
    PredictionMinimum,
    SearchOptions,
    prediction_minimum,
)
from casid.unknown_inputs.limits.second_moments import circle, product_covariance, settled_response

LEFT_OUT = 1e-3
"""Of an impulse response's peak: what is smaller may lie beyond the lags that are chosen."""


@names_wrong_types(ModelError)
def two_stage_limit(
    system: LinearSignals,
    output: str,
    inputs: Mapping[str, str],
    references: Sequence[str],
    orders: Orders,
    truth: Mapping[str, float] | None = None,
    *,
    predicted: Sequence[str] | None = None,
    lags: int | None = None,
    method: str | None = None,
    **search: Unpack[SearchOptions],
) -> Asymptotics:
    """Limit and covariance of the two-stage estimate of A y = sum (B_i/F_i) u_i + (C/D) e.

    Parameters
    ----------
    output : the measured signal y.
    inputs : name that coefficients carry -> signal of the system.
    references : externals that are known.
    predicted : names of the inputs that are replaced by their prediction; all by default.
    lags : of the first stage, from lag 0 on; by default until the responses of the inputs to the
        references have fallen to a thousandth of their peak.
    orders, truth, method, search : as in `prediction_error_limit`.

    Raises
    ------
    ModelError
        If a reference is no external, or the system has symbols.
    IdentifiabilityError
        If no reference reaches an input, or the second stage has no unique minimum.
    """
    stage = PredictedInputs(system, inputs, references, predicted, lags)
    found = prediction_minimum(
        stage.system, output, stage.sources, orders, truth, MinimumSearch(**search)
    )
    psi_forms, eps_forms = [found.psi], [found.repeated_eps]
    rest = settled_response(
        stage.system, [(n, 0, False) for n in stage.rests.values()], list(stage.rests.values()),
        None, len(found.eps),
    )  # fmt: skip
    if len(rest) != len(found.eps):  # the rest lasts longer than the error: a finer grid for all
        found = stage.on_grid(found, output, len(rest))
        psi_forms, eps_forms = [found.psi], [found.repeated_eps]
    for i, name in enumerate(stage.rests):
        psi_forms.append(stage.influence(found, name))
        eps_forms.append(np.repeat(rest[:, i : i + 1], found.layout.n, axis=1))
    A, B = np.concatenate(psi_forms, axis=1), np.concatenate(eps_forms, axis=1)
    Q = product_covariance(A, B, found.variances, found.kurtosis)
    total = np.tile(np.eye(found.layout.n), len(psi_forms))
    shown = ", ".join(references)
    text = method or f"two-stage of {output} on {', '.join(inputs.values())} from {shown}"
    return found.asymptotics(total @ Q @ total.T, text)


class PredictedInputs:
    """The system with predictions of the inputs and what they leave."""

    def __init__(
        self,
        system: LinearSignals,
        inputs: Mapping[str, str],
        references: Sequence[str],
        predicted: Sequence[str] | None,
        lags: int | None,
    ) -> None:
        wrong = [n for n in references if n not in system.externals]
        if wrong or not references:
            problem = f"reference {wrong[0]} is no external" if wrong else "no reference is given"
            raise ModelError(f"{problem}; choose among {', '.join(system.externals)}")
        self.references = [system.externals.index(n) for n in references]
        self.names = list(inputs)
        chosen = list(inputs) if predicted is None else list(predicted)
        # A reference as an input predicts itself.
        chosen = [n for n in chosen if inputs[n] not in references]
        responses = _impulses(system, [inputs[n] for n in chosen])[:, :, self.references]
        self.lags = _lasting(responses) if lags is None else lags
        self.sources, self.rests = dict(inputs), {}
        made: dict[str, dict[str, Any]] = {}
        for i, name in enumerate(chosen):
            if not np.any(np.abs(responses[:, i]) > 1e-12):
                raise IdentifiabilityError(
                    f"no reference ({', '.join(references)}) reaches {inputs[name]}, so nothing "
                    "of it can be predicted; excite a node upstream of it"
                )
            own, rest = f"{inputs[name]} from references", f"{inputs[name]} left over"
            made[own] = {r: (responses[: self.lags, i, k], [1.0]) for k, r in enumerate(references)}
            made[rest] = {inputs[name]: 1.0, own: -1.0}
            self.sources[name], self.rests[name] = own, rest
        self.system = system.with_signals(made)

    def influence(self, found: PredictionMinimum, name: str) -> Array:
        """Response (M, n, ne) of v: how an error in this input's prediction moves the minimum."""
        M, n = len(found.eps), found.layout.n
        z = circle(M)
        moved = np.zeros((M, 1 + len(self.names), 1), dtype=complex)
        moved[:, 1 + self.names.index(name), 0] = 1.0
        criterion = PredictionCriterion(found.layout, moved, np.ones(1))
        slope, psi_slope = criterion.errors(found.theta)  # of a unit impulse put into the input
        v = np.zeros((M, n, len(found.variances)), dtype=complex)
        late = z[:, None] ** (-np.arange(self.lags))
        for k in self.references:
            # E{ psi(t) d eps(t)/dh_m + d psi(t)/dh_m eps(t) } / lambda over m, by inverse FFT.
            both = found.psi[:, :, k] * np.conj(slope[:, :, 0])
            both = both + np.conj(psi_slope[:, :, 0]) * found.eps[:, :, k]
            weight = np.real(np.fft.ifft(both, axis=0))[: self.lags]
            v[:, :, k] = late @ weight
        return v

    def on_grid(self, found: PredictionMinimum, output: str, points: int) -> PredictionMinimum:
        """The minimum computed on more points."""
        from dataclasses import replace

        names = [output, *self.sources.values()]
        G = settled_response(self.system, [(n, 0, False) for n in names], names, None, points)
        eps, psi = PredictionCriterion(found.layout, G, found.variances).errors(found.theta)
        return replace(found, eps=eps, psi=psi)


def _impulses(system: LinearSignals, names: Sequence[str]) -> Array:
    """Impulse responses (lags, signals, externals), over half the grid."""
    G = settled_response(system, [(n, 0, False) for n in names], list(names))
    return np.asarray(np.real(np.fft.ifft(G, axis=0))[: len(G) // 2])


def _lasting(responses: Array) -> int:
    """Lags until all responses (lags, n, k) have fallen to `LEFT_OUT` of their peak."""
    size = np.abs(responses)
    large = np.any(size > LEFT_OUT * size.max(axis=(0, 2), initial=TINY)[:, None], axis=(1, 2))
    return int(np.flatnonzero(large)[-1]) + 1 if large.any() else 1
