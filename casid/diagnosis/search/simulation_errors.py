"""Whether an extension lowers the simulation error, in the units of every output.

A likelihood can rise because the weights have changed while the errors grow. Extensions are
therefore judged by their errors as well: of the fitted part, and of what was held out, once with
the simulation running on and once from an initial state of its own. Every output counts in units of
what the noise model at the baseline, its disturbances included, leaves of it; the same units for
all models.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from casid.arrays import TINY, Array
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.estimation.holdout import (
    Split,
    held_out_error,
    simulate_apart,
    whole_simulation,
    why_no_better,
    why_worse,
)
from casid.estimation.simulation.minimization import Fit


@dataclass(frozen=True, slots=True, eq=False)
class SimulationErrors:
    """Errors of one model, (M, ny) each, in units of the baseline's noise; NaN where not used.

    Attributes
    ----------
    fitted : of the part that was fitted.
    continued : of what was held out, the simulation running on; records of their own among it.
    restarted : of the held-out ends, each from an initial state of its own; empty where whole
        records were held out, which are simulated so anyway.
    """

    fitted: Array
    continued: Array
    restarted: Array

    @property
    def square(self) -> float:
        """Sum of squares of the fitted part."""
        return float(np.nansum(self.fitted**2))

    @property
    def held_out_square(self) -> float:
        """Sum of squares of what was held out, both ways."""
        return float(np.nansum(self.continued**2) + np.nansum(self.restarted**2))


def units_of(at: Weighted) -> Array:
    """(ny,) one over the rms that the noise model at the baseline leaves of each output."""
    floors = np.array([at.full.floor(e) for e in range(len(at.criterion.data))])
    return np.asarray(1.0 / np.maximum(np.sqrt(np.mean(floors**2, axis=0)), TINY))


def simulation_errors(fit: Fit, split: Split, units: Array) -> SimulationErrors:
    """The errors of a fit.

    Parameters
    ----------
    units : (ny,) factors of the outputs, see `units_of`.

    Raises
    ------
    SolveError
        If an initial state of what was held out cannot be fitted.
    """
    inside: list[Array] = []
    ends: list[Array] = []
    for e, held in enumerate(split.held):
        d, y, _ = whole_simulation(fit, split, e)
        error = np.where(d.used, d.y - y, np.nan) * units
        inside.append(error[~held])
        ends.append(error[held])
    for experiment in split.apart:
        d, y, _ = simulate_apart(fit, experiment)
        ends.append(np.where(d.used, d.y - y, np.nan) * units)
    restarted = np.zeros((0, len(units)))
    if any(bool(held.any()) for held in split.held):
        again = held_out_error(fit, replace(split, apart=[]), anew=True)
        restarted = again / fit.criterion.weights * units
    return SimulationErrors(np.concatenate(inside), np.concatenate(ends), restarted)


def why_not_adopted(
    before: SimulationErrors,
    after: SimulationErrors,
    *,
    is_alarm: bool = False,
    is_on_the_clock: bool = False,
) -> str:
    """Why an extension is refused by its errors, or an empty text: every error has to fall.

    Parameters
    ----------
    is_alarm : significant by itself at the rate that the user set; one of the held-out errors may
        then fall by chance. Any other has to show that its gain there is more.
    is_on_the_clock : of the extension; a time or phase of its own means nothing to a simulation
        that starts anew.
    """
    shared = np.isfinite(before.fitted) & ~np.isnan(after.fitted)
    old, new = (float(np.sum(e.fitted[shared] ** 2)) for e in (before, after))
    if not np.isfinite(new):
        return "its simulation diverges on the fitted data"
    if new >= old:
        return "it does not lower the error of the fitted part"
    return why_held_out(before, after, is_alarm=is_alarm, is_on_the_clock=is_on_the_clock)


def why_held_out(
    before: SimulationErrors,
    after: SimulationErrors,
    *,
    is_alarm: bool = False,
    is_on_the_clock: bool = False,
) -> str:
    """The same by what was held out alone."""
    ways = [(before.continued, after.continued, "")]
    if not is_on_the_clock:
        ways.append((before.restarted, after.restarted, " from an initial state of its own"))
    for old, new, how in ways:
        worse = why_worse(old, new)
        if worse:
            return worse + how
    # One of the two ways must show a gain that is not chance: the errors that an integrator has
    # gathered hide it in the one, an initial state that absorbs it in the other.
    whys = [why_no_better(old, new) for old, new, _ in ways]
    return "" if is_alarm or not all(whys) else whys[0]
