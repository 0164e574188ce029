"""The task solved by jax-sysid: a custom state-space model, Adam and then L-BFGS.

The parameters are optimised relative to their start and the output to its standard deviation,
without regularisation, so that its optimum is the least-squares one and its L-BFGS well scaled.
"""

from __future__ import annotations

import argparse

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from jax_sysid.models import Model  # noqa: E402

from benchmarks.oscillator import START, TS, read_record, report, start_position  # noqa: E402


def main() -> None:
    """Fit and report."""
    parser = argparse.ArgumentParser()
    parser.add_argument("record")
    parser.add_argument("--adam-epochs", type=int, default=1000)
    epochs = parser.parse_args().adam_epochs
    force, position = read_record()
    size = jnp.array(list(START.values()))
    spread = float(np.std(position))
    h = TS

    def rate(x, f, p):  # type: ignore[no-untyped-def]
        m, d, d_2, k = p
        return jnp.stack([x[1], (f - d * x[1] - d_2 * jnp.abs(x[1]) * x[1] - k * x[0]) / m])

    @jax.jit
    def state_fcn(x, u, params):  # type: ignore[no-untyped-def]
        p = params[0] * size
        left, right = u[0], u[1]
        mid = 0.5 * (left + right)
        k1 = rate(x, left, p)
        k2 = rate(x + h / 2 * k1, mid, p)
        k3 = rate(x + h / 2 * k2, mid, p)
        k4 = rate(x + h * k3, right, p)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    @jax.jit
    def output_fcn(x, u, params):  # type: ignore[no-untyped-def]
        return x[0:1] / spread

    u = np.column_stack([force, np.append(force[1:], force[-1])])
    y = (position / spread)[:, None]
    model = Model(2, 1, 2, state_fcn=state_fcn, output_fcn=output_fcn, Ts=TS)
    model.init(params=[np.ones(4)], x0=np.array([start_position(position), 0.0]))
    model.loss(rho_x0=0.0, rho_th=0.0)
    model.optimization(adam_epochs=epochs, lbfgs_epochs=1000, iprint=-1)
    model.fit(y, u)
    simulated, _ = model.predict(jnp.asarray(model.x0), u)
    error = spread * np.asarray(simulated)[:, 0] - position
    values = dict(zip(START, np.asarray(model.params[0] * size).tolist(), strict=True))
    values |= dict(zip(("x0", "v0"), np.ravel(model.x0).tolist(), strict=True))
    report(float(error @ error), values)


if __name__ == "__main__":
    main()
