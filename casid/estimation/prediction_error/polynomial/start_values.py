"""Start values for the polynomial family, consistent where theory gives a consistent one.

A long ARX model comes first: its residuals replace e, and it whitens the noise. From it follow

- A, B, C by regression on past y, u and residuals (Hannan and Rissanen 1982; for ARMAX Mayne and
  Firoozan 1982);
- B_i/F_i by Steiglitz-McBride on the prefiltered, noise-free response that the long model gives
  each input (Everitt, Galrinho and Hjalmarsson 2018), and on the data themselves;
- C/D of the remainder, by Hannan-Rissanen.

Several candidates are returned; the caller takes the one with the smallest criterion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from casid.arrays import TINY, Array
from casid.estimation.cross_moments.moments import moments
from casid.estimation.prediction_error.polynomial.orders import (
    Layout,
    Polynomials,
    reflected,
    settling,
)

Data = Sequence[tuple[Array, Mapping[str, Array]]]
Candidate = tuple[str, Array, tuple[str, ...]]  # how it was found, theta, notes
Block = tuple[int, int, int]  # signal, first lag, number of lags
ROUNDS = 15  # of Steiglitz-McBride; it settles in a few, or circles


def regress(records: Sequence[Sequence[Array]], blocks: Sequence[Block], lags: int) -> Array:
    """Least squares of signal 0 on lags of signals, over t = lags .. N-1 of every record.

    By cross moments, scaled to unit diagonal: enough for a start.

    Parameters
    ----------
    records : the same signals, (N_r,) each, for every record; those too short are left out.
    blocks : regressors; lag 0 of signal 0 is the target and no regressor.
    """
    total: Array = np.zeros(())
    for signals in records:
        if len(signals[0]) > lags:
            named = {f"s{i}": signal for i, signal in enumerate(signals)}
            total = total + moments(named, lags).gram
    place = [s * (lags + 1) + k for s, first, n in blocks for k in range(first, first + n)]
    gram, right = total[np.ix_(place, place)], total[place, 0]
    size = np.sqrt(np.maximum(np.diag(gram), TINY))
    scaled = np.linalg.lstsq(gram / np.outer(size, size), right / size, rcond=1e-12)[0]
    return np.asarray(scaled / size)


def long_order(lengths: Sequence[int], signals: int, least: int) -> int:
    """Lags of the long model: 10 log10 N or `least`, fewer if the data are too few for them."""
    wanted = max(int(10 * np.log10(sum(lengths))), 2 * least + 4)
    return int(max(min(wanted, sum(lengths) // (4 * signals), max(lengths) // 3), 1))


def long_model(records: Sequence[Sequence[Array]], order: int) -> tuple[list[Array], list[Array]]:
    """AR polynomial and numerators (order + 1,) of signal 0 driven by the others, and residuals.

    Residuals are (N_r,), those of the first `order` samples from rest.
    """
    from scipy.signal import lfilter

    inputs = range(1, len(records[0]))
    theta = regress(records, [(0, 1, order), *((i, 0, order + 1) for i in inputs)], order)
    polynomials = [np.concatenate([[1.0], -theta[:order]])]
    polynomials += [theta[order:][(i - 1) * (order + 1) : i * (order + 1)] for i in inputs]
    residuals = []
    for signals in records:
        e = lfilter(polynomials[0], [1.0], signals[0])
        for i in inputs:
            e = e - lfilter(polynomials[i], [1.0], signals[i])
        residuals.append(e)
    return polynomials, residuals


def steiglitz_mcbride(
    pairs: Sequence[tuple[Array, Array]], nb: int, nf: int, nk: int
) -> tuple[Array, Array, tuple[complex, ...]]:
    """B and F of z = (B/F) x over pairs (z, x), and the roots of F that had to be reflected.

    Iterated least squares on z and x filtered by the last 1/F (Steiglitz and McBride 1965);
    consistent where z - (B/F) x is white. The best round is kept.
    """
    from scipy.signal import lfilter

    f: Array = np.ones(1)
    best: tuple[float, Array, Array, tuple[complex, ...]]
    best = (np.inf, np.zeros(nk + nb), np.concatenate([[1.0], np.zeros(nf)]), ())
    for _ in range(ROUNDS):
        filtered = pairs
        if len(f) > 1:
            filtered = [(lfilter([1.0], f, z), lfilter([1.0], f, x)) for z, x in pairs]
        theta = regress(filtered, [(0, 1, nf), (1, nk, nb)], max(nf, nk + nb - 1))
        new, out = reflected(np.concatenate([[1.0], -theta[:nf]]))
        b = np.concatenate([np.zeros(nk), theta[nf:]])
        with np.errstate(all="ignore"):
            value = sum(float(np.sum((z - lfilter(b, new, x)) ** 2)) for z, x in pairs)
        if value < best[0]:
            best = (value, b, new, out)
        still = len(new) == len(f) and bool(np.max(np.abs(new - f)) < 1e-6)
        f = new
        if still:
            break
    return best[1:]


def candidates(data: Data, layout: Layout) -> list[Candidate]:
    """Points of the model set with a stable predictor, from the best founded to the simplest."""
    if any(layout.nf) or (layout.nd and layout.inputs):
        return _with_own_dynamics(data, layout)
    return _equation_error(data, layout)


def _finish(label: str, layout: Layout, p: Polynomials, said: Sequence[str] = ()) -> Candidate:
    """Reflect what makes the predictor unstable, and say so."""
    notes = list(said)
    c, out = reflected(p.C)
    if out:
        notes.append(f"start: root of C reflected from {_roots(out)}")
    fs = []
    for name, f in zip(layout.inputs, p.F, strict=True):
        g, out = reflected(f)
        if out:
            notes.append(_said(name, out))
        fs.append(g)
    return label, layout.join(Polynomials(p.A, p.B, c, p.D, fs)), tuple(notes)


def _said(name: str, roots: Sequence[complex]) -> str:
    return f"start: root of F[{name}] reflected from {_roots(roots)}"


def _roots(roots: Sequence[complex]) -> str:
    return ", ".join(
        f"{r.real:.4g}" if abs(r.imag) < 1e-12 else f"{r.real:.4g} +/- {r.imag:.4g}i" for r in roots
    )


def _long(records: Sequence[Sequence[Array]], least: int) -> tuple[list[Array], list[Array], int]:
    order = long_order([len(r[0]) for r in records], len(records[0]), least)
    return *long_model(records, order), order


def _equation_error(data: Data, layout: Layout) -> list[Candidate]:
    """ARMAX and ARMA: regression on past outputs, inputs and residuals."""
    records = [[y, *(u[i] for i in layout.inputs)] for y, u in data]
    _, e_long, order = _long(records, layout.longest_lag + layout.nc)
    ar, nb = layout.na + layout.nd, sum(layout.nb)  # na or nd is zero here
    own = list(zip(layout.nk, layout.nb, strict=True))

    def found(label: str, residuals: Sequence[Array], nc: int, start: int) -> Candidate:
        """Start values by a regression on signals and residuals, from sample `start` on."""
        start = min(start, max(len(y) for y, _ in data) // 3)
        cut = [[s[start:] for s in (*r, e)] for r, e in zip(records, residuals, strict=True)]
        blocks = [(0, 1, ar), *((i + 1, k, n) for i, (k, n) in enumerate(own))]
        blocks.append((len(records[0]), 1, nc))
        theta = regress(cut, blocks, max(layout.longest_lag, layout.nc))
        a, b, c = -theta[:ar], theta[ar : ar + nb], np.zeros(layout.nc)
        c[:nc] = theta[ar + nb :]
        parts = [a[: layout.na], b, c, a[layout.na :]]
        return _finish(label, layout, layout.split(np.concatenate(parts)))

    first = found("Hannan-Rissanen", e_long, layout.nc, order)
    again = _errors(data, layout, first[1])
    second = found("Hannan-Rissanen, second round", again, layout.nc, 0)
    return [first, second, found("least squares, C = 1", e_long, 0, 0)]


def _with_own_dynamics(data: Data, layout: Layout) -> list[Candidate]:
    """OE, BJ and all with F or D beside inputs: B/F first, then C/D of the remainder."""
    from scipy.signal import lfilter

    shapes = list(zip(layout.inputs, layout.nb, layout.nf, layout.nk, strict=True))
    one: Array = np.ones(1)
    records = [[y, *(u[i] for i in layout.inputs)] for y, u in data]
    (a_long, *b_long), _, order = _long(records, layout.longest_lag)

    def complete(label: str, bs: list[Array], fs: list[Array], said: list[str]) -> list[Candidate]:
        """C and D of the remainder; A, whose roots G would share, starts at 1."""
        rest: list[tuple[Array, dict[str, Array]]] = []
        for y, u in data:
            total = y.copy()
            for name, b, f in zip(layout.inputs, bs, fs, strict=True):
                total -= lfilter(b, f, u[name])
            # What the record began with is in its first samples, and no noise.
            rest.append((total[min(settling(*fs), len(y) // 5) :], {}))
        noises = [("", one, one)]
        if layout.nc or layout.nd:
            noise = Layout((), 0, (), layout.nc, layout.nd, (), ())
            found = [(f"; {how}", noise.split(t)) for how, t, _ in _equation_error(rest, noise)]
            noises = [(how, p.C, p.D) for how, p in found]
        a = np.concatenate([one, np.zeros(layout.na)])
        return [
            _finish(label + how, layout, Polynomials(a, bs, c, d, fs), said) for how, c, d in noises
        ]

    # On the response that the long model gives to each input, where noise is white and gone.
    bs, fs, said = [], [], []
    for (name, nb, nf, nk), b in zip(shapes, b_long, strict=True):
        pairs = [(lfilter(b, [1.0], u[name]), lfilter(a_long, [1.0], u[name])) for _, u in data]
        own_b, own_f, out = steiglitz_mcbride(pairs, nb, nf, nk)
        if out:
            said.append(_said(name, out))
        bs.append(own_b)
        fs.append(own_f)
    points = complete("long ARX, then Steiglitz-McBride", bs, fs, said)
    # On the data themselves, one input after the other with the others' responses taken away.
    for label, prefilter in (("Steiglitz-McBride", one), ("prefiltered Steiglitz-McBride", a_long)):
        bs2, fs2, said2 = list(bs), list(fs), dict[str, str]()
        for _ in range(1 if len(shapes) == 1 else 3):
            for i, (name, nb, nf, nk) in enumerate(shapes):
                pairs = []
                for y, u in data:
                    total = y.copy()
                    for j, other in enumerate(layout.inputs):
                        if j != i:
                            total -= lfilter(bs2[j], fs2[j], u[other])
                    pairs.append(
                        (lfilter(prefilter, [1.0], total), lfilter(prefilter, [1.0], u[name]))
                    )
                bs2[i], fs2[i], out = steiglitz_mcbride(pairs, nb, nf, nk)
                said2.pop(name, None)
                if out:
                    said2[name] = _said(name, out)
        points += complete(label, bs2, fs2, list(said2.values()))
    return points


def _errors(data: Data, layout: Layout, theta: Array) -> list[Array]:
    """Prediction errors at theta, from rest."""
    from scipy.signal import lfilter

    p = layout.split(theta)
    out = []
    for y, u in data:
        v = lfilter(p.A, [1.0], y)
        for name, b, f in zip(layout.inputs, p.B, p.F, strict=True):
            v = v - lfilter(b, f, u[name])
        out.append(np.asarray(lfilter(p.D, p.C, v)))
    return out
