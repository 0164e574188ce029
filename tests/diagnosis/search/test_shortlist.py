"""What is refitted of a table of scores."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

import casid
from casid.diagnosis.evidence.scores.score_tests import Score
from casid.diagnosis.search import rounds
from casid.diagnosis.thresholds import RESTARTS, SHORTLIST
from casid.model.effects.channels.channel_effects import sensor_lag
from casid.model.effects.effect import Motion
from casid.model.effects.parameter_effects import parameter_jump
from casid.model.effects.state_schedules import state_scheduled_parameter


@pytest.mark.parametrize(("times", "powers"), [(2.0, {1.0, 2.0}), (0.5, {1.0})])
def test_far_from_the_noise_a_parameter_is_refitted_with_every_power_of_its_state(
    monkeypatch: pytest.MonkeyPatch, times: float, powers: set[float]
):
    """A score says which shape is steeper at zero, and not which fits where the fall is deep."""
    m = casid.Model("coil")
    i, u = m.state("i", "A"), m.input("u", "V", known=True)
    m.balance(i, "voltage", inertia=m.parameter("L", "H", start=0.1, lower=1e-3), terms=[u])
    m.output("i", i, "A")
    effects = [state_scheduled_parameter(m, "L", "i", Motion(1, 0, 4, 1), k) for k in (1, 2)]
    scores = [Score(e, 9.0, 1e-9, 1e-9, 0.0, 0.0, 90.0 - k, 1.0) for k, e in enumerate(effects)]
    monkeypatch.setattr(rounds, "error_over_noise", lambda *_: times * RESTARTS.far)
    at = SimpleNamespace(fit=None, noise=None, noise_absorbs_misfit=True)
    found = rounds.shortlist(at, SimpleNamespace(tested=scores))  # type: ignore[arg-type]
    assert {s.effect.variant for s in found} == powers


def test_jumps_of_many_parameters_crowd_out_no_lasting_effect(monkeypatch: pytest.MonkeyPatch):
    """A step of a heater whose sensor lags looks like a jump of every parameter soon after it."""
    m = casid.Model("heaters")
    u = m.input("u", "W", hold="zoh", known=True)
    jumps = []
    for k in range(8):
        T = m.state(f"T_{k}", "K")
        C = m.parameter(f"C_{k}", "J/K", start=1.0, lower=0.1)
        m.balance(T, f"heat {k}", inertia=C, terms=[u])
        m.output(f"T_{k}", T, "K")
        jumps.append(parameter_jump(m, f"C_{k}", 20.0))
    lag = sensor_lag(m, "T_0", 10.0)
    scores = [Score(e, 9.0, 1e-9, 1e-9, 0.0, 0.0, 90.0, 1.0) for e in jumps]
    scores.append(Score(lag, 5.0, 1e-6, 1e-6, 0.0, 0.0, 30.0, 1.0))
    monkeypatch.setattr(rounds, "error_over_noise", lambda *_: 0.5 * RESTARTS.far)
    at = SimpleNamespace(fit=None, noise=None, noise_absorbs_misfit=True)
    found = rounds.shortlist(at, SimpleNamespace(tested=scores))  # type: ignore[arg-type]
    assert sum(s.effect.is_on_the_clock for s in found) == SHORTLIST.timed
    assert lag in [s.effect for s in found]
