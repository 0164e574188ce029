"""The likeliest parameters under a disturbance, which the model itself passes on to the outputs.

A sea excites the roll that is to be identified: the spectrum of what a force leaves in the outputs
is |G(theta)|^2 times that of the force, and depends on the parameters. Simulation errors whitened
under G of an earlier fit use none of this: their estimate is consistent, but where the disturbance
is most of the motion hardly anything determines it (a damping at zero, say), and the noise found
there is that of a wrong model. Here both parts of Whittle's likelihood count,

    sum_f log det S(f; theta, phi) + R(f; theta)^H S(f; theta, phi)^-1 R(f; theta)            (1)

with R the tapered residual's transform, S its spectra and cross-spectra, and phi variances and
shape of the spectrum (Pintelon and Schoukens, System Identification, 2nd ed. 2012, chapter 9).
Minimised by Fisher scoring, in bands of frequencies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from casid.arrays import TINY, Array
from casid.errors import SolveError
from casid.estimation.noise.model_spectra import ModelSpectra, completed
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.source_spectra import SourceSpectra
from casid.estimation.noise.variances import known_sources, with_rounding
from casid.estimation.noise.whittle_scoring import At, impossible, minimum, of_spectra
from casid.estimation.simulation.records.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError


def likeliest(
    criterion: SimulationError,
    x: Array,
    noise: NoiseModel,
    known: Mapping[str, float] | None = None,
) -> Array:
    """(n,) the variables that minimise (1), from `x` and the noise found there.

    Samples that are missing between others are drawn, given those and the noise; those at an end
    are left out. The same as given where most are missing, or where the likelihood does not rise.

    Parameters
    ----------
    criterion : in one segment a record.
    noise : at `x`; its forces with spectra keep the family of theirs.
    known : channel -> standard deviation that is not estimated.
    """
    signals = completed(criterion, x, noise)
    if criterion.segments > 1 or signals is None:
        return x
    search = DisturbanceLikelihood(
        criterion, noise, with_rounding(criterion.data, known or {}), signals
    )
    z = np.concatenate([x, search.start])
    return minimum(search.at, z, search.lower, search.upper)[0][: len(x)]


def errors(
    criterion: SimulationError,
    x: Array,
    noise: NoiseModel,
    known: Mapping[str, float] | None = None,
) -> Array:
    """(n,) standard errors at a minimum of (1), from Fisher's information; as for `likeliest`."""
    signals = [None] * len(criterion.data)
    search = DisturbanceLikelihood(
        criterion, noise, with_rounding(criterion.data, known or {}), signals
    )
    information = search.at(np.concatenate([x, search.start])).information
    size = np.sqrt(np.maximum(np.diag(information), TINY))
    inverse = np.linalg.pinv(information / np.outer(size, size), hermitian=True)
    return np.asarray((np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size)[: len(x)])


class DisturbanceLikelihood(ModelSpectra):
    """(1) over the variables of a criterion, log variances and log shapes of spectra."""

    def __init__(
        self,
        criterion: SimulationError,
        noise: NoiseModel,
        known: Mapping[str, float],
        signals: Sequence[Signals | None],
    ) -> None:
        stated = known_sources(known, criterion.model)
        sources = SourceSpectra(
            criterion.outputs, noise.output_sd, noise.source_sd, noise.spectra, (known, stated)
        )
        super().__init__(criterion, sources, signals)
        self.start = sources.start

    def at(self, z: Array) -> At:
        """Value, gradient and information at a point."""
        value, gradient = 0.0, np.zeros(len(z))
        information = np.zeros((len(z), len(z)))
        with np.errstate(all="ignore"):
            for e in range(len(self.criterion.data)):
                part = self._of_record(z, e)
                if not np.isfinite(part.value):
                    return impossible(len(z))
                value += part.value
                gradient += part.gradient
                information += part.information
        # Beside a point whose responses are finite they may overflow: nothing leads on from there.
        is_finite = np.all(np.isfinite(gradient)) and np.all(np.isfinite(information))
        return At(value if is_finite else np.inf, gradient, information)

    def _of_record(self, z: Array, e: int) -> At:
        n, lines = len(self.lower), self.lines(z, e)
        if lines is None:
            return impossible(len(z))
        R, J = lines.values[:, :, 0], lines.values[:, :, 1:]
        power = np.add.reduceat(R[:, :, None] * R[:, None, :].conj(), lines.edges)
        try:
            S, slopes = self.spectra(z, e, lines.omega)
        except SolveError:  # the response diverges there
            return impossible(len(z))
        at = of_spectra(z, S, slopes, lines.count, power / lines.count[:, None, None])
        if at is None:
            return impossible(len(z))
        # S^-1 at every line
        whole = np.repeat(np.linalg.inv(S), lines.count.astype(int), axis=0)
        weighted = np.einsum("fij,fj->fi", whole, R)
        at.gradient[:n] += 2 * np.real(np.einsum("fim,fi->m", J.conj(), weighted))
        white = np.einsum("fij,fjm->fim", whole, J)
        at.information[:n, :n] += 2 * np.real(np.einsum("fim,fik->mk", J.conj(), white))
        return at
