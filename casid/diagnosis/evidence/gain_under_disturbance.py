"""The gain in log-likelihood of an effect in a model that already has a random disturbance.

A disturbance with a free spectrum explains a large part of any residual, also of one that an effect
leaves. To compare the two, the signature of the effect and the tangent of the parameters are
regressed out of the residual, the disturbance is estimated again from the remainder, and the
log-likelihoods with and without the effect are compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.scores.signature_columns import Columns
from casid.diagnosis.evidence.whitening.weighted_model import Weighted, minus_log_likelihood
from casid.diagnosis.thresholds import DISTURBED
from casid.estimation.disturbances.disturbance_estimation import with_disturbance_spectra
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.variances import estimate_noise
from casid.estimation.noise.varying_likelihood import with_likeliest_noise
from casid.estimation.noise.varying_response import with_varying_response
from casid.estimation.noise.varying_steps import Steps
from casid.estimation.simulation.fit import within_bounds
from casid.estimation.simulation.simulation_error import SimulationError


def unwhitened(bare: Weighted) -> SimulationError:
    """The criterion of a model under a disturbance at the same point, weighted, not whitened."""
    at = bare.criterion
    return at.of_records(at.experiments, weights=at.weights, start=bare.fit.values)


def gains_under_disturbance(
    bare: Weighted,
    plain: Columns,
    effects: Sequence[int],
    *,
    known: Mapping[str, float],
    passing: float,
    under: NoiseModel | None = None,
) -> Iterator[float]:
    """The gains in log-likelihood that single effects give, one after another.

    The first gains are those under the disturbance adjusted once; only effects whose first gain is
    a share of `passing` (`DISTURBED.followed`) are computed with the disturbance estimated again,
    which takes ten times as long, the most promising ones first.

    Parameters
    ----------
    bare : the model without the effects, under the disturbance estimated from its residual.
    plain : columns of the extended model at the same point (`unwhitened`).
    effects : by their place among the effects of the columns.
    known : channel -> standard deviation of its white noise, where it is known.
    passing : the gain that decides.
    under : the noise under which effects are first regressed out, default `bare.noise`. Under slow
        disturbances an effect that sets in at an instant is missed if that one is not exact.
    """
    parts = [plain.of_record(plain.wide.start, e) for e in range(len(plain.wide.data))]
    residual, tangent, signatures = ([part[i] for part in parts] for i in range(3))
    path = [v.steps for v in bare.noise.varying if v.steps is not None]
    own = _Residual(bare, residual, known, bare.noise if under is None else under, path)

    def beside(effect: int) -> list[Array]:
        """The columns of the model's own unknowns and of the effect, of each record."""
        added = [s[:, [plain.judged[effect]]] for s in signatures]
        return [np.hstack(pair) for pair in zip(tangent, added, strict=True)]

    nothing = own.priced(tangent, 1)
    first = {i: nothing - own.priced(beside(i), 1) for i in effects}
    yield from first.values()
    more = sorted(effects, key=lambda i: -first[i])
    more = [i for i in more if first[i] > DISTURBED.followed * passing]
    if more:
        nothing = own.priced(tangent, 2)
    for i in more:
        yield nothing - own.priced(beside(i), 2)


@dataclass(frozen=True, slots=True)
class _Residual:
    """The residual of a model under a disturbance: (M,) weighted, of each record.

    A disturbance that is followed along a path keeps its places and the kind of its spectra.
    """

    bare: Weighted
    parts: Sequence[Array]
    known: Mapping[str, float]
    under: NoiseModel
    path: Sequence[Steps] = ()

    def priced(self, columns: Sequence[Array], rounds: int) -> float:
        """Minus the log-likelihood where columns (M, n) of each record explain a part of it.

        And the price of the disturbance's spectra: beside an effect they may be others, with more
        parameters. The disturbance is sought anew in what the columns leave; they, first under
        `under`, then under that. Of a single round the disturbance is the model's, adjusted. The
        first columns are those of the model's own unknowns.
        """
        bare, at, noise = self.bare, self.bare.criterion, self.under
        least = minus_log_likelihood(bare) + bare.noise.price_of_shapes(at.n_samples)
        near = bare.noise.spectra if rounds == 1 else None
        shapes = [(d.N, len(at.weights)) for d in at.data]
        for _ in range(rounds):
            step = self._step(noise, columns)
            of = [
                (r - c @ step).reshape(shape) / at.weights
                for r, c, shape in zip(self.parts, columns, shapes, strict=True)
            ]
            if self.path:
                noise = with_likeliest_noise(bare.noise, self.path, at, of)
            else:
                x = within_bounds(at, bare.fit.x + step[: len(bare.fit.x)])
                noise = estimate_noise(at, x, known=self.known, residuals=of)
                noise = with_disturbance_spectra(noise, at, x, self.known, residuals=of, near=near)
                noise = with_varying_response(noise, at, x, self.known, residuals=of)
            value = noise.minus_log_likelihood(of) + noise.price_of_shapes(at.n_samples)
            least = min(least, value)
        return least

    def _step(self, noise: NoiseModel, columns: Sequence[Array]) -> Array:
        """(n,) by how much the columns explain the residual best under a noise."""
        ny = len(self.bare.criterion.weights)
        parts = []
        for e, (r, c) in enumerate(zip(self.parts, columns, strict=True)):
            stack = np.column_stack([r, c]).reshape(-1, ny, 1 + c.shape[1])
            parts.append(noise.whiten(stack, e).reshape(len(r), -1))
        white = np.concatenate(parts)
        size = np.sqrt(np.maximum(np.einsum("ij,ij->j", white[:, 1:], white[:, 1:]), TINY))
        step = np.linalg.lstsq(white[:, 1:] / size, white[:, 0], rcond=None)[0]
        return np.asarray(step / size)
