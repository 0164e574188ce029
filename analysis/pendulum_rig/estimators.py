"""The estimators of the laboratory rig, and the clouds that their uncertainty makes.

Linder (2017), section 7.5.2: instruments from the cart's inertial unit with F_delta = 1, n_delta,0
= 4, n_delta = 0, n_y = n_u = 4; step 1 is M and z_g, step 2 I_x, d, k from the nominal record, step
3 m, z_m from the loaded one; joint takes all five from both.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from casid.arrays import Array
from casid.estimation.moments.instruments.instruments import Instruments
from casid.estimation.moments.stages.moment_estimate import MomentEstimate
from casid.estimation.moments.stages.moment_settings import MomentSettings
from casid.estimation.moments.stages.prior import Prior
from casid.estimation.moments.stages.propagation import jacobian_of
from casid.estimation.moments.stages.stage_plan import StageSpec
from casid.identification.moment_estimators import Reusable
from problems import pendulum_rig as rig

MODEL = rig.problem.model.with_unknown(m=0.08, z_m=-0.1)
INSTRUMENTS = Instruments("ref", initial="reference", n_delta0=4, n_delta=0, n_y=4, n_u=4)
STEPS = (StageSpec(["I_x", "d", "k"], ["nominal"]), StageSpec(["m", "z_m"], ["loaded"]))
FREE = ("I_x", "d", "k", "m", "z_m")
NOISE_MODELS: Mapping[str, tuple[int, int] | None] = {"(7.58)": (0, 4), "(7.60)": None}

TILTED = Prior({"M": 1.324, "z_g": -0.0211}, {"M": 0.002, "z_g": 0.0002})
"""Step 1 from a balance (2 g) and a tilting test (0.2 mm)."""

TRUTH = {
    **{n: rig.TABLES_7_3_AND_7_4[n] for n in ("I_x", "m", "z_m")},
    "d": rig.DAMPING,
    "k": rig.STIFFNESS,
}


def staged(noise_model: str = "(7.60)", **settings: Any) -> Reusable:
    """Multi-stage (Approach 7.1): every step a linear program."""
    chosen = MomentSettings(form="linear", noise_model=NOISE_MODELS[noise_model], **settings)
    return Reusable(MODEL, STEPS, INSTRUMENTS, settings=chosen)


def joint(noise_model: str = "(7.60)", **settings: Any) -> Reusable:
    """Joint (Approach 7.2): all five parameters from both records."""
    chosen = MomentSettings(noise_model=NOISE_MODELS[noise_model], **settings)
    return Reusable(MODEL, (StageSpec(FREE),), INSTRUMENTS, settings=chosen)


def bilinear_offset(Ts: float) -> dict[str, float]:
    """How far the bilinear transform moves I_x and k where the nominal pendulum resonates.

    With W = (2/T) tan(w T/2) = w (1 + e w^2), e = T^2/12, in place of w, the regression
    gyro (k - I_2 w^2 + j d w) + S j w accel = 0 is left by gyro (dk - dI_2 w^2 - e k w^2 -
    e I_2 w^4), which vanishes to first order around the resonance w_0 of (7.10), where the power
    is, for dI_2 = -e (k + 2 I_2 w_0^2) and dk = -e I_2 w_0^4.
    """
    plant = rig.Pendulum()
    e = Ts**2 / 12
    I_2 = plant.I_1 - rig.TABLES_7_3_AND_7_4["z_s"] * plant.S
    w2 = (plant.k + plant.S * rig.G) / plant.I_1
    return {"I_x": -e * (plant.k + 2 * I_2 * w2), "k": -e * I_2 * w2**2}


def derived(values: Mapping[str, float]) -> dict[str, float]:
    """What Table 7.5 compares, SI units."""
    m, z_m = values["m"], values["z_m"]
    return {"I_x": values["I_x"], "m": m, "z_m": z_m, "m z_m": m * z_m, "m z_m^2": m * z_m**2}


def derived_errors(estimate: MomentEstimate) -> dict[str, float]:
    """Standard errors of `derived`, by the delta method."""
    m, z_m = estimate["m"], estimate["z_m"]
    rows = {"I_x": {"I_x": 1.0}, "m": {"m": 1.0}, "z_m": {"z_m": 1.0}}
    rows["m z_m"] = {"m": z_m, "z_m": m}
    rows["m z_m^2"] = {"m": z_m**2, "z_m": 2 * m * z_m}
    out = {}
    for name, slope in rows.items():
        g = np.array([slope.get(n, 0.0) for n in estimate.names])
        out[name] = float(np.sqrt(g @ estimate.covariance @ g))
    return out


# -- Figure 7.15 ---------------------------------------------------------------------------------


def continuous(theta: Array, Ts: float) -> tuple[Array, Array, Array]:
    """alpha1, alpha2 and beta1 of (7.36) from rows [a1, a2, b0]."""
    a1, a2, b0 = theta.T
    Dn = 1 - a1 + a2
    return 4 / Ts * (1 - a2) / Dn, 4 / Ts**2 * (1 + a1 + a2) / Dn, 8 / Ts * b0 / Dn


def nominal_map(theta: Array, Ts: float) -> tuple[Array, Array, Array]:
    """I_x, d and k of (7.37) from rows of theta_2; the nominal pendulum carries no load."""
    v = rig.TABLES_7_3_AND_7_4
    S = v["M"] * v["z_g"]
    alpha1, alpha2, beta1 = continuous(theta, Ts)
    return (
        -S / beta1 - v["M"] * v["z_g"] * (v["z_g"] - v["z_s"]),
        -S * alpha1 / beta1,
        -S * alpha2 / beta1,
    )


def loaded_map(
    theta: Array, I_x: Array | float, k: Array | float, Ts: float
) -> tuple[Array, Array]:
    """m and z_m of (7.38) from rows of theta_3, with I_x + I_xm for I_x and k in place of d."""
    v = rig.TABLES_7_3_AND_7_4
    _, alpha2, beta1 = continuous(theta, Ts)
    w = alpha2 * (I_x + v["I_xm"] + v["M"] * v["z_g"] ** 2) + k * (beta1 * v["z_s"] - 1)
    moment = beta1 * k + alpha2 * v["M"] * v["z_g"]
    return -(moment**2) / (alpha2 * w), w / moment


def cloud(
    estimate: MomentEstimate, *, propagated: bool = True, n: int = 100_000, seed: int = 0
) -> tuple[Array, Array]:
    """m and z_m of `n` draws of N(theta_hat, P_hat), each pushed through the nonlinear maps.

    P_hat is the covariance of theta_2 and theta_3 on their linear constraints. With `propagated`
    False theta_3 alone is drawn, I_x and k taken as exact, as the thesis does in stages.
    """
    rng = np.random.default_rng(seed)
    p = estimate.propagated
    matrix = p.covariance if propagated else p.own
    if not propagated:
        first = [p.names.index(f) for f in estimate.stages[0].free]
        matrix = matrix.copy()
        matrix[first, :] = matrix[:, first] = 0.0
    draws = rng.multivariate_normal(np.zeros(len(p.names)), matrix, n, method="eigh")
    thetas = {}
    for st in estimate.stages:
        for k, part in enumerate(st.parts):
            columns = part.equation.parameters
            J = jacobian_of(st, k)
            slope = np.column_stack(
                [np.zeros(len(J)) if f in part.known else J[:, columns.index(f)] for f in p.names]
            )
            thetas[part.record] = st.thetas[k] + draws @ slope.T
            Ts = part.Ts
    I_x, _, k_ = nominal_map(thetas["nominal"], Ts)
    return loaded_map(thetas["loaded"], I_x, k_, Ts)
