"""What is adopted: no effect whose size the records do not determine, and no failure ends it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.search import selection
from casid.diagnosis.search.refusals import ACCEPTED, Refusal
from casid.diagnosis.search.selection import Selection, why_undetermined
from casid.estimation.simulation.fit import fit_model
from casid.model.effects.balances.balance_effects import cubic_stiffness
from casid.model.effects.channels.channel_effects import sensor_scale
from casid.model.effects.parameter_effects import parameter_drift


def mass() -> casid.Model:
    """A mass on a spring and a damper under a force that is known."""
    m = casid.Model("mass")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", known=True)
    M, d, k = (
        m.parameter(name, unit, start=start, lower=0.01)
        for name, unit, start in (("M", "kg", 2.0), ("d", "N s/m", 1.0), ("k", "N/m", 50.0))
    )
    m.derivative(x, v)
    m.balance(v, "forces", inertia=M, terms=[F, -d * v, -k * x])
    m.output("position", x, "m")
    return m


@pytest.mark.parametrize(
    ("effect", "says"),
    [
        (sensor_scale(mass(), "position"), "do not determine scale_position beside the parameters"),
        (cubic_stiffness(mass(), "forces"), ""),
    ],
)
def test_a_gain_of_the_only_sensor_is_another_mass_damper_and_spring(effect, says):
    """With a force that is known, (M, d, k) times 1 + s do what a gain of 1 + s does."""
    rng, h = np.random.default_rng(3), 0.002
    F = np.repeat(rng.standard_normal(60), 10)
    x, v, path = 0.0, 0.0, np.empty(600)
    for i in range(600):
        path[i] = x
        for _ in range(10):
            v += h * (F[i] - 1.2 * v - 60.0 * x) / 1.5
            x += h * v
    path += 1e-4 * rng.standard_normal(600)
    record = casid.Record({"F": F, "position": path}, {"F": "N", "position": "m"}, Ts=0.02)
    model, names = effect.extended(mass())
    once = casid.FitSettings(starts=1)
    data = [casid.Experiment(record, {}, "r")]
    fits = [fit_model(m, data, once, check_rank=False, throw=False) for m in (mass(), model)]
    assert says in why_undetermined(*fits, SimpleNamespace(names=names))
    assert bool(says) == bool(why_undetermined(*fits, SimpleNamespace(names=names)))


def test_a_comparison_with_rivals_that_fails_is_left_out_alone(monkeypatch):
    """The cause that was adopted stays, with a note that says what was not compared."""

    def fails(*_):
        raise casid.DataError("0 samples are too few for 6 unknowns")

    monkeypatch.setattr(selection, "better_rivals", fails)
    effect = sensor_scale(mass(), "position")
    taken = SimpleNamespace(
        candidate=SimpleNamespace(effect=effect),
        before=SimpleNamespace(noise_absorbs_misfit=True),
        rivals_and_near_ones=(effect,),
    )
    search = SimpleNamespace(attempts=Attempts(), progress=lambda _: None)
    at = SimpleNamespace(noise_absorbs_misfit=False)
    state = Selection(search, None, None, None, at, None, None, at, None, None, adopted=[taken])
    state.exchange_last()
    assert state.adopted == [taken]
    (note,) = search.attempts.notes()
    assert note == (
        "the comparison of gain error of position with its rivals was left out: 0 samples are too "
        "few for 6 unknowns"
    )


@pytest.mark.parametrize(
    ("drift", "leaves", "adopted"),
    [(120.0, "", "parameter_drift"), (70.0, "", "sensor_scale"), (120.0, "more", "sensor_scale")],
)
def test_a_drift_takes_the_place_of_a_law_that_predicts_worse_where_it_leaves_noise_alone(
    monkeypatch, drift, leaves, adopted
):
    """A loss that grows while a furnace gets hotter looks like one that grows with the heat.

    Of the laws, the best is refused for what was held out, and a poor one would not be. The drift
    explains more than that one and leaves noise; or it explains less, or it leaves more than noise.
    """

    def found(effect, merit):
        return SimpleNamespace(candidate=SimpleNamespace(effect=effect, merit=merit))

    m = mass()
    laws = [found(cubic_stiffness(m, "forces"), 100.0), found(sensor_scale(m, "position"), 80.0)]
    waiting = [found(parameter_drift(m, "k", (0.0, 1.0)), drift)]

    def significant(self):
        self.imitations = list(waiting)
        return laws

    def extend(self, news, leaves_noise):
        if news[0] is laws[0]:
            return Refusal("it makes the held-out error worse", "held-out")
        assert leaves_noise is (news[0] in waiting)
        if leaves_noise and leaves:
            return Refusal(leaves)
        self.adopted += news
        return ACCEPTED

    monkeypatch.setattr(Selection, "_significant", significant)
    monkeypatch.setattr(Selection, "_extend", extend)
    search = SimpleNamespace(attempts=Attempts(), refused=[])
    at = SimpleNamespace(noise_absorbs_misfit=True)
    state = Selection(search, None, None, None, at, None, None, at, None, None)
    assert state.adopt_next()
    assert [a.candidate.effect.kind for a in state.adopted] == [adopted]


def test_what_is_refused_beside_another_effect_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """That one may be dropped later: a bias alone makes no simulation of a linear model diverge."""
    m = mass()
    why = Refusal("the simulation of run diverges at t = 1 s (sample 10) from the start values")
    effects = [cubic_stiffness(m, "forces"), sensor_scale(m, "position")]
    first, second = (SimpleNamespace(candidate=SimpleNamespace(effect=e)) for e in effects)
    monkeypatch.setattr(Selection, "_extend", lambda self, news, leaves_noise: why)
    search = SimpleNamespace(attempts=Attempts(), refused=[])
    at = SimpleNamespace(noise_absorbs_misfit=True)
    state = Selection(search, None, None, None, at, None, None, at, None, None)
    assert not state._adopt([second])
    state.adopted = [first]
    assert not state._adopt([second])
    assert [said.text for _, said in search.refused] == [
        why.text,
        f"beside cubic stiffness in the forces balance, {why.text}",
    ]


def test_no_clipping_is_adopted_whose_readings_go_on_beyond_its_limit(monkeypatch):
    """Its errors speak for it, and what was measured does not."""
    for name in ("whole_fit", "simulation_errors"):
        monkeypatch.setattr(selection, name, lambda *_: SimpleNamespace(continued=None))
    monkeypatch.setattr(selection, "why_not_adopted", lambda *_, **__: ACCEPTED)
    monkeypatch.setattr(selection, "why_worse", lambda *_: "")
    monkeypatch.setattr(selection, "why_undetermined", lambda *_: "")
    monkeypatch.setattr(selection, "why_no_limit", lambda *_: "it goes on beyond that limit")
    search = SimpleNamespace(weighing=SimpleNamespace(takes_disturbances=False), alpha=0.05)
    nothing = SimpleNamespace(continued=None)
    state = Selection(search, None, None, None, None, None, nothing, None, None, nothing)
    fit = SimpleNamespace(values={})
    clipping = SimpleNamespace(candidate=SimpleNamespace(model=None, fit=fit), is_alarm=False)
    assert state._extend([clipping], False) == Refusal("it goes on beyond that limit")
    assert not state.adopted
