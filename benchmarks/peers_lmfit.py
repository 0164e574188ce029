"""The task solved by lmfit (Levenberg-Marquardt, finite differences) with a numba simulator."""

from __future__ import annotations

import lmfit
import numpy as np
from numba import njit

from benchmarks.oscillator import START, TS, read_record, report, start_position


@njit
def acceleration(x, v, f, m, d, d_2, k):  # type: ignore[no-untyped-def]
    """The acceleration (1)."""
    return (f - d * v - d_2 * abs(v) * v - k * x) / m


@njit
def residual(force, position, h, m, d, d_2, k, x, v):  # type: ignore[no-untyped-def]
    """(N,) simulated less measured position."""
    n = len(force)
    out = np.empty(n)
    for i in range(n):
        out[i] = x - position[i]
        f0, f2 = force[i], force[min(i + 1, n - 1)]
        f1 = 0.5 * (f0 + f2)
        a1 = acceleration(x, v, f0, m, d, d_2, k)
        v2 = v + h / 2 * a1
        a2 = acceleration(x + h / 2 * v, v2, f1, m, d, d_2, k)
        v3 = v + h / 2 * a2
        a3 = acceleration(x + h / 2 * v2, v3, f1, m, d, d_2, k)
        v4 = v + h * a3
        a4 = acceleration(x + h * v3, v4, f2, m, d, d_2, k)
        x += h / 6 * (v + 2 * v2 + 2 * v3 + v4)
        v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return out


def main() -> None:
    """Fit and report."""
    force, position = read_record()
    parameters = lmfit.Parameters()
    for name, start in START.items():
        parameters.add(name, value=start)
    parameters.add("x0", value=start_position(position))
    parameters.add("v0", value=0.0)

    def objective(p: lmfit.Parameters) -> np.ndarray:
        v = p.valuesdict()
        return np.asarray(
            residual(force, position, TS, v["m"], v["d"], v["d_2"], v["k"], v["x0"], v["v0"])
        )

    fit = lmfit.minimize(objective, parameters, method="leastsq")
    report(float(np.sum(np.square(fit.residual))), dict(fit.params.valuesdict()))


if __name__ == "__main__":
    main()
