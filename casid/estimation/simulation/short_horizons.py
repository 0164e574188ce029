"""Where the search over segments or windows of an unstable model begins: fits over short horizons.

Over a whole window an error of a parameter grows as an error of the state does. Where the model is
singular somewhere, such as a magnet's force at no distance, the simulation then runs into it from
most windows, and says nothing. Over one e-folding time it stays near what was measured. The
parameters and states that fit best there are where the fit over twice the time begins, and so on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from casid.errors import OutOfTimeError, SolveError
from casid.estimation.nlp.solver import Solver
from casid.estimation.simulation.instability import fewest_samples, growth_rate
from casid.estimation.simulation.minimization import Fit, minimize_simulation_error
from casid.estimation.simulation.simulation_error import SimulationError


def fit_of_short_horizons(
    criterion: SimulationError, *, solver: Solver | None = None, starts: int = 1, seed: int = 0
) -> Fit | None:
    """The fit over the longest horizon within the parts, each begun where the one before ended.

    Parameters
    ----------
    starts : of the search over the shortest horizon, which few starts are too far from.

    None where the model is stable, where the parts are no longer than an e-folding time or begin
    where another fit has ended, and where no fit over the shortest horizon is found. A record that
    is to be simulated in windows may have one.
    """
    c, records = criterion, range(len(criterion.data))
    states = [c.names[i] for i in c.initial_states]
    is_whole = max(c.parts(e) for e in records) == 1 and not any(e.window for e in c.experiments)
    if is_whole or all(c.unknowns.is_given(n) for n in states):
        return None
    rate = growth_rate(c)
    if rate == 0.0:
        return None
    longest = max(int(np.diff([0, *c.starts_anew(e), c.data[e].N]).max()) for e in records)
    horizon = max(fewest_samples(c), int(np.ceil(1 / (rate * min(d.Ts for d in c.data)))))
    fit: Fit | None = None
    while horizon < longest:
        here = c if fit is None else begun_at(c, fit.values)
        try:
            new = minimize_simulation_error(
                here.of_first_samples(horizon),
                solver=solver,
                starts=starts if fit is None else 1,
                seed=seed,
                check_rank=False,
                retry="none",
            )
        except OutOfTimeError:
            raise
        except SolveError:
            break
        first = new if fit is None else fit
        tried, agreeing = first.starts_tried, first.starts_agreeing
        fit = replace(new, starts_tried=tried, starts_agreeing=agreeing)
        horizon *= 2
    return fit


def begun_at(criterion: SimulationError, start: Mapping[str, float]) -> SimulationError:
    """The criterion from other start values."""
    return criterion.of_records(criterion.experiments, weights=criterion.weights, start=start)
