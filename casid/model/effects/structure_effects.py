"""Effects in the structure: an actuator between command and action, a part that swings along."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from casid.errors import ModelError
from casid.model.declarations import Parameter, Stage
from casid.model.effects.channel_effects import carry, commands_of, is_lagging, require_command
from casid.model.effects.effect import Effect, Sizes, known_while_null
from casid.model.effects.search_ranges import MISSING_MODES, RANGES
from casid.model.model import Model
from casid.model.units import unit_quotient


def actuator_lag(model: Model, channel: str, longest: float) -> Effect:
    """A recorded command that acts through 1/(tau s + 1), tau at most `longest` seconds.

    What the actuator did is computed exactly for the command held or joined by straight lines, and
    handed to the simulation as a line in each sample with the same mean and first moment: neither
    the lag nor its derivative moves anything by half a sample. Before the record the command was
    what it is at its first sample.

    Raises
    ------
    ModelError
        If the input is not recorded, stands in for an unknown one, or lags already.
    """
    require_command(model, channel, instead="sensor_lag")
    if is_lagging(model, channel):
        raise ModelError(
            f"{model.name}: the command {channel} acts through a lag already; extend the model "
            "before that one"
        )
    p = Parameter(f"tau_{channel}", "s", 0.0, lower=0.0, upper=longest)

    def apply(new: Model, names: Sequence[str]) -> None:
        carry(new, Stage("lag_input", channel, names[0]))

    return Effect("actuator_lag", channel, (p,), apply, sided="positive", limit=longest, priority=1)


def missing_mode(model: Model, balance: str, omega: float) -> Effect:
    """A part that swings along: relative motion q of natural frequency `omega` [rad/s] at first.

        q'' + 2 zeta omega q' + omega^2 q = -dv/dt                                           (1)

    and J_m (omega^2 q + 2 zeta omega q') acts back, in the balance of the rate v. At rest before
    the record. Without J_m nothing shows omega and zeta: they are then known, and estimated where
    the extension starts from a J_m.
    """
    b = model.balances[balance]
    unit = unit_quotient(unit_quotient(b.unit, model.states[b.rate].unit, 1), "1/s", 1)
    lowest, highest = MISSING_MODES.lower * omega, MISSING_MODES.upper * omega
    least = MISSING_MODES.least_damping
    p = (
        Parameter("J_m", unit, 0.0, lower=0.0),
        Parameter("omega_m", "rad/s", omega, lower=lowest, upper=highest),
        Parameter("zeta_m", "1", MISSING_MODES.damping, lower=least, upper=1.0),
    )

    def apply(new: Model, names: Sequence[str]) -> None:
        J, w0, zeta = (new.symbol(n) for n in names)
        rate = new.states[b.rate].unit
        q = new.state(new.free_name("q_m"), unit_quotient(rate, "1/s", 1), initial=0.0)
        v = new.state(new.free_name("v_m"), rate, initial=0.0)
        spring = w0**2 * q + 2 * zeta * w0 * v
        new.derivative(q, v)
        new.derivative(v, -spring - new.der(b.rate))
        new.add_term(balance, J * spring)
        known_while_null(new, names)

    return Effect(
        "missing_mode",
        balance,
        p,
        apply,
        sided="positive",
        variant=omega,
        cost=MISSING_MODES.cost,
        priority=1,
    )


def mode_frequencies(sizes: Sizes, Ts: float | None = None) -> list[float]:
    """Frequencies [rad/s] from four cycles a record up to a third of Nyquist's."""
    start, stop = sizes.window
    low = 2 * math.pi * MISSING_MODES.slowest / (stop - start)
    high = math.pi / Ts / MISSING_MODES.fastest if Ts is not None else MISSING_MODES.widest * low
    return [float(w) for w in np.geomspace(low, max(high, 2 * low), MISSING_MODES.frequencies)]


def structure_effects_of(model: Model, sizes: Sizes) -> list[Effect]:
    """Actuators that may lag: one for each recorded command that does not yet."""
    longest = RANGES.actuator_lag * (sizes.window[1] - sizes.window[0])
    return [actuator_lag(model, c, longest) for c in commands_of(model) if not is_lagging(model, c)]


def missing_modes_of(model: Model, sizes: Sizes, Ts: float | None = None) -> list[Effect]:
    """Parts that may swing along in each balance of inertia.

    Such a balance is one whose rate is the derivative of a position. All of them together are cheap
    to test where their first parameters are pinned at zero (`Effect.extended` with upper=0).
    """
    frequencies = mode_frequencies(sizes, Ts)
    return [
        missing_mode(model, balance, omega)
        for balance, b in model.balances.items()
        if model.position_of(b.rate) is not None
        for omega in frequencies
    ]
