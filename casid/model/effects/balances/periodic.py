"""A periodic force: a sinusoid of unknown amplitude, phase and frequency."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from casid.arrays import TINY
from casid.model.clock_signals import Always, TimeSince
from casid.model.declarations import Input, Parameter
from casid.model.effects.effect import Effect
from casid.model.effects.places.place import Place
from casid.model.effects.places.places import place_named
from casid.model.effects.search_ranges import PERIODIC_FORCES
from casid.model.model import Model


def periodic_disturbance(
    model: Model, where: str | Place, frequency: float, window: tuple[float, float]
) -> Effect:
    """a_cos cos(2 pi f (t - t_mid)) + a_sin sin(2 pi f (t - t_mid)) at a place, f near a given.

    In a balance, or between two bodies or stores: in all balances that a relative motion enters.

    Time enters as a generated input, so that the derivative in f is exact; counted from the middle
    of the `window` (seconds of the record's clock), f and the phase are nearly uncorrelated. f may
    move by half a line, 1/(2 T), more than which would be another peak. At a_cos = a_sin = 0 f does
    nothing: start the amplitudes from their score (`spectral_peaks`). A second
    generated input, one within the record's own clock, is zero in a record apart, where the phase
    is another.

    It costs as much as five parameters, the frequency as three (Djuric 1996, A model selection rule
    for sinusoids in white Gaussian noise, IEEE Trans. Signal Process. 44, 1744-1751).
    """
    start, stop = window
    middle, half = 0.5 * (start + stop), 0.5 / (stop - start)
    place = place_named(model, where)

    def apply(new: Model, names: Sequence[str]) -> None:
        a, b, f = (new.symbol(name) for name in names)
        turn = 2 * np.pi * f * _since(new, middle)
        place.add(new, _on(new) * (a * ca.cos(turn) + b * ca.sin(turn)))

    lower, upper = max(frequency - half, PERIODIC_FORCES.lowest * frequency), frequency + half
    parameters = (
        Parameter("a_cos", place.unit, 0.0),
        Parameter("a_sin", place.unit, 0.0),
        Parameter("frequency", "Hz", frequency, lower=lower, upper=upper),
    )
    return Effect(
        "periodic_disturbance",
        place.where,
        parameters,
        apply,
        test="peak",
        variant=frequency,
        cost=PERIODIC_FORCES.cost,
        description=place.words,
        constants={"origin": middle},
    )


def sinusoid(
    model: Model,
    where: str | Place,
    frequency: float,
    amplitudes: tuple[float, float],
    window: tuple[float, float],
) -> Effect:
    """A `periodic_disturbance` whose size alone is unknown, at the phase that amplitudes give.

    Linear in its one parameter, it is scored as other effects are.
    """
    middle = 0.5 * (window[0] + window[1])
    place = place_named(model, where)
    cos, sin = np.array(amplitudes) / max(float(np.hypot(*amplitudes)), TINY)

    def apply(new: Model, names: Sequence[str]) -> None:
        turn = 2 * np.pi * frequency * _since(new, middle)
        force = new.symbol(names[0]) * (cos * ca.cos(turn) + sin * ca.sin(turn))
        place.add(new, _on(new) * force)

    amplitude = Parameter("a", place.unit, 0.0)
    return Effect("periodic_disturbance", place.where, (amplitude,), apply, variant=frequency)


def _since(model: Model, instant: float) -> ca.SX:
    """Seconds of the record's clock since an instant."""
    since = TimeSince(instant)
    entry = Input(f"time since {instant:.9g} s", "s", "generated", "foh", since)
    return ca.SX(model.add_input(entry))


def _on(model: Model) -> ca.SX:
    """One within the record's own clock, zero in a record apart."""
    return ca.SX(model.add_input(Input("one on this clock", "1", "generated", "foh", Always())))
