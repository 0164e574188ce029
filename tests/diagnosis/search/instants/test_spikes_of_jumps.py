"""A fast system shows the jump of a parameter as a spike: jumps are tried where few are."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.diagnosis.evidence.whitening.prewhitening import Weighing
from casid.diagnosis.search.findings import instants_of_spikes
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import BURSTS
from casid.estimation.holdout import split_records
from casid.estimation.simulation.fit import FitSettings, fit_model

TS, N, CHANGES, RATE, LOSS, NOISE = 1.0, 400, 223.0, 2.0, 0.5, 0.006  # s, samples, s, 1/s, 1/s


def reactor() -> casid.Model:
    """What flows in reacts away within a sample; the rate of the reaction is recorded."""
    m = casid.Model("reactor")
    s, q = m.state("s", "mol"), m.input("q", "mol/s", hold="zoh", known=True)
    k = m.parameter("k", "1/s", start=1.0, lower=0.05, upper=20.0)
    m.balance(s, "amount", inertia=1, terms=[q, -k * s], unit="mol/s")
    m.output("rate", k * s, "mol/s")
    return m


def record() -> casid.Record:
    """ds/dt = q - k s, sampled exactly; k falls by a quarter at the instant of a sample."""
    rng = np.random.default_rng(2)
    q = np.repeat(rng.uniform(0.7, 1.3, N // 40), 40)
    rate, s = np.empty(N), q[0] / RATE
    for i, inflow in enumerate(q):
        k = RATE - LOSS * (i * TS >= CHANGES)
        rate[i] = k * s
        s = inflow / k + (s - inflow / k) * np.exp(-k * TS)
    rate += NOISE * rng.standard_normal(N)
    return casid.Record({"q": q, "rate": rate}, {"q": "mol/s", "rate": "mol/s"}, Ts=TS)


def test_a_jump_is_scored_at_the_instant_of_a_spike():
    """The sample itself is left out; what goes on after it shows a jump there and nowhere else."""
    spike = np.arange(N) * TS == CHANGES
    split = split_records([casid.Experiment(record().mark_missing("rate", spike))], 0.2)
    weighing = Weighing(split.fitted)
    at = weighing.weigh(reactor(), fit_model(reactor(), split.fitted, FitSettings(starts=1)))
    jumps = [
        s
        for s in Search(weighing, {}, spikes=(CHANGES,)).table(at, []).scores
        if s.effect.key == ("parameter_jump", "k")
    ]
    there = next(s for s in jumps if s.effect.variant == CHANGES)
    others = [s.unrobust for s in jumps if s.effect.variant != CHANGES]
    assert there.unrobust > max(others)
    assert there.step == pytest.approx(-LOSS, rel=0.3)  # linear in a change of a quarter


@pytest.mark.parametrize("count", [1, BURSTS.spikes, BURSTS.spikes + 1])
def test_the_instants_of_many_spikes_are_none_of_jumps(count: int):
    """A sensor that errs now and then says nothing of the system."""
    mask = np.arange(N) < count
    baseline = SimpleNamespace(
        fit=SimpleNamespace(criterion=SimpleNamespace(data=[SimpleNamespace(t=np.arange(N) * TS)])),
        corrupted=SimpleNamespace(spikes=(SimpleNamespace(masks=(mask,)),)),
    )
    expected = tuple(float(t) for t in range(count)) if count <= BURSTS.spikes else ()
    assert instants_of_spikes(baseline) == expected  # type: ignore[arg-type]
