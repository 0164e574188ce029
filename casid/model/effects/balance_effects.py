"""Effects in a balance: forces and torques that a mechanical model often omits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from casid.model.dimensional_analysis import carrying_unit
from casid.model.effects.effect import Effect
from casid.model.model import Input, Model, Parameter
from casid.model.units import unit_quotient


def quadratic_damping(model: Model, balance: str) -> Effect:
    """-d_2 |v| v in a balance (drag, eddies), d_2 >= 0."""
    b = model.balances[balance]
    unit = unit_quotient(b.unit, model.states[b.rate].unit, 2)

    def apply(new: Model, names: Sequence[str]) -> None:
        v = new.symbol(b.rate)
        new.add_term(balance, -new.symbol(names[0]) * ca.fabs(v) * v)

    p = Parameter("d_2", unit, 0.0, lower=0.0)
    return Effect("quadratic_damping", balance, (p,), apply, sided="positive")


def coulomb_friction(model: Model, balance: str, speed: float) -> Effect:
    """-F_c tanh(v / v_0) in a balance: dry friction, smoothed below `speed` = v_0 (rate's SI unit).

    The smoothing keeps the simulation differentiable; it is small against the speeds met.
    """
    b, v_0 = model.balances[balance], carrying_unit(speed)

    def apply(new: Model, names: Sequence[str]) -> None:
        new.add_term(balance, -new.symbol(names[0]) * ca.tanh(new.symbol(b.rate) / v_0))

    p = Parameter("F_c", b.unit, 0.0, lower=0.0)
    constants = {"speed": speed}
    return Effect("coulomb_friction", balance, (p,), apply, sided="positive", constants=constants)


def cubic_stiffness(model: Model, balance: str) -> Effect | None:
    """-k_3 q^3 in a balance, q the position; hardening or softening."""
    b = model.balances[balance]
    position = model.position_of(b.rate)
    if position is None:
        return None
    unit = unit_quotient(b.unit, model.states[position].unit, 3)

    def apply(new: Model, names: Sequence[str]) -> None:
        new.add_term(balance, -new.symbol(names[0]) * new.symbol(position) ** 3)

    return Effect("cubic_stiffness", balance, (Parameter("k_3", unit, 0.0),), apply)


def deadzone(model: Model, balance: str, width: float, largest: float = np.inf) -> Effect | None:
    """Play in the restoring force: the position q acts as q - clip(q, -gap, gap), gap >= 0.

    The term is K s(q, gap) with K the effective stiffness and

        s = (sqrt((q + gap)^2 + e^2) - sqrt((q - gap)^2 + e^2)) / 2,

    which is clip(q, -gap, gap) but for rounded corners of `width` e (position's SI unit, small
    against the motion): zero at gap = 0, with the slope q / sqrt(q^2 + e^2) there.

    Parameters
    ----------
    largest : largest |q| met; a gap as wide as the motion leaves no restoring force to see.
    """
    position = model.position_of(model.balances[balance].rate)
    if position is None:
        return None
    K = effective_stiffness(model, balance, position)
    if K is None:
        return None

    def apply(new: Model, names: Sequence[str]) -> None:
        q, gap = new.symbol(position), new.symbol(names[0])
        square = carrying_unit(width**2)

        def rounded(x: Any) -> Any:
            return ca.sqrt(x**2 + square)

        new.add_term(balance, K * (rounded(q + gap) - rounded(q - gap)) / 2)

    p = Parameter("gap", model.states[position].unit, 0.0, lower=0.0, upper=largest)
    limit = largest if np.isfinite(largest) else None
    constants = {"width": width}
    return Effect(
        "deadzone", balance, (p,), apply, sided="positive", limit=limit, constants=constants
    )


def effective_stiffness(model: Model, balance: str, position: str) -> Any | None:
    """K = -(df/dq) / (df/dtau) at q = 0, in the balance's unit over the position's; None if zero.

    f is the rate's derivative in the explicit equations, q the position, and tau a force added to
    the balance: K q is the force that acts as the restoring force does. Where an unknown input has
    been eliminated it is the remaining stiffness: k of the indirect pendulum, not k + S g.
    """
    probe = model.copy()
    tau = ca.SX.sym("tau")
    probe.add_term(balance, tau)
    e = probe.explicit()
    f = e.f[e.states.index(model.balances[balance].rate)]
    q = model.symbol(position)
    K = -ca.jacobian(f, q) / ca.jacobian(f, tau)
    K = ca.substitute(ca.substitute(ca.SX(K), tau, 0), q, 0)
    symbols = ca.symvar(K)
    value = ca.Function("K", [ca.vertcat(ca.SX(0, 1), *symbols)], [ca.densify(K)])
    rng = np.random.default_rng(5)
    points = [ca.DM(rng.uniform(0.2, 1.7, (len(symbols), 1))) for _ in range(3)]
    sizes = [abs(float(value.call([point])[0])) for point in points]
    finite = [size for size in sizes if np.isfinite(size)]
    return K if finite and max(finite) > 1e-12 else None


def offset(model: Model, balance: str) -> Effect:
    """A constant force or torque in a balance."""
    b = model.balances[balance]

    def apply(new: Model, names: Sequence[str]) -> None:
        new.add_term(balance, new.symbol(names[0]))

    symbol = "tau_0" if b.unit == "N m" else "F_0"
    return Effect("offset", balance, (Parameter(symbol, b.unit, 0.0),), apply)


def extra_input(model: Model, balance: str, channel: str, unit: str) -> Effect:
    """A recorded channel that acts in a balance although the model does not use it."""
    b = model.balances[balance]
    p = Parameter(f"b_{channel}", unit_quotient(b.unit, unit, 1), 0.0)

    def apply(new: Model, names: Sequence[str]) -> None:
        u = new.add_input(Input(channel, unit, "known", "foh"))
        new.add_term(balance, new.symbol(names[0]) * u)

    # A late sensor acts much as what drives the system does, and is met more often.
    return Effect("extra_input", channel, (p,), apply, priority=3)
