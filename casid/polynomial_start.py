"""Start values for the polynomial family, consistent where theory gives a consistent one.

A long ARX model comes first: its residuals stand for e, and it whitens the noise. From it follow

- A, B, C by regression on past y, u and residuals (Hannan and Rissanen 1982; for ARMAX Mayne and
  Firoozan 1982);
- B_i/F_i by Steiglitz-McBride on the prefiltered, noise-free response that the long model gives
  each input (Everitt, Galrinho and Hjalmarsson 2018), and on the data themselves;
- C/D of what the inputs leave, by Hannan-Rissanen.

Several candidates are returned; whoever asks takes the one with the smallest criterion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casid.polynomial_orders import Layout, Polynomials, reflected

Array = NDArray[Any]
Data = Sequence[tuple[Array, Mapping[str, Array]]]
Candidate = tuple[str, Array, tuple[str, ...]]  # how it was found, theta, notes
ROUNDS = 15  # of Steiglitz-McBride; it settles in a few, or circles


def lagged(x: Array, first: int, count: int, start: int) -> Array:
    """x at lags first .. first + count - 1 as columns, rows t = start .. N-1."""
    n = len(x)
    assert start >= first + count - 1, "a lag would reach before the record"
    columns = [x[start - k : n - k] for k in range(first, first + count)]
    return np.stack(columns, axis=1) if columns else np.zeros((n - start, 0))


def solve_stacked(rows: Sequence[tuple[Array, Array]]) -> Array:
    """Least squares over stacked (Phi, y) by scaled normal equations; enough for a start."""
    gram = sum(phi.T @ phi for phi, _ in rows)
    right = sum(phi.T @ y for phi, y in rows)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    unit = np.asarray(gram) / np.outer(size, size)
    return np.asarray(np.linalg.lstsq(unit, right / size, rcond=1e-12)[0] / size)


def long_arx(data: Data, layout: Layout, order: int) -> tuple[Array, dict[str, Array], list[Array]]:
    """A (order + 1,), B_i (order + 1,) and the residuals, zero in the first `order` samples."""
    firsts = {i: min(nk, order) for i, nk in zip(layout.inputs, layout.nk, strict=True)}
    rows = []
    for y, u in data:
        parts = [-lagged(y, 1, order, order)]
        parts += [lagged(u[i], k, order - k + 1, order) for i, k in firsts.items()]
        rows.append((np.hstack(parts), y[order:]))
    theta = solve_stacked(rows)
    residuals = [np.concatenate([np.zeros(order), target - phi @ theta]) for phi, target in rows]
    a, place, b = np.concatenate([[1.0], theta[:order]]), order, {}
    for i, k in firsts.items():
        b[i] = np.concatenate([np.zeros(k), theta[place : place + order - k + 1]])
        place += order - k + 1
    return a, b, residuals


def long_order(data: Data, layout: Layout) -> int:
    """Lags of the long model: 10 log10 N, at least those of the orders, less if data are few."""
    shortest = min(len(y) for y, _ in data)
    total = sum(len(y) for y, _ in data)
    wanted = max(int(10 * np.log10(total)), 2 * (layout.longest_lag + layout.nc) + 4)
    paid = total // (4 * (1 + len(layout.inputs)))
    return int(max(min(wanted, paid, shortest // 3), 1))


def steiglitz_mcbride(
    pairs: Sequence[tuple[Array, Array]], nb: int, nf: int, nk: int
) -> tuple[Array, Array, tuple[complex, ...]]:
    """B and F of z = (B/F) x over pairs (z, x), and the last F's unstable roots, reflected.

    Iterated least squares on z and x filtered by the last 1/F (Steiglitz and McBride 1965);
    consistent where z - (B/F) x is white. The best round is kept.
    """
    from scipy.signal import lfilter

    f: Array = np.ones(1)
    best: tuple[float, Array, Array, tuple[complex, ...]]
    best = (np.inf, np.zeros(nk + nb), np.concatenate([[1.0], np.zeros(nf)]), ())
    first = max(nf, nk + nb - 1)
    for _ in range(ROUNDS):
        rows = []
        for z, x in pairs:
            zf, xf = (lfilter([1.0], f, s) if len(f) > 1 else s for s in (z, x))
            phi = np.hstack([-lagged(zf, 1, nf, first), lagged(xf, nk, nb, first)])
            rows.append((phi, zf[first:]))
        theta = solve_stacked(rows)
        new, out = reflected(np.concatenate([[1.0], theta[:nf]]))
        b = np.concatenate([np.zeros(nk), theta[nf:]])
        with np.errstate(all="ignore"):
            value = sum(float(np.sum((z - lfilter(b, new, x)) ** 2)) for z, x in pairs)
        if value < best[0]:
            best = (value, b, new, out)
        step = np.max(np.abs(np.subtract(new, f))) if len(new) == len(f) else np.inf
        f = new
        if step < 1e-6:
            break
    return best[1], best[2], best[3]


def hannan_rissanen(
    signals: Sequence[Array], residuals: Sequence[Array], na: int, nc: int, start: int
) -> tuple[Array, Array]:
    """AR and MA polynomials of signals whose innovations are nearly `residuals`."""
    start += max(na, nc)
    rows = [
        (np.hstack([-lagged(v, 1, na, start), lagged(e, 1, nc, start)]), v[start:])
        for v, e in zip(signals, residuals, strict=True)
    ]
    theta = solve_stacked(rows)
    one = np.ones(1)
    return np.concatenate([one, theta[:na]]), np.concatenate([one, theta[na:]])


def candidates(data: Data, layout: Layout) -> list[Candidate]:
    """Points of the model set with a stable predictor, from the best founded to the simplest."""
    order = long_order(data, layout)
    a_long, b_long, e_long = long_arx(data, layout, order)
    if any(layout.nf) or (layout.nd and layout.inputs):
        return _with_own_dynamics(data, layout, order, a_long, b_long)
    return _equation_error(data, layout, order, e_long)


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
            notes.append(f"start: root of F[{name}] reflected from {_roots(out)}")
        fs.append(g)
    return label, layout.join(Polynomials(p.A, p.B, c, p.D, fs)), tuple(notes)


def _roots(roots: Sequence[complex]) -> str:
    return ", ".join(
        f"{r.real:.4g}" if abs(r.imag) < 1e-12 else f"{r.real:.4g} +/- {r.imag:.4g}i" for r in roots
    )


def _equation_error(
    data: Data, layout: Layout, order: int, e_long: Sequence[Array]
) -> list[Candidate]:
    """ARMAX and ARMA: regression on past outputs, inputs and residuals."""
    reach = max(layout.longest_lag, layout.nc)

    def regress(label: str, residuals: Sequence[Array], nc: int, start: int) -> Candidate:
        rows = []
        for (y, u), e in zip(data, residuals, strict=True):
            begin = max(start, reach) if len(y) > start + reach + layout.n else reach
            parts = [-lagged(y, 1, layout.na + layout.nd, begin)]
            parts += [
                lagged(u[i], k, b, begin)
                for i, b, k in zip(layout.inputs, layout.nb, layout.nk, strict=True)
            ]
            rows.append((np.hstack([*parts, lagged(e, 1, nc, begin)]), y[begin:]))
        found = solve_stacked(rows)
        ar = layout.na + layout.nd  # one of them is zero here
        nb = sum(layout.nb)
        b, c = found[ar : ar + nb], np.concatenate([found[ar + nb :], np.zeros(layout.nc - nc)])
        parts = [found[: layout.na], b, c, found[layout.na : ar]]
        return _finish(label, layout, layout.split(np.concatenate(parts)))

    first = regress("Hannan-Rissanen", e_long, layout.nc, order + layout.nc)
    second = regress("Hannan-Rissanen, second round", _errors(data, layout, first[1]), layout.nc, 0)
    return [first, second, regress("least squares, C = 1", e_long, 0, 0)]


def _with_own_dynamics(
    data: Data, layout: Layout, order: int, a_long: Array, b_long: Mapping[str, Array]
) -> list[Candidate]:
    """OE, BJ and all with F or D beside inputs: B/F first, then C/D of what is left."""
    from scipy.signal import lfilter

    shapes = list(zip(layout.inputs, layout.nb, layout.nf, layout.nk, strict=True))
    out: list[Candidate] = []
    one: Array = np.ones(1)

    def complete(label: str, bs: list[Array], fs: list[Array], said: list[str]) -> None:
        rest = []
        for y, u in data:
            total = y.copy()
            for (name, *_), b, f in zip(shapes, bs, fs, strict=True):
                total -= lfilter(b, f, u[name])
            rest.append(total)
        a, c, d = np.concatenate([one, np.zeros(layout.na)]), one, one
        ar = layout.nd or layout.na
        if ar or layout.nc:
            noise = Layout((), ar, (), layout.nc, 0, (), ())
            p = long_order([(r, {}) for r in rest], noise)
            _, _, e = long_arx([(r, {}) for r in rest], noise, p)
            poly, c = hannan_rissanen(rest, e, ar, layout.nc, p)
            # With D the noise's poles are its own; without it they are A's, which G has too.
            if layout.nd:
                d = poly
        out.append(_finish(label, layout, Polynomials(a, bs, c, d, fs), said))

    # On the response that the long model gives to each input, in the domain where noise is white.
    bs, fs, said = [], [], []
    for name, nb, nf, nk in shapes:
        pairs = [
            (lfilter(b_long[name], [1.0], u[name]), lfilter(a_long, [1.0], u[name]))
            for _, u in data
        ]
        cut = [(z[order:], x[order:]) for z, x in pairs]
        b, f, roots = steiglitz_mcbride(cut, nb, nf, nk)
        if roots:
            said.append(f"start: root of F[{name}] reflected from {_roots(roots)}")
        bs.append(b)
        fs.append(f)
    complete("long ARX, then Steiglitz-McBride", bs, fs, said)
    # On the data themselves, one input after the other with the others' responses taken away.
    for label, prefilter in (("Steiglitz-McBride", one), ("prefiltered Steiglitz-McBride", a_long)):
        bs2, fs2 = list(bs), list(fs)
        said2: list[str] = []
        for _ in range(1 if len(shapes) == 1 else 3):
            said2 = []
            for i, (name, nb, nf, nk) in enumerate(shapes):
                pairs = []
                for y, u in data:
                    total = y.copy()
                    for j, (other, *_) in enumerate(shapes):
                        if j != i:
                            total -= lfilter(bs2[j], fs2[j], u[other])
                    pairs.append(
                        (lfilter(prefilter, [1.0], total), lfilter(prefilter, [1.0], u[name]))
                    )
                bs2[i], fs2[i], roots = steiglitz_mcbride(pairs, nb, nf, nk)
                if roots:
                    said2.append(f"start: root of F[{name}] reflected from {_roots(roots)}")
        complete(label, bs2, fs2, said2)
    return out


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
