"""How fast commands move, and the largest rates of an actuator that would be felt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casid.arrays import Array
from casid.estimation.simulation.channels.rate_limits import rate_limited
from casid.estimation.simulation.channels.sample_lines import lines_of
from casid.estimation.simulation.records.signals import Signals
from casid.model.effects.channels.recorded_commands import commands_of, is_rate_limited
from casid.model.effects.search_ranges import ACTUATORS
from casid.model.model import Model


@dataclass(frozen=True, slots=True)
class CommandRates:
    """Rates of one command, its SI unit per second.

    Attributes
    ----------
    largest : of the command itself.
    felt : largest rates of an actuator that a simulation may show, from high to low.
    """

    largest: float
    felt: tuple[float, ...]


def command_rates(
    model: Model, data: Sequence[Signals], noise: Mapping[str, float]
) -> dict[str, CommandRates]:
    """Rates of each recorded command that could have an actuator with a largest rate.

    Parameters
    ----------
    noise : of each input: a rate at which the actuator of a measured command could not follow the
        noise of its sensor is not searched, as it would take noise out of the command.
    """
    found = {}
    for name in commands_of(model):
        hold = model.acting_hold(name)
        if hold == "bandlimited" or is_rate_limited(model, name):
            continue
        place = list(model.inputs).index(name)
        columns = [d.u[:, place] for d in data]
        least = ACTUATORS.noise * noise.get(name, 0.0)
        rates = _rates([lines_of(c, hold) for c in columns], [d.Ts for d in data], least)
        if rates is not None:
            found[name] = rates
    return found


def _rates(lines: Sequence[Array], times: Sequence[float], least: float) -> CommandRates | None:
    """Rates from the largest down by halves, those that are felt, evenly thinned."""
    steps = [np.abs(np.diff(c[:, 0])) / Ts for c, Ts in zip(lines, times, strict=True)]
    largest = max((float(s.max(initial=0.0)) for s in steps), default=0.0)
    spread = float(
        np.sqrt(np.mean(np.concatenate([(c[:, 0] - c[:, 0].mean()) ** 2 for c in lines])))
    )
    if not (np.isfinite(largest) and largest > 0.0 and spread > 0.0):
        return None
    felt = []
    for k in range(1, ACTUATORS.halvings + 1):
        rate = largest * 0.5**k
        if rate * min(times) < least:
            break
        left = np.concatenate(
            [
                rate_limited(c, rate * Ts).lines.mean(axis=1) - c.mean(axis=1)
                for c, Ts in zip(lines, times, strict=True)
            ]
        )
        share = float(np.sqrt(np.mean(left**2))) / spread
        if share > ACTUATORS.felt[1]:
            break
        if share >= ACTUATORS.felt[0]:
            felt.append(rate)
    if len(felt) > ACTUATORS.rates:
        kept = np.linspace(0, len(felt) - 1, ACTUATORS.rates).round().astype(int)
        felt = [felt[i] for i in kept]
    return CommandRates(largest, tuple(felt)) if felt else None
