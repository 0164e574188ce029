"""Effects in the structure: an actuator between command and action, a part that moves along.

The part swings where the balance has a position, and follows with a time constant where it has
none: a second thermal mass, the branch of eddy currents, a further compartment.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from casid.errors import ModelError
from casid.model.declarations import Parameter, Stage
from casid.model.effects.channel_effects import carry, commands_of, is_lagging, require_command
from casid.model.effects.effect import Effect, Sizes, is_null, known_while_null
from casid.model.effects.place import is_mechanical
from casid.model.effects.search_ranges import MISSING_MODES, MISSING_STORES, RANGES
from casid.model.model import Model
from casid.model.units import same_dimension, unit_quotient


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
    unit, shown = _inertia_units(model, balance)
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
        declared_units={"J_m": shown},
    )


def missing_store(model: Model, balance: str, tau: float) -> Effect:
    """A store that follows the one of a balance, with a time constant `tau` [s] at first.

    With x the level of the balance and x - r that of the further store,

        r' = dx/dt - r / tau                                                                 (2)

    and C_m r / tau flows into that store. Its level when the record begins is estimated. Without
    C_m nothing shows tau: it is then known, and both stores begin at one level.
    """
    b = model.balances[balance]
    rate = model.states[b.rate].unit
    unit, shown = _inertia_units(model, balance)
    p = (
        Parameter("C_m", unit, 0.0, lower=0.0),
        Parameter(
            "tau_m",
            "s",
            tau,
            lower=MISSING_STORES.lower * tau,
            upper=MISSING_STORES.upper * tau,
        ),
    )

    def apply(new: Model, names: Sequence[str]) -> None:
        C, time_constant = (new.symbol(n) for n in names)
        level = 0.0 if is_null(new, names) else None
        r = new.state(new.free_name("r_m"), rate, initial=level)
        new.derivative(r, new.der(b.rate) - r / time_constant)
        new.add_term(balance, -C * r / time_constant)
        known_while_null(new, names)

    return Effect(
        "missing_mode",
        balance,
        p,
        apply,
        sided="positive",
        variant=tau,
        cost=MISSING_STORES.cost,
        priority=1,
        description=f"a further store, which the model omits, follows {b.rate} with a time "
        f"constant (in the {balance} balance)",
        declared_units={"C_m": shown},
    )


def _inertia_units(model: Model, balance: str) -> tuple[str, str]:
    """SI unit of a further inertia of a balance, and the unit that it is shown in.

    Both are those of the inertia that the model has, where it is a quantity with a unit.
    """
    b = model.balances[balance]
    unit = unit_quotient(unit_quotient(b.unit, model.states[b.rate].unit, 1), "1/s", 1)
    own = model.parameters.get(str(b.inertia))
    if own is None or not same_dimension(own.unit, unit):
        return unit, unit
    return own.unit, model.declared_units.get(own.name, own.unit)


def time_constants(sizes: Sizes, Ts: float | None = None) -> list[float]:
    """Time constants [s] from a few samples up to a share of the record."""
    start, stop = sizes.window
    longest = MISSING_STORES.longest * (stop - start)
    shortest = longest / MISSING_STORES.widest if Ts is None else MISSING_STORES.shortest * Ts
    if shortest >= longest:
        return []
    return [float(tau) for tau in np.geomspace(shortest, longest, MISSING_STORES.time_constants)]


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
    """Parts that may move along in each balance.

    They swing where the rate is the derivative of a position, and follow where it is none. All of
    them together are cheap to test where their first parameters are pinned at zero
    (`Effect.extended` with upper=0).
    """
    frequencies, times = mode_frequencies(sizes, Ts), time_constants(sizes, Ts)
    found: list[Effect] = []
    for balance, b in model.balances.items():
        if model.position_of(b.rate) is not None:
            found += [missing_mode(model, balance, omega) for omega in frequencies]
        elif not is_mechanical(b.unit):
            found += [missing_store(model, balance, tau) for tau in times]
    return found
