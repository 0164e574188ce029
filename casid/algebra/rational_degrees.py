"""Degrees of a rational function of one variable from its values modulo a prime.

Euclid's algorithm on the polynomial through the points passes the function at a large quotient.
Source: M. Monagan, Maximal quotient rational reconstruction, Proc. ISSAC 2004, 243-249.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from casid.algebra.prime_field import inverse


def univariate_degrees(t: Sequence[int], y: Sequence[int], p: int) -> tuple[int, int] | None:
    """Degrees of the one N/D that passes through all points with at least two of them to spare.

    Parameters
    ----------
    t, y : arguments, all different, and values modulo p.

    Returns
    -------
    (degree of N, degree of D) or None if no function of so low a degree passes; a zero function has
    (0, 0). A wrong answer has a probability of about len(t) / p.
    """
    if len(set(t)) < len(t):
        return None
    above, below = _product(t, p), _newton(t, y, p)
    degree = 0  # of the cofactor of y
    for quotient, rest_degree in _euclid(above, below, p):
        if quotient >= 3:
            return rest_degree, degree
        degree += quotient
    return (0, 0) if not below else None


def _euclid(a: list[int], b: list[int], p: int) -> Iterator[tuple[int, int]]:
    """Degrees of each quotient and its divisor in Euclid's algorithm."""
    while b:
        yield len(a) - len(b), len(b) - 1
        a, b = b, _remainder(a, b, p)


def _remainder(a: list[int], b: list[int], p: int) -> list[int]:
    a, scale = list(a), pow(b[-1], -1, p)
    while len(a) >= len(b):
        factor, shift = a[-1] * scale % p, len(a) - len(b)
        for j, c in enumerate(b):
            a[shift + j] = (a[shift + j] - factor * c) % p
        a.pop()
    return _trimmed(a)


def _trimmed(a: list[int]) -> list[int]:
    while a and a[-1] == 0:
        a.pop()
    return a


def _product(roots: Sequence[int], p: int) -> list[int]:
    out = [1]
    for r in roots:
        out = [(u - r * v) % p for u, v in zip([0, *out], [*out, 0], strict=True)]
    return out


def _newton(t: Sequence[int], y: Sequence[int], p: int) -> list[int]:
    """The polynomial through the points, low powers first (Newton's divided differences)."""
    c = list(y)
    for k in range(1, len(t)):
        gaps = inverse(np.array([(t[j] - t[j - k]) % p for j in range(k, len(t))]), p)
        for j in range(len(t) - 1, k - 1, -1):
            c[j] = (c[j] - c[j - 1]) * int(gaps[j - k]) % p
    out: list[int] = []
    for k in range(len(t) - 1, -1, -1):
        out = [(u - t[k] * v) % p for u, v in zip([0, *out], [*out, 0], strict=True)]
        out[0] = (out[0] + c[k]) % p
    return _trimmed(out)
