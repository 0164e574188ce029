"""A static system with a known and an unknown input: the benchmark of Linder (2017), chapter 3.

    y_O = bK u_K + bU u_U + tau_O                                              (Example 3.1)
    u_K = delta1 + beta tau_u,   u_U = alpha delta1 + delta2 + tau_u

The externals are white, Gaussian and independent with variances l1, l2 (delta1, delta2, controlled
by the user), lu (tau_u, nobody's) and lO (tau_O). The unknown input is measured as
y_U = u_U + e_U, e_U with variance le (section 3.5); y_I = u_K + u_U + e_U is an indirect
measurement of it (Example 4.2).

`problem` is the errors-in-variables model (3.52), which takes the measurement for the input: its
least-squares estimate is biased by (3.55), which `signals` derives.
"""

from __future__ import annotations

import numpy as np

import casid
from casid.unknown_inputs.limits.linear_signals import LinearSignals

VALUES = {
    "alpha": 0.7,  # of delta1 in u_U
    "beta": 0.4,  # of tau_u in u_K
    "bK": 1.3,
    "bU": -0.8,
    "l1": 1.2,
    "l2": 0.6,
    "lu": 0.5,
    "lO": 0.3,
    "le": 0.4,
}
"""A numeric sample; any other may be given to `simulate` and `signals().at`."""

VARIANCES = {"delta1": "l1", "delta2": "l2", "tau_u": "lu", "tau_O": "lO", "e_U": "le"}


def signals() -> LinearSignals:
    """The symbolic benchmark, with both measurements of the unknown input.

    `u_I` is what y_I says of the unknown input, where its gains are known (Example 4.2); u_hat is
    a signal that the user takes for it (Example 3.5).
    """
    return LinearSignals.of(
        {
            "u_K": "delta1 + beta*tau_u",
            "u_U": "alpha*delta1 + delta2 + tau_u",
            "y_O": "bK*u_K + bU*u_U + tau_O",
            "y_U": "u_U + e_U",
            "y_I": "u_K + u_U + e_U",
            "u_I": "y_I - u_K",
            "u_hat": "a1*delta1 + a2*delta2",
        },
        VARIANCES,
    )


def model() -> casid.Model:
    """Example 3.1 with the unknown input still in it, and a constant level of the output.

    The level is zero in truth; it is the model's one state, and its start is estimated.
    """
    m = casid.Model("static system with an unknown input")
    level = m.state("level", "1")
    m.derivative(level, 0 * level)
    u_K = m.input("u_K", "1", hold="zoh", known=True)
    u_U = m.unknown_input("u_U", "1")
    bK, bU = m.parameter("bK", "1", start=1.0), m.parameter("bU", "1", start=-1.0)
    m.output("y_O", bK * u_K + bU * u_U + level, "1")
    m.output("y_U", u_U, "1")
    return m


def simulate(
    seed: int = 1, *, N: int = 1000, values: dict[str, float] | None = None
) -> casid.Record:
    """N samples of the benchmark, `values` in place of those of `VALUES`; no units."""
    v = VALUES | (values or {})
    unknown = set(v) - set(VALUES)
    if unknown:
        raise casid.ModelError(
            f"static_input has no value named {', '.join(sorted(unknown))}; it has "
            f"{', '.join(VALUES)}"
        )
    rng = np.random.default_rng(seed)
    drawn = {n: np.sqrt(v[own]) * rng.standard_normal(N) for n, own in VARIANCES.items()}
    delta1, delta2, tau_u = drawn["delta1"], drawn["delta2"], drawn["tau_u"]
    u_K = delta1 + v["beta"] * tau_u
    u_U = v["alpha"] * delta1 + delta2 + tau_u
    channels = {
        "u_K": u_K,
        "y_O": v["bK"] * u_K + v["bU"] * u_U + drawn["tau_O"],
        "y_U": u_U + drawn["e_U"],
        "y_I": u_K + u_U + drawn["e_U"],
        "delta1": delta1,
        "delta2": delta2,
    }
    return casid.Record(
        channels,
        dict.fromkeys(channels, "1"),
        Ts=1.0,
        name="static",
        provenance=(f"simulated by problems/static_input.py, seed {seed}",),
    )


def draw(seed: int) -> list[casid.Experiment]:
    """A thousand samples with noise from this seed."""
    return [casid.Experiment(simulate(seed), {}, "static")]


problem = casid.Problem(
    name="static_input",
    model=model().eliminate("u_U", using="y_U"),
    recorded={"delta1": "1", "delta2": "1", "y_I": "1"},
    example=lambda: draw(1),
    simulate=draw,
    truth={"bK": VALUES["bK"], "bU": VALUES["bU"]},
    description="A static system whose second input is measured with noise.",
    references=("J. Linder, Indirect System Identification for Unknown Input Problems, 2017",),
)
