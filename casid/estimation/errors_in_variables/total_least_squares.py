"""Where to seek the root without bias, if noise on the inputs leads least squares far astray.

    sum_f R(f; theta)^H S(f; theta)^-1 R(f; theta)                                            (1)

with R the tapered residual's transform and S its spectra as the model passes on noise of given
sizes: the least changes of inputs and outputs, in units of their noise, with which the model agrees
(weighted total least squares; Pintelon and Schoukens, System Identification, 2nd ed. 2012, section
9.9). If noise of the inputs is most of the residual, least squares ends where the model hardly
answers to them, or at bounds, and no step of `equations` leads back from there. (1) has a gradient
of mean zero at the truth, and a minimum that may be descended to from far away. The logarithm of
det S is no part of it: the residual is simulated with the noisy input itself.

The response is an average one here and both ends of a record count for little, so that this is
where the search begins, not the estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.fft import rfft

from casid.arrays import TINY, Array
from casid.estimation.noise.model_spectra import ModelSpectra, completed
from casid.estimation.noise.noise_floor import white_floor
from casid.estimation.noise.noise_model import NoiseModel
from casid.estimation.noise.noise_response import noise_response
from casid.estimation.noise.source_spectra import SourceSpectra
from casid.estimation.noise.thresholds import FAR_ROOT
from casid.estimation.noise.whittle_scoring import At, impossible, minimum, step
from casid.estimation.simulation.initial_state import with_states_anew
from casid.estimation.simulation.simulation_error import SimulationError


def total_least_squares(
    criterion: SimulationError, starts: Sequence[Array], noise: NoiseModel
) -> Array | None:
    """(n,) the least minimum of (1) from `starts`; None where it is as good at the first of them.

    Parameters
    ----------
    starts : (n,) each.
    noise : of sensors and measured inputs, at the first start.
    """
    signals = completed(criterion, starts[0], noise)
    whole = [criterion.parts(e) == 1 for e in range(len(criterion.data))]
    if not all(whole) or signals is None or not any(noise.source_sd.values()):
        return None
    if not _may_lead_astray(criterion, starts, noise):
        return None
    of = list(range(len(criterion.outputs)))
    quiet = [white_floor([d.y[d.used[:, i], i] for d in criterion.data]) for i in of]
    # Far from the truth a residual says too much of them, or next to nothing.
    output_sd = np.where(np.array(quiet) > 0.0, quiet, noise.output_sd)
    stated = dict.fromkeys(criterion.outputs, 1.0), dict.fromkeys(noise.source_sd, 1.0)
    search = _TotalLeastSquares(
        criterion,
        SourceSpectra(criterion.outputs, output_sd, noise.source_sd, {}, stated),
        signals,
    )
    begun, x = search.at(starts[0]), None
    as_noise = FAR_ROOT.of_noise * len(of) * sum(d.N // 2 for d in criterion.data)
    if begun.value < as_noise and search.promise(starts[0], begun) < 2 * FAR_ROOT.nearer:
        return None
    least = begun.value - 2 * FAR_ROOT.nearer
    for start in starts:
        there, at = search.minimum(start)
        if at.value < least:
            least, x = at.value, there
    return None if x is None else _with_states(criterion, x, replace(noise, output_sd=output_sd))


def _may_lead_astray(
    criterion: SimulationError, starts: Sequence[Array], noise: NoiseModel
) -> bool:
    """Whether least squares may have left the truth to answer less to the noise of the inputs.

    Of noise with the spectrum N in a motion with the spectrum S, the most that any other response
    takes from the squares is N^2 / (S + N), as Wiener's filter does. Where all of it is less than
    `FAR_ROOT.nearer` in units of what is left, whatever else that is, it stays.
    """
    for e, d in enumerate(criterion.data):
        residual = np.where(d.used, criterion.simulated(starts[0], e).residual, 0.0)
        left = np.sum(residual**2, axis=0) / np.maximum(d.used.sum(axis=0), 1)
        for x in starts:
            r = noise_response(criterion, x, e, is_beside=x is not starts[0])
            sd = np.array([noise.source_sd.get(name, 0.0) for name in r.sources])
            passed = r.gain2 @ sd**2
            y, taper = criterion.simulate(x, e)[0], np.hanning(d.N)[:, None]
            moved = rfft(taper * (y - y.mean(axis=0)), 2 * (len(r.omega) - 1), axis=0)
            motion = np.abs(moved) ** 2 / np.sum(taper**2)
            gained = np.mean(passed**2 / np.maximum(motion + passed, TINY), axis=0)
            if not np.all(gained * np.sum(d.used) < 2 * FAR_ROOT.nearer * left):
                return True
    return False


class _TotalLeastSquares(ModelSpectra):
    """(1) over the variables of a criterion."""

    def promise(self, x: Array, at: At) -> float:
        """By how much a step promises to lower the value."""
        move = step(x, at, 0.0, self.lower, self.upper)
        return 0.5 * abs(float(move @ at.gradient))

    def minimum(self, x: Array) -> tuple[Array, At]:
        """The minimum from `x` (n,), and what is there."""
        x, at = minimum(self.at, x, self.lower, self.upper)
        for _ in range(FAR_ROOT.searches - 1):
            if self.promise(x, at) < 1.0:
                break
            x, at = minimum(self.at, x, self.lower, self.upper)
        return x, at

    def at(self, x: Array) -> At:
        """Value, gradient and information of Gauss and Newton at a point (n,)."""
        n = len(x)
        value, gradient, information = 0.0, np.zeros(n), np.zeros((n, n))
        with np.errstate(all="ignore"):
            for e in range(len(self.criterion.data)):
                lines = self.lines(x, e)
                if lines is None:
                    return impossible(n)
                S, slopes = self.spectra(x, e, lines.omega)
                if not np.all(np.isfinite(S)) or np.any(np.linalg.matrix_rank(S) < S.shape[1]):
                    return impossible(n)
                count = lines.count.astype(int)
                inverse = np.repeat(np.linalg.inv(S), count, axis=0)
                R, J = lines.values[:, :, 0], lines.values[:, :, 1:]
                white = np.einsum("fij,fj->fi", inverse, R)
                value += float(np.real(np.sum(R.conj() * white)))
                gradient += 2 * np.real(np.einsum("fim,fi->m", J.conj(), white))
                turned = np.einsum("fij,fjm->fim", inverse, J)
                information += 2 * np.real(np.einsum("fim,fik->mk", J.conj(), turned))
                power = np.add.reduceat(white[:, :, None].conj() * white[:, None, :], lines.edges)
                for k, slope in slopes.items():
                    gradient[k] -= float(np.real(np.sum(power * slope)))
        is_finite = np.all(np.isfinite(gradient)) and np.all(np.isfinite(information))
        return At(value if is_finite else np.inf, gradient, information)


def _with_states(criterion: SimulationError, x: Array, noise: NoiseModel) -> Array:
    """The variables with initial states that least whitened squares find; (1) hardly sees them."""
    responses = [noise_response(criterion, x, e) for e in range(len(criterion.data))]
    noise = replace(noise, responses=responses, varying=())
    return with_states_anew(criterion.whitened(noise.whiten), x, FAR_ROOT.of_states)
