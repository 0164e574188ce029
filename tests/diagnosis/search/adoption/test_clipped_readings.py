"""A clipped sensor shows its limit and noise; what goes on beyond a limit is not clipped."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.arrays import Array
from casid.diagnosis.search.adoption.clipped_readings import why_no_limit
from casid.diagnosis.search.candidates import Candidate
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.channels.channel_effects import saturation

N, TS, NOISE = 200, 1.0, 0.01


def drained(start: float) -> Array:
    """The level of a tank of 30 s whose valve is open from the first second, from `start`."""
    return start * np.exp(-TS * np.arange(N) / 30.0)


def opening() -> Array:
    """The same where the valve opens by 1/(4 s + 1): the level falls late, as if cut off."""
    t = TS * np.arange(N)
    return 0.8 * np.exp(-(t - 4.0 * (1.0 - np.exp(-t / 4.0))) / 30.0)


@pytest.mark.parametrize(
    ("level", "is_limit"), [(np.minimum(drained(1.0), 0.8), True), (opening(), False)]
)
def test_what_scatters_more_at_its_limit_than_below_is_not_clipped(level, is_limit):
    m = casid.Model("tank")
    h = m.state("h", "m", start=1.0)
    T = m.constant("T", 30.0, "s")
    m.derivative(h, -h / T)
    m.output("h", h, "m")
    noise = NOISE * np.random.default_rng(2).standard_normal(N)
    record = casid.Record({"h": level + noise}, {"h": "m"}, Ts=TS)
    effect = saturation(m, "h", 0.78)
    model, names = effect.extended(m)
    fit = fit_model(model, [casid.Experiment(record)], casid.FitSettings(starts=1))
    assert 0.7 < fit.values[names[0]] < 0.82
    clipping = Candidate(effect, names, model, fit, 100.0, 0.0, 9.0)
    assert (why_no_limit(fit, clipping, 0.05) == "") is is_limit
