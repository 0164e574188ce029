"""Arithmetic modulo a prime, on arrays: what a rank is decided with, exactly and fast.

Numbers are int64 in [0, p) with p < 2^31, so that a product fits and nothing is ever rounded.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from casid.arrays import Array
from casid.errors import ModelError

LOWEST_PRIME = 2**30
"""Primes are drawn from [2^30, 2^31)."""

PRIMES_THERE = 5.0e7
"""No fewer primes than this lie in [2^30, 2^31) (there are 50 697 537)."""


def random_prime(rng: np.random.Generator) -> int:
    """A prime drawn uniformly from [2^30, 2^31)."""
    while True:
        candidate = int(rng.integers(LOWEST_PRIME // 2, LOWEST_PRIME)) * 2 + 1
        if is_prime(candidate):
            return candidate


def is_prime(n: int) -> bool:
    """True if n is prime; Miller-Rabin with the bases that decide every n below 3.2e9.

    Source: G. Jaeschke, Math. Comp. 61 (1993) 915-926: bases 2, 3, 5, 7 decide n < 3 215 031 751.
    """
    if n < 2 or n >= 3_215_031_751:
        return False
    for q in (2, 3, 5, 7):
        if n % q == 0:
            return n == q
    odd, twos = n - 1, 0
    while odd % 2 == 0:
        odd, twos = odd // 2, twos + 1
    for base in (2, 3, 5, 7):
        x = pow(base, odd, n)
        if x in (1, n - 1):
            continue
        for _ in range(twos - 1):
            x = x * x % n
            if x == n - 1:
                break
        else:
            return False
    return True


def to_field(number: Fraction | int, p: int) -> int:
    """A rational number modulo p.

    Raises
    ------
    ZeroDivisionError
        If p divides the denominator.
    """
    number = Fraction(number)
    if number.denominator % p == 0:
        raise ZeroDivisionError(f"the denominator of {number} is a multiple of {p}")
    return number.numerator * pow(number.denominator, -1, p) % p


def to_rational(value: int, p: int) -> Fraction | None:
    """The one fraction a/b = value mod p with abs(a), b <= sqrt(p/2), or None.

    Source: P. S. Wang, Proc. SYMSAC 1981, 212-217; the extended Euclidean algorithm, stopped.
    """
    bound = int((p // 2) ** 0.5)
    r0, r1, t0, t1 = p, value % p, 0, 1
    while r1 > bound:
        q = r0 // r1
        r0, r1, t0, t1 = r1, r0 - q * r1, t1, t0 - q * t1
    if t1 == 0 or abs(t1) > bound:
        return None
    return Fraction(r1, t1)


def inverse(values: Array, p: int) -> Array:
    """Elementwise inverse, (n,) -> (n,): one inversion for all (Montgomery's trick).

    Raises
    ------
    ZeroDivisionError
        If an entry is zero.
    """
    flat = [int(v) for v in np.ravel(values)]
    before, product = [], 1
    for v in flat:
        before.append(product)
        product = product * v % p
    if product == 0:
        raise ZeroDivisionError("zero has no inverse")
    back = pow(product, -1, p)
    out = np.empty(len(flat), dtype=np.int64)
    for i in range(len(flat) - 1, -1, -1):
        out[i] = back * before[i] % p
        back = back * flat[i] % p
    return out.reshape(np.shape(values))


def matmul(a: Array, b: Array, p: int) -> Array:
    """Product of matrices, exact: in halves of 16 bits, which doubles multiply and add exactly.

    Parameters
    ----------
    a : (..., m, k), b : (..., k, n), int64 in [0, p). Sums of up to 64 products are exact at a
        time, so longer ones are cut.
    """
    k = a.shape[-1]
    total: Array | None = None
    for start in range(0, max(k, 1), 64):
        left, right = a[..., start : start + 64], b[..., start : start + 64, :].astype(np.float64)
        high, low = (left >> 16).astype(np.float64), (left & 0xFFFF).astype(np.float64)
        part = (high @ right).astype(np.int64) % p
        part = ((part << 16) + (low @ right).astype(np.int64)) % p
        total = part if total is None else (total + part) % p
    assert total is not None
    return total


def echelon(matrix: Array, p: int) -> tuple[Array, list[int]]:
    """Reduced row echelon form without zero rows, (r, n), and the r pivot columns."""
    a = np.array(matrix, dtype=np.int64) % p
    if a.ndim != 2:
        raise ModelError(f"a matrix has two dimensions, not {a.ndim}")
    pivots: list[int] = []
    row, (rows, columns) = 0, a.shape
    for column in range(columns):
        if row == rows:
            break
        there = np.flatnonzero(a[row:, column])
        if there.size == 0:
            continue
        best = row + int(there[0])
        if best != row:
            a[[row, best]] = a[[best, row]]
        a[row] = a[row] * pow(int(a[row, column]), -1, p) % p
        factors = a[:, column].copy()
        factors[row] = 0
        touched = np.flatnonzero(factors)
        if touched.size:
            a[touched] = (a[touched] - factors[touched, None] * a[row]) % p
        pivots.append(column)
        row += 1
    return a[:row], pivots


def rank(matrix: Array, p: int) -> int:
    """Rank of a matrix modulo p."""
    return len(echelon(matrix, p)[1])


def null_space(matrix: Array, p: int) -> Array:
    """(d, n) basis of all v with matrix @ v = 0, one for each column without a pivot."""
    reduced, pivots = echelon(matrix, p)
    n = matrix.shape[1]
    free = [j for j in range(n) if j not in set(pivots)]
    basis = np.zeros((len(free), n), dtype=np.int64)
    for i, j in enumerate(free):
        basis[i, j] = 1
        basis[i, pivots] = -reduced[:, j] % p
    return basis
