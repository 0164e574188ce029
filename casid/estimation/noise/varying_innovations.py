"""Innovations of a process whose response to its sources changes along a record.

What a slow force moves in a reactor of varying throughput, say, has no spectrum. Linearised at
every sample, with the spectrum of each source as a state-space model of its own,

    s_{k+1} = F s_k + v_k,    x_{k+1} = A_k x_k + B0_k h s_k + B1_k h s_{k+1},
    y_k = C_k x_k + D_k h s_k + w_k,                                                          (1)

it has innovations that a Kalman filter finds (B. D. O. Anderson and J. B. Moore, Optimal Filtering,
1979, chapters 4, 5 and 9). White sources s need no state: x_k - B1_{k-1} s_k does not depend on
s_k, and what that moves at the next sample it has in common with the output. The filter's gains are
found once; columns pass through it as the solution of a banded triangular system.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.linalg import expm
from scipy.linalg.lapack import dtbtrs

from casid.arrays import Array, BoolArray
from casid.estimation.noise.disturbance_spectrum import DisturbanceSpectrum
from casid.estimation.noise.joined_sources import joined_steps
from casid.estimation.noise.varying_steps import Steps
from casid.estimation.simulation.integration.machine_code import MachineCode

INTERPRETED = 6
"""States up to which CasADi interprets the recursion faster than NumPy takes it by matrices."""
WRITTEN_OUT = 16
"""States up to which the recursion is written out, operation by operation, for a compiler."""
BLOCK = 256
"""Samples that CasADi takes at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class Process:
    """(1) with all states in one, driven by white noise: what its variances are is said last.

    Attributes
    ----------
    a, c : (N, m, m), (N, n, m).
    enters, shows : (N, m, q), (N, n, q) what a unit of driving noise moves in the next state, and
        in the outputs at once.
    sources : (q,) the source of each.
    average : (m, m) of `a`; and `driven`, (q, m, m) of the outer products of what enters.
    variances : (q,) of the driving noise.
    white : (n,) those of the outputs' own noise.
    """

    a: Array
    c: Array
    enters: Array
    shows: Array
    sources: tuple[str, ...]
    average: Array
    driven: Array
    variances: Array
    white: Array

    def under(self, output_sd: Array, source_sd: Mapping[str, float]) -> Process:
        """The same under noise of other sizes, (n,) of each output and of each source."""
        variances = np.array([source_sd[name] ** 2 for name in self.sources])
        return replace(self, variances=variances, white=output_sd**2)

    @property
    def before(self) -> Array:
        """(m, m) covariance of the state at the first sample."""
        return _before(self.average, np.tensordot(self.variances, self.driven, 1), len(self.a))


class VaryingInnovations:
    """The innovations of one record of a process; like `innovations.Innovations`.

    Parameters
    ----------
    used : (N, n) the samples that there are, default all. Those of the others are zero.
    steps : of the simulation that the process is from, for those who seek other variances or
        spectra along the same path.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the covariance of a sample is not positive definite.
    """

    def __init__(
        self, process: Process, used: BoolArray | None = None, steps: Steps | None = None
    ) -> None:
        self.process, self._used, self.steps = process, used, steps
        seen = process
        if used is not None:  # what is missing shows nothing, and has one unit of white noise
            at = used[:, :, None]
            seen = replace(process, c=process.c * at, shows=process.shows * at)
        self._c = seen.c
        self._gains, self._roots = _gains_and_roots(seen, used)
        self._band = _bands(seen.a - self._gains @ seen.c)

    def whiten(self, columns: Array) -> Array:
        """e (N, n, m) of columns r (N, n, m), for the N that it is for."""
        columns = columns if self._used is None else columns * self._used[:, :, None]
        left = columns - np.einsum("kij,kjc->kic", self._c, self._states(columns, self._band))
        return np.asarray(np.einsum("kij,kjc->kic", self._roots, left))

    def transposed(self, columns: Array) -> Array:
        """The transpose of `whiten` times columns (N, n, m)."""
        left = np.einsum("kji,kjc->kic", self._roots, columns)
        states = _solved(self._band, np.einsum("kji,kjc->kic", self._c, left), "T")
        left[:-1] -= np.einsum("kji,kjc->kic", self._gains[:-1], states[1:])
        return np.asarray(left if self._used is None else left * self._used[:, :, None])

    def coloured(self, white: Array) -> Array:
        """The inverse of `whiten` of a complete record, of columns (N, n, m)."""
        errors = np.linalg.solve(self._roots, white)
        states = self._states(errors, _bands(self.process.a))
        return np.asarray(errors + np.einsum("kij,kjc->kic", self._c, states))

    def log_determinant(self, samples: int) -> float:
        """log det of the covariance of the samples that there are of so many."""
        assert samples == len(self._roots)
        return -2 * float(np.sum(self.log_roots))

    @property
    def log_roots(self) -> Array:
        """(N, n) logarithm of 1 / sd of what each output adds to those before; 0 where it lacks."""
        return np.asarray(np.log(np.einsum("kii->ki", self._roots)))

    def cut(self, rows: slice) -> VaryingInnovations:
        """The process in these rows alone."""
        p = self.process
        if rows == slice(0, len(p.a)):
            return self
        parts = {name: getattr(p, name)[rows] for name in ("a", "c", "enters", "shows")}
        return VaryingInnovations(replace(p, **parts))

    def _states(self, columns: Array, band: Array) -> Array:
        """(N, m, c) that columns (N, n, c) times the gains lead to."""
        states = np.zeros((len(columns), self._gains.shape[1], columns.shape[2]))
        states[1:] = np.einsum("kij,kjc->kic", self._gains[:-1], columns[:-1])
        return _solved(band, states, "N")


def _gains_and_roots(process: Process, used: BoolArray | None) -> tuple[Array, Array]:
    """Gains (N, m, n) and inverse roots (N, n, n) of the covariances of the innovations.

    Parameters
    ----------
    used : (N, n) the outputs that have their own noise; the others have one unit of it.
    """
    (N, n, m), q = process.c.shape, len(process.variances)
    lack = np.zeros((N, n)) if used is None else 1.0 - used
    if m > WRITTEN_OUT:
        return _by_numpy(process, lack)
    written_out = recursion(m, n, q)
    compiled = written_out.code.before(N)
    if compiled is None and m > INTERPRETED:
        return _by_numpy(process, lack)
    along = [process.a, process.c, process.enters, process.shows, lack]
    rows = np.concatenate([part.reshape(N, -1) for part in along], axis=1)
    state, sizes = process.before.ravel(), np.concatenate([process.variances, process.white])
    if compiled is None:
        found = written_out.interpreted(state, rows, sizes)
    else:
        found, nothing, place = np.empty((N, n * n + m * n)), np.empty(0), np.array([0.0, 0.5, 1.0])
        compiled(state, rows, rows, sizes, place, nothing, found, 0.0)
    roots, gains = found[:, : n * n].reshape(N, n, n), found[:, n * n :].reshape(N, m, n)
    if not np.all(np.isfinite(roots)):
        raise np.linalg.LinAlgError("Matrix is not positive definite")
    return gains, roots


def _by_numpy(process: Process, lack: Array) -> tuple[Array, Array]:
    """The same, sample by sample with NumPy's matrices."""
    a, c, P = process.a, process.c, process.before
    N, n, m = c.shape
    enters, shows = (part * process.variances for part in (process.enters, process.shows))
    own = process.white * (1.0 - lack) + lack
    gains, roots = np.empty((N, m, n)), np.empty((N, n, n))
    for k in range(N):
        seen = P @ c[k].T
        covariance = c[k] @ seen + shows[k] @ process.shows[k].T + np.diag(own[k])
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        half = (a[k] @ seen + enters[k] @ process.shows[k].T) @ root.T
        roots[k], gains[k] = root, half @ root
        P = a[k] @ P @ a[k].T - half @ half.T + enters[k] @ process.enters[k].T
        P = 0.5 * (P + P.T)
    return gains, roots


class _Recursion:
    """The Riccati recursion of (1) for m states, n outputs and q driving noises, written out.

    A step takes P (m m,), what stands in a row of the process, and the variances, and gives P at
    the next sample, the inverse root and the gain, all by rows.

    Attributes
    ----------
    code : its machine code, once it was taken often enough.
    """

    def __init__(self, m: int, n: int, q: int) -> None:
        shapes = [(m, m), (m, m), (n, m), (m, q), (n, q), (1, n)]
        symbols = [ca.SX.sym("of_sample", rows * columns) for rows, columns in shapes]
        P, a, c, enters, shows, lack = (
            ca.reshape(by_rows, columns, rows).T
            for by_rows, (rows, columns) in zip(symbols, shapes, strict=True)
        )
        sizes = ca.SX.sym("sizes", q + n)
        driven, white = ca.diag(sizes[:q]), sizes[q:]
        seen = P @ c.T
        own = ca.diag(white * (1 - lack.T) + lack.T)
        root = ca.solve(ca.chol(c @ seen + shows @ driven @ shows.T + own).T, ca.SX.eye(n))
        half = (a @ seen + enters @ driven @ shows.T) @ root.T
        after = a @ P @ a.T - half @ half.T + enters @ driven @ enters.T
        results = [0.5 * (after + after.T), root, half @ root]
        first, out = ca.vec(results[0]), ca.vertcat(*(ca.vec(each.T) for each in results[1:]))
        row, nothing = ca.vertcat(*symbols[1:]), ca.SX(0, 1)
        dense = [ca.densify(first), ca.densify(out), nothing]
        unused = [ca.SX.sym("after", row.numel()), sizes, ca.SX.sym("place", 3)]
        self.code = MachineCode(ca.Function("step", [symbols[0], row, *unused], dense), 0)
        step = ca.Function("step", [symbols[0], row, sizes], dense[:2])
        self._block = step.mapaccum(BLOCK)

    def interpreted(self, state: Array, rows: Array, sizes: Array) -> Array:
        """(N, n n + m n) of rows (N, .) of a process, by CasADi."""
        N = len(rows)
        # The last block is filled up with its last sample.
        filled = np.concatenate([rows, np.broadcast_to(rows[-1:], (-N % BLOCK, rows.shape[1]))])
        found = []
        for first in range(0, N, BLOCK):
            states, out = self._block(
                state, filled[first : first + BLOCK].T, np.tile(sizes[:, None], BLOCK)
            )
            state = states[:, -1]
            found.append(out.full().T)
        return np.concatenate(found)[:N]


@lru_cache(maxsize=16)
def recursion(m: int, n: int, q: int) -> _Recursion:
    """The recursion of m states, n outputs and q driving noises, written out once."""
    return _Recursion(m, n, q)


class PartialVarying:
    """Innovations of the recorded samples alone; like `missing_samples.PartialInnovations`."""

    def __init__(self, whole: VaryingInnovations, used: BoolArray) -> None:
        self._whole, self._used = whole, used
        self._partial = VaryingInnovations(whole.process, used)

    def whiten(self, columns: Array) -> Array:
        """e (N, n, m) of columns r (N, n, m); zero where samples are missing."""
        return self._partial.whiten(columns)

    def seen(self, white: Array) -> Array:
        """Columns (N, n, m), whitened as of a complete record, of the samples that there are."""
        return self.whiten(self._whole.coloured(white))

    def completed(self, white: Array, rng: np.random.Generator) -> Array:
        """Whitened columns (N, n, m) with white noise where samples are missing."""
        return np.where(self._used[:, :, None], white, rng.standard_normal(white.shape))

    def log_determinant(self, samples: int) -> float:
        """log det of the covariance of what there is of so many samples."""
        return self._partial.log_determinant(samples)


def varying_innovations(
    steps: Steps,
    output_sd: Array,
    source_sd: Mapping[str, float],
    spectra: Mapping[str, DisturbanceSpectrum],
    weights: Array,
    used: BoolArray | None = None,
) -> VaryingInnovations:
    """The innovations of one record, of outputs times `weights`.

    Parameters
    ----------
    output_sd : (ny,) white noise of each output.
    source_sd : of a sample of each source, whose spectrum is white or one of `spectra`.
    used : (N, ny) the samples that there are, default all.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the covariance of a sample is not positive definite.
    """
    joined = joined_steps(steps, spectra)
    moving = [n for n in joined.sources if source_sd.get(n, 0.0) > 0.0]
    process = process_of(joined, moving, spectra, weights)
    return VaryingInnovations(process.under(output_sd * weights, source_sd), used, steps)


def process_of(
    steps: Steps,
    moving: Sequence[str],
    spectra: Mapping[str, DisturbanceSpectrum],
    weights: Array,
) -> Process:
    """What `moving` sources of unit size drive in outputs times `weights`, without their own noise.

    Parameters
    ----------
    spectra : of the sources that are not white.
    """
    names = [n for n in moving if n in spectra]
    white = [n for n in moving if n not in spectra]
    places = [steps.sources.index(n) for n in names]
    forms = [_form(spectra[n], steps.Ts) for n in names]
    F, half, h = _of_sources(forms)
    N, nx, ns = len(steps.a), steps.a.shape[1], len(F)
    a = np.zeros((N, nx + ns, nx + ns))
    ahead = steps.b1[:, :, places] @ h
    a[:, :nx, :nx], a[:, nx:, nx:] = steps.a, F
    a[:, :nx, nx:] = steps.b0[:, :, places] @ h + ahead @ F
    c = np.concatenate([steps.c, steps.d[:, :, places] @ h], axis=2) * weights[:, None]
    moves, shows = _of_white(steps, white)
    enters = np.zeros((N, nx + ns, ns + len(white)))
    enters[:, :nx, :ns], enters[:, nx:, :ns], enters[:, :nx, ns:] = ahead @ half, half, moves
    shows = np.concatenate([np.zeros((N, len(weights), ns)), shows * weights[:, None]], axis=2)
    sources = [name for name, (f, _, _) in zip(names, forms, strict=True) for _ in f]
    along = enters.transpose(2, 1, 0)
    return Process(
        a,
        c,
        enters,
        shows,
        sources=(*sources, *white),
        average=a.mean(axis=0),
        driven=along @ along.swapaxes(1, 2) / N,
        variances=np.ones(ns + len(white)),
        white=np.zeros(len(weights)),
    )


def smoothed_sources(
    of: VaryingInnovations,
    steps: Steps,
    source_sd: Mapping[str, float],
    weights: Array,
    weighted: Array,
) -> dict[str, Array]:
    """(N,) what white sources are expected to have been, given outputs (N, n, 1) times `weights`.

    Their covariance with the outputs times the inverse of that of these: a smoother that goes back
    through the record once (J. Durbin and S. J. Koopman, Time Series Analysis by State Space
    Methods, 2nd ed. 2012, section 4.5).

    Parameters
    ----------
    source_sd : of each source that is sought.
    """
    left = of.transposed(of.whiten(weighted))[:, :, 0] * weights
    into = _solved(_bands(steps.a), np.einsum("kji,kj->ki", steps.c, left)[:, :, None], "T")[
        :, :, 0
    ]
    out = {}
    for name, sd in source_sd.items():
        j = steps.sources.index(name)
        before = np.concatenate([steps.b1[:1, :, j], steps.b1[:-1, :, j]])
        slope = np.einsum("ki,ki->k", before, into) + np.einsum("kj,kj->k", steps.d[:, :, j], left)
        slope[:-1] += np.einsum("ki,ki->k", steps.b0[:-1, :, j], into[1:])
        out[name] = sd**2 * slope
    return out


def _of_white(steps: Steps, names: Sequence[str]) -> tuple[Array, Array]:
    """Effect of white sources on the next state (N, nx, w), and on outputs at once (N, n, w).

    Of the state less what they move before a sample. The first is moved as the second is.
    """
    places = [steps.sources.index(n) for n in names]
    before = steps.b1[:, :, places]
    before = np.concatenate([before[:1], before[:-1]])
    return (
        steps.a @ before + steps.b0[:, :, places],
        steps.c @ before + steps.d[:, :, places],
    )


def _of_sources(forms: list[tuple[Array, Array, Array]]) -> tuple[Array, Array, Array]:
    """F (ns, ns), a root (ns, ns) of the covariance of v, and h (sources, ns) of all together."""
    ns = sum(len(f) for f, _, _ in forms)
    F, half, h, first = np.zeros((ns, ns)), np.zeros((ns, ns)), np.zeros((len(forms), ns)), 0
    for j, (f, root, out) in enumerate(forms):
        own = slice(first, first + len(f))
        F[own, own], half[own, own], h[j, own] = f, root, out
        first += len(f)
    return F, half, h


def _form(spectrum: DisturbanceSpectrum, Ts: float) -> tuple[Array, Array, Array]:
    """F, a root of the covariance of v, and h of one source of unit size, sampled."""
    w = spectrum.frequency
    if spectrum.damping is None:
        f = np.exp(-w * Ts)
        return np.array([[f]]), np.array([[np.sqrt(1 - f**2)]]), np.ones(1)
    F = expm(Ts * np.array([[0.0, w], [-w, -2 * spectrum.damping * w]]))
    # Both states of an oscillator that white noise drives have one variance, and nothing in common.
    values, vectors = np.linalg.eigh(np.eye(2) - F @ F.T)
    h = np.array([0.0, 1.0] if spectrum.is_band else [1.0, 0.0])
    return F, vectors * np.sqrt(np.maximum(values, 0.0)), h


def _before(a: Array, Q: Array, samples: int) -> Array:
    """(m, m) covariance of the state after so many samples from rest, by doubling."""
    a = a / max(1.0, float(np.max(np.abs(np.linalg.eigvals(a)))))
    P = Q.copy()
    for _ in range(int(np.ceil(np.log2(max(samples, 2))))):
        P, a = P + a @ P @ a.T, a @ a
    return np.asarray(0.5 * (P + P.T))


def _solved(band: Array, states: Array, side: str) -> Array:
    """x_k of x_{k+1} - M_k x_k = `states` (N, m, c), M by its `_bands`; or of the transpose."""
    N, m, count = states.shape
    if not count:  # of none, the routine writes where it should not
        return states
    found, _ = dtbtrs(band, states.reshape(N * m, count), uplo="L", trans=side, diag="U")
    return np.asarray(found).reshape(N, m, count)


def _bands(closed: Array) -> Array:
    """(2 m, N m) of the unit matrix less `closed` (N, m, m) one block below, by its diagonals."""
    N, m = closed.shape[:2]
    out = np.zeros((2 * m, N * m))
    out[0] = 1.0
    for i in range(m):
        for j in range(m):
            out[m + i - j, j : (N - 1) * m : m] = -closed[:-1, i, j]
    return out
