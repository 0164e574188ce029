"""Linear recursions x[t+1] = F x[t] + v[t] over long records."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from casid.arrays import Array


def recursion(F: Array, v: Array, x0: Array) -> Array:
    """x[t+1] = F x[t] + v[t] from x0: (N + 1, nx, ...) for v (N, nx, ...) and x0 (nx, ...).

    Schur form turns it into first-order filters, one after another: a compiled loop whatever F,
    defective ones included.
    """
    n, N = len(F), len(v)
    tail = v.shape[2:]
    columns = int(np.prod(tail)) if tail else 1
    time_last = np.ascontiguousarray(v.reshape(N, n, columns).transpose(1, 2, 0))
    x = recursion_time_last(F, time_last, np.reshape(x0, (n, columns)))
    return np.asarray(x.transpose(2, 0, 1).reshape(N + 1, n, *tail))


def recursion_time_last(F: Array, v: Array, x0: Array) -> Array:
    """The `recursion` with time last: (nx, m, N + 1) for v (nx, m, N), x0 (nx, m)."""
    n, columns, N = v.shape
    if n == 0:
        return np.zeros((0, columns, N + 1))
    # States of very different size, as other units make them, would cost each other their digits.
    balanced, (size, _) = linalg.matrix_balance(F, permute=False, separate=True)
    T, Z = linalg.schur(balanced, output="real")
    into, back = Z.T / size, Z * size[:, None]
    z = np.empty((n, columns, N + 1))
    z[:, :, 0] = into @ x0
    last = n
    while last:
        # A block on the diagonal of the real Schur form is one eigenvalue or a complex pair.
        first = last - 2 if last > 1 and T[last - 1, last - 2] != 0.0 else last - 1
        for i in range(first, last):
            _sum_of(into[i], v, z[i, :, 1:])
            for j in range(last, n):
                if T[i, j] != 0.0:
                    z[i, :, 1:] += T[i, j] * z[j, :, :-1]
        _filter_block(T[first:last, first:last], z[first:last])
        last = first
    out = np.empty((n, columns, N + 1))
    for row, x in zip(back, out, strict=True):
        _sum_of(row, z, x)
    return out


def _sum_of(weights: Array, rows: Array, out: Array) -> None:
    """out = sum_i weights[i] rows[i]: of few long rows quicker than a product with its threads."""
    np.multiply(weights[0], rows[0], out=out)
    for weight, row in zip(weights[1:], rows[1:], strict=True):
        out += weight * row


def _filter_block(T: Array, z: Array) -> None:
    """From a start and drives z (1 or 2, m, N + 1) to the states of a block T of a Schur form.

    A pair [[a, b], [c, a]] with b c < 0 is, its second state scaled, a rotation times its modulus:
    one complex filter for both states.
    """
    from scipy.signal import lfilter

    if len(T) == 1:
        pole, signal = T[0, 0], z[0]
    else:
        scale = np.sqrt(-T[0, 1] / T[1, 0])
        pole, signal = complex(T[0, 0], -T[0, 1] / scale), np.empty(z.shape[1:], complex)
        signal.real, signal.imag = z[0], scale * z[1]
    signal = lfilter([1.0], [1.0, -pole], signal)
    z[0] = signal.real
    if len(T) == 2:
        z[1] = signal.imag / scale
