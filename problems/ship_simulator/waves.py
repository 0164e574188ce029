"""Waves, wind and current, as forces on a ship on a straight course.

Spectra are one-sided densities of the elevation over frequency, S(w) [m^2 s/rad], so that the
variance is m_0 = int_0^inf S dw. Linder (2017), Appendix A.4; deep water throughout.

    S(w) = 0.2 Hs^2 w0^4 w^-5 exp(-1.25 (w0/w)^4) gamma^Y,
    Y = exp(-(w - w0)^2/(2 sigma^2 w0^2)), sigma = 0.07 up to w0, 0.09 above              (A.26)

The exponent Y is repaired: as printed it lost its square. The factor 0.2 is the one that suits
gamma = 3.3, 4 sqrt(m_0) = 0.988 Hs; at gamma = 1 it gives 0.8 Hs.

beta is the direction in which waves travel, from the bow to starboard: 0 in following seas, 90 deg
for waves that come from port. At speed U the frequency w is met as

    w_e = w - a w^2,  a = U cos(beta)/g    (A.28, without its modulus)

which turns back at w = 1/(2 a) in following seas: short waves are overtaken. There a spectrum of
encounter is a sum over up to three frequencies, each divided by |dw_e/dw| = |1 - 2 a w|.

What waves, wind and current do to the ship are simple transfer coefficients, stated at their
classes, and chosen for the model ship of `ship_4dof`: rough values, not measured ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casid.errors import DataError, SolveError

Array = NDArray[np.float64]
Spectrum = Callable[[Array], Array]
"""A one-sided density S(w) [m^2 s/rad] of arrays of frequencies w > 0 [rad/s]."""

G = 9.82
"""[m/s^2], that of Table 8.2."""


# -- spectra -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Jonswap:
    """JONSWAP (A.26).

    Attributes
    ----------
    Hs : significant height [m].
    w0 : frequency of the peak [rad/s].
    gamma : height of the peak, relative to gamma = 1.
    """

    Hs: float
    w0: float
    gamma: float = 3.3

    def __post_init__(self) -> None:
        _require_positive("JONSWAP", Hs=self.Hs, w0=self.w0, gamma=self.gamma)

    def __call__(self, w: Array) -> Array:
        """S(w) [m^2 s/rad]."""
        sigma = np.where(w <= self.w0, 0.07, 0.09)
        Y = np.exp(-((w - self.w0) ** 2) / (2.0 * sigma**2 * self.w0**2))
        return np.asarray(_bretschneider(w, 0.2, self.Hs, self.w0) * self.gamma**Y)


@dataclass(frozen=True, slots=True)
class PiersonMoskowitz:
    """Pierson-Moskowitz, of given height and peak: factor 5/16, 4 sqrt(m_0) = Hs exactly.

    Attributes
    ----------
    Hs : significant height [m].
    w0 : frequency of the peak [rad/s].
    """

    Hs: float
    w0: float

    def __post_init__(self) -> None:
        _require_positive("Pierson-Moskowitz", Hs=self.Hs, w0=self.w0)

    def __call__(self, w: Array) -> Array:
        """S(w) [m^2 s/rad]."""
        return _bretschneider(w, 0.3125, self.Hs, self.w0)


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedSpectrum:
    """A spectrum by its values, joined by straight lines, zero outside.

    Attributes
    ----------
    w : (n,) frequencies, increasing [rad/s].
    S : (n,) densities [m^2 s/rad].

    Raises
    ------
    DataError
        For a density that is negative or not finite, or frequencies that do not increase from 0.
    """

    w: Array
    S: Array

    def __post_init__(self) -> None:
        w, S = np.array(self.w, dtype=np.float64), np.array(self.S, dtype=np.float64)
        if w.ndim != 1 or w.shape != S.shape or w.size < 2:
            raise DataError(
                f"spectrum: w has shape {w.shape} and S {S.shape}. Give two (n,) arrays, n >= 2."
            )
        if np.any(np.diff(w) <= 0.0) or w[0] < 0.0:
            raise DataError("spectrum: its frequencies must increase from w >= 0. Sort them.")
        _require_energy(w, S)
        object.__setattr__(self, "w", w)
        object.__setattr__(self, "S", S)

    def __call__(self, w: Array) -> Array:
        """S(w) [m^2 s/rad]."""
        return np.asarray(np.interp(w, self.w, self.S, left=0.0, right=0.0))


def density(spectrum: Spectrum, w: Array) -> Array:
    """(n,) S(w), checked.

    Raises
    ------
    DataError
        Where the density is negative or not finite.
    """
    S = np.asarray(spectrum(w), dtype=np.float64)
    _require_energy(w, S)
    return S


def variance(spectrum: Spectrum, band: tuple[float, float], n: int = 20_000) -> float:
    """m_0 of a band [m^2], by the rule of midpoints in log(w)."""
    w, dw = _midpoints(band, n)
    return float(density(spectrum, w) @ dw)


def _bretschneider(w: Array, factor: float, Hs: float, w0: float) -> Array:
    w = np.asarray(w, dtype=np.float64)
    at = np.where(w > 0.0, w, np.inf)  # nothing at w <= 0
    with np.errstate(over="ignore"):
        S = factor * Hs**2 * w0**4 / at**5 * np.exp(-1.25 * (w0 / at) ** 4)
    return np.asarray(S)


def _midpoints(band: tuple[float, float], n: int) -> tuple[Array, Array]:
    if not 0.0 < band[0] < band[1] < math.inf:
        raise DataError(f"band {band} rad/s. Give 0 < lowest < highest frequency.")
    edges = np.geomspace(*band, n + 1)
    return np.sqrt(edges[1:] * edges[:-1]), np.diff(edges)


def _require_positive(what: str, **values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value < math.inf:
            raise DataError(f"{what}: {name} = {value!r}. Give a positive number.")


def _require_energy(w: Array, S: Array) -> None:
    bad = np.flatnonzero(~(np.isfinite(S) & (S >= 0.0)))
    if bad.size:
        i = int(bad[0])
        kind = "negative" if S[i] < 0.0 else "not finite"
        raise DataError(
            f"spectrum: the energy is {kind} at {bad.size} of {w.size} frequencies, "
            f"S = {S[i]:g} m^2 s/rad at w = {w[i]:g} rad/s. "
            "Correct the table, or set what an estimate left below zero to zero."
        )


# -- encounter -----------------------------------------------------------------------------------

Folded = Literal["refuse", "split"]


@dataclass(frozen=True, slots=True)
class Encounter:
    """A spectrum as a ship under way meets it (A.28), density over the frequency of encounter.

    Attributes
    ----------
    spectrum : of waves at a fixed place.
    U : speed of the ship [m/s].
    beta : direction of travel of the waves from the bow [rad]; 0: following.
    folded : "refuse", or "split": the sum over all frequencies that are met alike.
    share : of the variance that may lie beyond the fold without being refused.

    Raises
    ------
    SolveError
        If the spectrum is folded and that is not allowed.
    """

    spectrum: Spectrum
    U: float
    beta: float
    folded: Folded = "refuse"
    share: float = 1e-3

    def __post_init__(self) -> None:
        if self.folded == "refuse":
            require_unfolded(self.spectrum, self.U, self.beta, share=self.share)

    @property
    def a(self) -> float:
        """U cos(beta)/g [s/rad]."""
        return self.U * math.cos(self.beta) / G

    @property
    def highest(self) -> float:
        """Highest w_e of waves that overtake the ship, 1/(4 a) [rad/s]; infinite without a fold."""
        return 1.0 / (4.0 * self.a) if self.a > 0.0 else math.inf

    def branches(self, w_e: Array) -> list[tuple[Array, Array]]:
        """(w, dw/dw_e) of the up to three frequencies that are met as w_e > 0; nan where none is.

        In order: waves that overtake the ship, those beyond the fold that still do, and those that
        the ship overtakes.
        """
        a, w_e = self.a, np.asarray(w_e, dtype=np.float64)
        if a == 0.0:
            return [(w_e, np.ones_like(w_e))]
        with np.errstate(invalid="ignore", divide="ignore"):
            slow = np.sqrt(1.0 - 4.0 * a * w_e)  # |1 - 2 a w|
            found = [(2.0 * w_e / (1.0 + slow), 1.0 / slow)]
            if a > 0.0:
                fast = np.sqrt(1.0 + 4.0 * a * w_e)
                found.append(((1.0 + slow) / (2.0 * a), 1.0 / slow))
                found.append(((1.0 + fast) / (2.0 * a), 1.0 / fast))
        return found

    def __call__(self, w_e: Array) -> Array:
        """S_e(w_e) [m^2 s/rad]: sum of S(w)/|1 - 2 a w|; it has a pole at the fold."""
        total = np.zeros_like(np.asarray(w_e, dtype=np.float64))
        for w, jacobian in self.branches(w_e):
            there = np.isfinite(w) & np.isfinite(jacobian)
            part = np.zeros_like(total)
            part[there] = density(self.spectrum, w[there]) * jacobian[there]
            total = total + part
        return total


def require_unfolded(spectrum: Spectrum, U: float, beta: float, *, share: float = 1e-3) -> None:
    """Refuse a course on which the spectrum folds over.

    Raises
    ------
    SolveError
        If more than `share` of the variance lies above w = 1/(2 a).
    """
    a = U * math.cos(beta) / G
    if a <= 1e-12:  # head and beam seas
        return
    fold = 1.0 / (2.0 * a)
    ends = (1e-3 * fold, 1e3 * fold)
    below, above = variance(spectrum, (ends[0], fold)), variance(spectrum, (fold, ends[1]))
    part = above / (below + above) if above > 0.0 else 0.0
    if part > share:
        raise SolveError(
            f"waves: at U = {U:g} m/s and beta = {math.degrees(beta):.1f} deg the encounter folds "
            f"the spectrum at w = {fold:.3g} rad/s, {100 * part:.2g} % of the variance is beyond: "
            "two or three wave frequencies are met as one, and the Jacobian has a pole at "
            f"w_e = {fold / 2:.3g} rad/s. Take folded='split' for the sum over them, a sum of "
            "waves (Sea), which needs no Jacobian, or a lower speed or another course."
        )


# -- the shaping filter --------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ShapingFilter:
    """V(s) = K0 s/(s^2 + 2 zeta wa s + wa^2) (A.27), driven by white noise.

    The noise has the one-sided density 1 per rad/s, so that |V(j w)|^2 is the spectrum; as a
    process its intensity is pi.

    Attributes
    ----------
    K0 : gain; K0/(2 zeta wa) at the peak.
    zeta : relative damping.
    wa : frequency of the peak [rad/s].
    """

    K0: float
    zeta: float
    wa: float

    def __post_init__(self) -> None:
        _require_positive("shaping filter", K0=self.K0, zeta=self.zeta, wa=self.wa)

    def __call__(self, w: Array) -> Array:
        """|V(j w)|^2."""
        below = (self.wa**2 - w**2) ** 2 + (2.0 * self.zeta * self.wa * w) ** 2
        return np.asarray(self.K0**2 * w**2 / below)

    @property
    def variance(self) -> float:
        """int_0^inf |V|^2 dw = pi K0^2/(4 zeta wa)."""
        return math.pi * self.K0**2 / (4.0 * self.zeta * self.wa)

    def simulate(self, N: int, Ts: float, rng: np.random.Generator) -> Array:
        """(N,) samples of the stationary process, exact at any sample time [s]."""
        damping, square = 2.0 * self.zeta * self.wa, self.wa**2
        A = np.array([[-damping, -square], [1.0, 0.0]])
        values, vectors = np.linalg.eig(A.astype(np.complex128))
        if abs(values[0] - values[1]) < 1e-6 * self.wa:
            raise DataError(
                f"shaping filter: zeta = {self.zeta:g} makes its poles equal. "
                "Choose zeta a little off 1."
            )
        Ad = np.real(vectors * np.exp(values * Ts) @ np.linalg.inv(vectors))
        P = np.diag([math.pi / (2.0 * damping), math.pi / (2.0 * damping * square)])
        Q = P - Ad @ P @ Ad.T  # from the stationary covariance A P + P A' = -pi B B'
        step = _root(Q)
        x = np.sqrt(np.diag(P)) * rng.standard_normal(2)
        noise = rng.standard_normal((N, 2)) @ step.T
        (a, b), (c, d) = Ad.tolist()
        first, second = float(x[0]), float(x[1])
        y = np.empty(N)
        for i, (e, f) in enumerate(noise.tolist()):
            y[i] = first
            first, second = a * first + b * second + e, c * first + d * second + f
        return self.K0 * y


def _root(Q: Array) -> Array:
    values, vectors = np.linalg.eigh(Q)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def fit_shaping_filter(
    spectrum: Spectrum, band: tuple[float, float], *, n: int = 2000
) -> ShapingFilter:
    """The filter (A.27) whose |V|^2 is nearest to a spectrum, its variance being the spectrum's.

    Least squares in int (|V|^2 - S)^2 dw over zeta and wa; K0 follows from the variance in the
    band. Gauss-Newton in their logarithms, from the spectrum's own peak and width.

    Parameters
    ----------
    spectrum : to be approximated; of encounter, for a ship under way.
    band : of frequencies that count [rad/s].
    n : frequencies, equidistant in log(w).

    Raises
    ------
    SolveError
        If the iteration does not come to rest.
    """
    w, dw = _midpoints(band, n)
    S = density(spectrum, w)
    m0, peak = float(S @ dw), int(np.argmax(S))
    if not m0 > 0.0:
        raise SolveError(
            f"shaping filter: the spectrum has no energy between {band[0]:g} and {band[1]:g} "
            "rad/s. Widen the band."
        )

    def at(theta: Array) -> ShapingFilter:
        zeta, wa = math.exp(theta[0]), math.exp(theta[1])
        return ShapingFilter(math.sqrt(4.0 * zeta * wa * m0 / math.pi), zeta, wa)

    def residual(theta: Array) -> Array:
        return np.asarray((at(theta)(w) - S) * np.sqrt(dw))

    # |V(j wa)|^2 = m_0/(pi zeta wa) at the spectrum's peak
    theta = np.log([m0 / (math.pi * w[peak] * S[peak]), w[peak]])
    cost = float(np.sum(residual(theta) ** 2))
    for _ in range(100):
        h = 1e-6
        e = residual(theta)
        J = np.stack(
            [(residual(theta + h * d) - residual(theta - h * d)) / (2 * h) for d in np.eye(2)], 1
        )
        step = -np.linalg.lstsq(J, e, rcond=None)[0]
        size = 1.0
        while (new := float(np.sum(residual(theta + size * step) ** 2))) > cost and size > 1e-9:
            size *= 0.5
        if size <= 1e-9 or np.abs(size * step).max() < 1e-9:
            return at(theta)
        theta, cost = theta + size * step, new
    raise SolveError(
        "shaping filter: Gauss-Newton did not come to rest in 100 steps. "
        "Narrow the band to where the spectrum has its energy."
    )


# -- a sea, as a sum of waves --------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class WaveLoads:
    """What waves do to the ship.

    First order: the ship rides on the slope of the surface. With s(t) = sum kappa_i a_i
    sin(theta_i) exp(-kappa_i depth), the slope in the direction of travel, kappa = w^2/g, that
    fades towards a mean depth of the hull (Smith's effect),

        X = -c_X s cos(beta), Y = -c_Y s sin(beta), K = -c_K s sin(beta), N = -c_N s sin(2 beta)

    with no phase or length effects of the hull. Second order: Newman's difference frequencies with
    one coefficient, D |sum a_i exp(j theta_i)|^2, the squared envelope, mean D sum a_i^2:

        X = D_X cos(beta) .., Y = D_Y sin(beta) .., K = 0, N = D_N sin(2 beta) ..

    Attributes
    ----------
    c_X, c_Y : [N] per slope; the weight of 22.04 kg.
    c_K : [N m] per slope; k + S g of the nominal ship, so that it lies as the surface does.
    c_N : [N m] per slope.
    D_X, D_Y : [N/m^2], D_N [N m/m^2]; D_Y is rho g L/2 with a tenth of the amplitude squared
        reflected.
    depth : [m]; half the draft.
    """

    c_X: float = 216.4
    c_Y: float = 216.4
    c_K: float = 4.3
    c_N: float = 5.0
    D_X: float = 80.0
    D_Y: float = 390.0
    D_N: float = 40.0
    depth: float = 0.072


@dataclass(frozen=True, slots=True, eq=False)
class Sea:
    """Waves by spectrum sampling, as met by a ship at constant speed and course.

    elevation(t) = sum a_i cos(theta_i), theta_i = w_ei t + eps_i, w_ei = w_i - a w_i^2 signed:
    no wave is lost or counted twice, whatever the course.

    Attributes
    ----------
    w : (n,) frequencies at a fixed place [rad/s].
    amplitude : (n,) a_i [m].
    phase : (n,) eps_i [rad].
    U, beta : speed [m/s], direction of travel of the waves from the bow [rad].
    """

    w: Array
    amplitude: Array
    phase: Array
    U: float = 0.0
    beta: float = 0.0

    @property
    def w_e(self) -> Array:
        """(n,) frequencies of encounter [rad/s], negative where the ship overtakes the wave."""
        return self.w - self.w**2 * (self.U * math.cos(self.beta) / G)

    @property
    def variance(self) -> float:
        """sum a_i^2/2 [m^2]."""
        return float(self.amplitude @ self.amplitude / 2.0)

    def analytic(self, t: Array, weights: ArrayLike = 1.0) -> NDArray[np.complex128]:
        """(N,) sum of weights_i a_i exp(j theta_i) at uniform times t [s]."""
        c = np.asarray(weights) * self.amplitude * np.exp(1j * self.phase)
        t = np.asarray(t, dtype=np.float64)
        block = 2048
        Ts = float(t[1] - t[0]) if t.size > 1 else 0.0
        if t.size > 2 and not np.allclose(np.diff(t), Ts, rtol=1e-6, atol=0.0):
            raise DataError("waves: times are not uniform. Give t = t0 + Ts k.")
        within = np.exp(1j * np.outer(Ts * np.arange(min(block, t.size)), self.w_e))
        parts = [
            (within @ (c * np.exp(1j * self.w_e * t[i])))[: t.size - i]
            for i in range(0, t.size, block)
        ]
        return np.concatenate(parts)

    def elevation(self, t: Array) -> Array:
        """(N,) elevation of the surface at the ship [m], up."""
        return np.asarray(self.analytic(t).real)

    def slope(self, t: Array, depth: float = 0.0) -> Array:
        """(N,) slope of the surface in the direction of travel, attenuated to a depth [m]."""
        kappa = self.w**2 / G
        return np.asarray(self.analytic(t, kappa * np.exp(-kappa * depth)).imag)

    def forces(
        self,
        t: Array,
        loads: WaveLoads | None = None,
        *,
        drift: bool = True,
        turn: float = 0.0,
    ) -> Array:
        """(N, 4) force in surge and sway [N], torque in roll and yaw [N m]; see `WaveLoads`.

        Parameters
        ----------
        t : (N,) uniform times [s].
        loads : transfer coefficients.
        drift : with second-order slow drift.
        turn : by which the ship's heading is off her course, to starboard [rad]. The waves then
            act from another side; they are met as often as on the course, which `beta` is from.
        """
        q, beta = loads or WaveLoads(), self.beta - turn
        cos, sin, twice = math.cos(beta), math.sin(beta), math.sin(2.0 * beta)
        first = -np.array([q.c_X * cos, q.c_Y * sin, q.c_K * sin, q.c_N * twice])
        made = np.outer(self.slope(t, q.depth), first)
        if drift:
            second = np.array([q.D_X * cos, q.D_Y * sin, 0.0, q.D_N * twice])
            made += np.outer(np.abs(self.analytic(t)) ** 2, second)
        return made


def sample_sea(
    spectrum: Spectrum,
    band: tuple[float, float],
    *,
    seed: int,
    n: int = 400,
    U: float = 0.0,
    beta: float = 0.0,
    gaussian: bool = False,
) -> Sea:
    """Draw a sea: one wave in each of n equal parts of a band, at a random place in it.

    Parameters
    ----------
    spectrum : at a fixed place.
    band : [rad/s]; what lies outside is left out.
    seed : of phases and places.
    U, beta : of `Sea`.
    gaussian : amplitudes are random too (Rayleigh), so that the sea is Gaussian exactly, and its
        variance varies from draw to draw; otherwise a_i = sqrt(2 S(w_i) dw).

    Raises
    ------
    DataError
        For negative energy, or a band that is not one.
    """
    _midpoints(band, 1)
    rng = np.random.default_rng(seed)
    edges = np.linspace(*band, n + 1)
    dw = np.diff(edges)
    w = edges[:-1] + dw * rng.random(n)
    amplitude = np.sqrt(2.0 * density(spectrum, w) * dw)
    if gaussian:
        amplitude = amplitude * rng.rayleigh(math.sqrt(0.5), n)
    return Sea(w, amplitude, rng.uniform(0.0, 2.0 * math.pi, n), U, beta)


# -- wind and current ----------------------------------------------------------------------------


def gauss_markov(
    N: int, Ts: float, *, deviation: float, time_constant: float, rng: np.random.Generator
) -> Array:
    """(N,) samples of a stationary first-order process, exact at any sample time [s]."""
    _require_positive("gusts", time_constant=time_constant, Ts=Ts)
    keep = math.exp(-Ts / time_constant)
    noise = (deviation * math.sqrt(1.0 - keep**2) * rng.standard_normal(N)).tolist()
    value, made = float(deviation * rng.standard_normal()), np.empty(N)
    for i in range(N):
        made[i] = value
        value = keep * value + noise[i]
    return made


@dataclass(frozen=True, slots=True)
class Wind:
    """Mean and gust, on a straight course.

    The relative wind has V_x = V cos(beta) - U and V_y = V sin(beta) in the ship's axes, and

        X = q C_X A_F V_x |V_r|, Y = q C_Y A_L V_y |V_r|, K = height Y,
        N = q C_N A_L L sin(2 angle) |V_r|^2,  q = rho/2, angle = atan2(V_y, V_x)

    Gusts are first-order Gauss-Markov, a stated stand-in for a gust spectrum.

    Attributes
    ----------
    speed : mean [m/s].
    beta : direction in which it blows, from the bow [rad]; 0: from astern.
    gust : standard deviation [m/s].
    time_constant : of gusts [s].
    C_X, C_Y, C_N : drag coefficients; chosen.
    A_F, A_L, L, height : frontal and lateral areas [m^2], length [m], centre of the lateral area
        above the CO [m]; chosen for the model.
    rho : density of air [kg/m^3].
    """

    speed: float
    beta: float
    gust: float = 0.0
    time_constant: float = 5.0
    C_X: float = 0.6
    C_Y: float = 0.8
    C_N: float = 0.05
    A_F: float = 0.06
    A_L: float = 0.15
    L: float = 0.85
    height: float = 0.1
    rho: float = 1.225

    def forces(self, N: int, Ts: float, *, U: float, seed: int, turn: float = 0.0) -> Array:
        """(N, 4) force in surge and sway [N], torque in roll and yaw [N m].

        `turn` is by how much the heading is off the course, to starboard [rad].
        """
        rng = np.random.default_rng(seed)
        V = self.speed + gauss_markov(
            N, Ts, deviation=self.gust, time_constant=self.time_constant, rng=rng
        )
        beta = self.beta - turn
        V_x, V_y = V * math.cos(beta) - U, V * math.sin(beta)
        V_r, q = np.hypot(V_x, V_y), self.rho / 2.0
        Y = q * self.C_Y * self.A_L * V_y * V_r
        return np.stack(
            [
                q * self.C_X * self.A_F * V_x * V_r,
                Y,
                self.height * Y,
                q * self.C_N * self.A_L * self.L * 2.0 * V_x * V_y,
            ],
            axis=1,
        )


@dataclass(frozen=True, slots=True)
class Current:
    """A current, the same everywhere, that changes slowly.

    Attributes
    ----------
    speed : mean [m/s].
    course : where it flows to, from north to east [rad].
    deviation : standard deviation of either component [m/s].
    time_constant : of its changes [s].
    """

    speed: float
    course: float
    deviation: float = 0.0
    time_constant: float = 60.0

    def velocity(self, N: int, Ts: float, *, seed: int) -> Array:
        """(N, 2) velocity of the water, north and east [m/s]."""
        rng = np.random.default_rng(seed)
        mean = self.speed * np.array([math.cos(self.course), math.sin(self.course)])
        change = [
            gauss_markov(N, Ts, deviation=self.deviation, time_constant=self.time_constant, rng=rng)
            for _ in range(2)
        ]
        return np.asarray(mean + np.stack(change, axis=1))
