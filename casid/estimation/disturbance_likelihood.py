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
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import rfft

from casid.arrays import TINY, Array
from casid.estimation.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.missing_samples import FILLED_FROM, unbroken
from casid.estimation.noise import NoiseModel, known_sources, with_rounding
from casid.estimation.noise_response import noise_response
from casid.estimation.residual_spectra import band_edges
from casid.estimation.simulation.signals import Signals
from casid.estimation.simulation.simulation_error import SimulationError

STEPS = 15
"""Of the scoring, at most."""
SETTLED = 0.02
"""Units of log-likelihood that a step promises, at which it ends."""
HALVINGS = 6
"""Of a step that does not raise the likelihood."""
DIFFERENCE = 1e-4
"""Relative change of a parameter over which responses are differentiated."""
LONGEST = 1.0
"""Change of the logarithm of a variance or of a spectrum's shape in one step, at most."""


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
    signals = _complete(criterion, x, noise)
    if criterion.segments > 1 or signals is None:
        return x
    search = _Likelihood(criterion, noise, with_rounding(criterion.data, known or {}), signals)
    z = np.concatenate([x, search.start])
    at = search.at(z)
    if not np.isfinite(at.value):
        return x
    damping = 1e-3
    for _ in range(STEPS):
        step = search.step(z, at, damping)
        if 0.5 * abs(float(step @ at.gradient)) < SETTLED:
            break
        for _ in range(HALVINGS):
            there = search.clipped(z + step)
            new = search.at(there)
            if new.value < at.value:
                break
            step, damping = 0.5 * step, 4 * damping
        else:
            break
        gained, z, at, damping = at.value - new.value, there, new, 0.25 * damping
        if gained < SETTLED:
            break
    return z[: len(x)]


def errors(
    criterion: SimulationError,
    x: Array,
    noise: NoiseModel,
    known: Mapping[str, float] | None = None,
) -> Array:
    """(n,) standard errors at a minimum of (1), from Fisher's information; as for `likeliest`."""
    signals = [None] * len(criterion.data)
    search = _Likelihood(criterion, noise, with_rounding(criterion.data, known or {}), signals)
    information = search.at(np.concatenate([x, search.start])).information
    size = np.sqrt(np.maximum(np.diag(information), TINY))
    inverse = np.linalg.pinv(information / np.outer(size, size), hermitian=True)
    return np.asarray((np.sqrt(np.maximum(np.diag(inverse), 0.0)) / size)[: len(x)])


def _complete(
    criterion: SimulationError, x: Array, noise: NoiseModel
) -> list[Signals | None] | None:
    """The records with a draw of what they miss at `x`, None of one that misses nothing in between.

    None where a record cannot be completed so.
    """
    rng = np.random.default_rng(0)
    out: list[Signals | None] = []
    for e, d in enumerate(criterion.data):
        if unbroken(d.used) is not None:  # of a late input the first samples are left out
            out.append(None)
            continue
        if d.used.mean() < FILLED_FROM:
            return None
        at = criterion.simulated(x, e)
        drawn = noise.filled(at.residual, e, rng) * d.relative_sizes
        y = np.where(d.used, d.y, at.y + drawn)
        out.append(replace(d, y=y, used=np.ones_like(d.used)))
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _At:
    """(1) at a point, its gradient and Fisher's information."""

    value: float
    gradient: Array
    information: Array


class _Likelihood:
    """(1) over the variables of a criterion, log variances and log shapes of spectra."""

    def __init__(
        self,
        criterion: SimulationError,
        noise: NoiseModel,
        known: Mapping[str, float],
        signals: Sequence[Signals | None],
    ) -> None:
        self.criterion, self.noise, self.signals = criterion, noise, signals
        self.sources = [n for n, sd in noise.source_sd.items() if sd > 0.0]
        self.free_outputs = [i for i, n in enumerate(criterion.outputs) if n not in known]
        stated = known_sources(known, criterion.model)
        self.free_sources = [n for n in self.sources if n not in stated]
        self.shaped = [n for n in self.free_sources if n in noise.spectra]
        logs = [2 * np.log(max(float(noise.output_sd[i]), TINY)) for i in self.free_outputs]
        logs += [2 * np.log(noise.source_sd[n]) for n in self.free_sources]
        for n in self.shaped:
            shape = noise.spectra[n]
            logs.append(np.log(shape.frequency))
            logs += [] if shape.damping is None else [np.log(shape.damping)]
        self.start = np.array(logs)
        self.lower = np.array([v.lower for v in criterion.variables])
        self.upper = np.array([v.upper for v in criterion.variables])

    def clipped(self, z: Array) -> Array:
        """Variables within their bounds."""
        n = len(self.lower)
        return np.concatenate([np.clip(z[:n], self.lower, self.upper), z[n:]])

    def step(self, z: Array, at: _At, damping: float) -> Array:
        """Of scoring; variables at a bound that it would cross stay there.

        A variance of next to nothing hardly counts, and its logarithm would go far: it goes no
        farther than `LONGEST`, and all others where they are likeliest beside it.
        """
        n = len(self.lower)
        free = np.ones(len(z), bool)
        free[:n] &= ~((z[:n] <= self.lower) & (at.gradient[:n] > 0))
        free[:n] &= ~((z[:n] >= self.upper) & (at.gradient[:n] < 0))
        size = np.sqrt(np.maximum(np.diag(at.information), TINY))
        matrix = at.information / np.outer(size, size) + damping * np.eye(len(z))
        slope = at.gradient / size
        found = np.zeros(len(z))
        while free.any():
            there = slope[free] + matrix[np.ix_(free, ~free)] @ (found * size)[~free]
            step = np.linalg.lstsq(matrix[np.ix_(free, free)], there, rcond=1e-12)[0]
            found[free] = -step / size[free]
            far = np.flatnonzero(free[n:] & (np.abs(found[n:]) > LONGEST)) + n
            if not len(far):
                break
            found[far] = LONGEST * np.sign(found[far])
            free[far] = False
        return found

    def at(self, z: Array) -> _At:
        """Value, gradient and information at a point."""
        value, gradient = 0.0, np.zeros(len(z))
        information = np.zeros((len(z), len(z)))
        with np.errstate(all="ignore"):
            for e in range(len(self.criterion.data)):
                part = self._of_record(z, e)
                if not np.isfinite(part.value):
                    return _At(np.inf, gradient, information)
                value += part.value
                gradient += part.gradient
                information += part.information
        # Beside a point whose responses are finite they may overflow: nothing leads on from there.
        is_finite = np.all(np.isfinite(gradient)) and np.all(np.isfinite(information))
        return _At(value if is_finite else np.inf, gradient, information)

    def _of_record(self, z: Array, e: int) -> _At:
        n, d = len(self.lower), self.criterion.data[e]
        x = z[:n]
        simulated = self.criterion.simulated(x, e, signals=self.signals[e])
        stack = np.concatenate([simulated.residual[:, :, None], -simulated.jacobian], axis=2)
        if self.signals[e] is None:
            stack = stack[unbroken(d.used) or slice(None)]
        N = len(stack)
        if not np.all(np.isfinite(stack)):
            return _At(np.inf, np.zeros(len(z)), np.zeros((len(z), len(z))))
        window = np.hanning(N + 2)[1:-1]
        window = window / np.sqrt(np.sum(window**2))
        lines = rfft(stack * window[:, None, None], axis=0)[1 : (N + 1) // 2]
        edges = np.maximum(band_edges(N)[:-1] - 1, 0)
        edges = np.unique(edges[edges < len(lines)])
        count = np.diff([*edges, len(lines)]).astype(float)
        omega = 2 * np.pi * np.add.reduceat(np.arange(1, len(lines) + 1), edges) / (count * N)
        S, slopes = self._spectra(z, e, omega)
        try:
            inverse = np.linalg.inv(S)
        except np.linalg.LinAlgError:  # outputs that one source moves and no other noise
            return _At(np.inf, np.zeros(len(z)), np.zeros((len(z), len(z))))
        _, logs = np.linalg.slogdet(S)
        whole = np.repeat(inverse, count.astype(int), axis=0)  # S^-1 at every line
        R, J = lines[:, :, 0], lines[:, :, 1:]
        weighted = np.einsum("fij,fj->fi", whole, R)
        value = float(count @ logs + np.real(np.einsum("fi,fi->", R.conj(), weighted)))
        gradient = np.zeros(len(z))
        information = np.zeros((len(z), len(z)))
        gradient[:n] = 2 * np.real(np.einsum("fim,fi->m", J.conj(), weighted))
        white = np.einsum("fij,fjm->fim", whole, J)
        information[:n, :n] = 2 * np.real(np.einsum("fim,fik->mk", J.conj(), white))
        power = np.add.reduceat(weighted[:, :, None] * weighted[:, None, :].conj(), edges)
        turned = {k: np.einsum("fij,fjk->fik", inverse, s) for k, s in slopes.items()}
        for k, s in slopes.items():
            fitted = float(np.real(count @ np.einsum("fii->f", turned[k])))
            gradient[k] += fitted - float(np.real(np.einsum("fij,fji->", s, power)))
            for m in slopes:
                if m <= k:
                    both = np.real(count @ np.einsum("fij,fji->f", turned[k], turned[m]))
                    information[k, m] += both
                    information[m, k] += both * (m != k)
        return _At(value, gradient, information)

    def _spectra(self, z: Array, e: int, omega: Array) -> tuple[Array, dict[int, Array]]:
        """S (F, ny, ny) at `omega`, and its derivative for each place of z that it depends on."""
        n, Ts = len(self.lower), self.criterion.data[e].Ts
        scales = self._scales(z[n:], omega, Ts)
        gains = self._gains(z[:n], e, omega)
        ny, of = len(self.criterion.outputs), [*self.free_outputs]
        white = self.noise.output_sd**2
        white[of] = np.exp(z[n : n + len(of)])
        parts = {s: _outer(gains[:, :, i]) for i, s in enumerate(self.sources)}
        S = np.zeros((len(omega), ny, ny), complex) + np.diag(white)
        for s, part in parts.items():
            S += scales[s][:, None, None] * part
        slopes: dict[int, Array] = {}
        for k, i in enumerate(of):
            one = np.zeros((ny, ny))
            one[i, i] = white[i]
            slopes[n + k] = np.broadcast_to(one, S.shape)
        first = n + len(of)
        for k, s in enumerate(self.free_sources):
            slopes[first + k] = scales[s][:, None, None] * parts[s]
        for k in range(first + len(self.free_sources), len(z)):
            moved = z.copy()
            moved[k] += DIFFERENCE
            after = self._scales(moved[n:], omega, Ts)
            (name,) = [s for s in self.shaped if not np.array_equal(after[s], scales[s])][:1] or (
                self.shaped[0],
            )
            slope = (after[name] - scales[name]) / DIFFERENCE
            slopes[k] = slope[:, None, None] * parts[name]
        for k, v in enumerate(self.criterion.variables):
            if v.source not in self.criterion.model.parameters:
                continue
            h = DIFFERENCE * max(abs(float(z[k])), v.scale)
            h = -h if z[k] + h > v.upper else h
            moved = z[:n].copy()
            moved[k] += h
            change = self._gains(moved, e, omega, is_beside=True)
            slope = sum(
                scales[s][:, None, None] * (_outer(change[:, :, i]) - parts[s]) / h
                for i, s in enumerate(self.sources)
            )
            if np.any(slope):
                slopes[k] = np.asarray(slope)
        return S, slopes

    def _gains(self, x: Array, e: int, omega: Array, *, is_beside: bool = False) -> Array:
        """(F, ny, ns) responses to the sources that there are; `is_beside` as they have it."""
        r = noise_response(self.criterion, x, e, omega=omega, is_beside=is_beside)
        assert r.gain is not None
        return r.gain[:, :, [r.sources.index(s) for s in self.sources]]

    def _scales(self, phi: Array, omega: Array, Ts: float) -> dict[str, Array]:
        """(F,) variance a sample of each source, by frequency."""
        k = len(self.free_outputs)
        found = {s: np.full(len(omega), self.noise.source_sd[s] ** 2) for s in self.sources}
        for s in self.free_sources:
            found[s] = np.full(len(omega), np.exp(phi[k]))
            k += 1
        for s in self.shaped:
            shape: DisturbanceSpectrum = self.noise.spectra[s]
            shape = replace(shape, frequency=float(np.exp(phi[k])))
            k += 1
            if shape.damping is not None:
                shape = replace(shape, damping=float(np.exp(phi[k])))
                k += 1
            found[s] = found[s] * shape.of(omega, Ts)
        return found


def _outer(g: Array) -> Array:
    """(F, ny, ny) g g^H of responses g (F, ny)."""
    return np.asarray(g[:, :, None] * g[:, None, :].conj())
