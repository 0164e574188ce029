"""What happens in time, or rings on its own, imitates laws that depend on the amplitude."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.search.comparison.alternatives import (
    laws_before_memory,
    leaders_of,
    near_ones,
    on_common_samples,
    p_value,
    rivals_of,
    without_imitations,
)
from casid.diagnosis.thresholds import COMPARISON
from casid.model.effects.balances.balance_effects import (
    cubic_damping,
    extra_input,
    quadratic_damping,
)
from casid.model.effects.balances.contact_effects import end_stop
from casid.model.effects.balances.friction_effects import hysteresis
from casid.model.effects.balances.unnamed_effects import unnamed_effects
from casid.model.effects.effect import Effect
from casid.model.effects.parameter_effects import parameter_jump
from problems import roll_decay

MODEL = roll_decay.decay_model()
LAW = cubic_damping(MODEL, "torque")
JUMP = parameter_jump(MODEL, "B_1", 20.0)
HYSTERESIS = hysteresis(MODEL, "torque", 0.05, (0.01, 0.2))
assert HYSTERESIS is not None


def judged(effect: Effect, gain: float, cost: float) -> Candidate:
    """A candidate with what it gains and costs; nothing else of it is compared here."""
    unused: Any = None
    return Candidate(effect, (), MODEL, unused, gain, cost, 0.0)


@pytest.mark.parametrize(("gain", "is_cause"), [(0.9, False), (1.4, False), (1.6, True)])
def test_a_jump_is_a_cause_if_it_explains_half_as_much_again_as_the_best_law(
    gain: float, is_cause: bool
) -> None:
    assert COMPARISON.imitator == 0.5
    law, jump = judged(LAW, 100.0, 0.0), judged(JUMP, 100.0 * gain, 0.0)
    both = [law, jump]
    assert without_imitations(both, both) == (both if is_cause else [law])


@pytest.mark.parametrize(("more", "is_cause"), [(-1.0, False), (1.0, True)])
def test_beside_a_disturbance_strong_evidence_is_enough_for_a_jump(
    more: float, is_cause: bool
) -> None:
    """Under its spectrum what is missing no longer passes for noise: gains are likelihoods."""
    law, jump = judged(LAW, 100.0, 0.0), judged(JUMP, 100.0 + COMPARISON.strong + more, 0.0)
    both = [law, jump]
    found = without_imitations(both, both, by_likelihood=True)
    assert found == (both if is_cause else [law])


@pytest.mark.parametrize(("merit", "goes_first"), [(49.0, False), (51.0, True)])
def test_a_law_goes_before_hysteresis_that_explains_less_than_twice_as_much(
    merit: float, goes_first: bool
) -> None:
    """Hysteresis has four numbers and a memory to imitate two laws of damping with."""
    assert COMPARISON.memory == 0.5
    memory = judged(HYSTERESIS, 100.0, 0.0)
    jump, law = judged(JUMP, 90.0, 0.0), judged(LAW, merit, 0.0)
    order = [memory, jump, law]
    assert laws_before_memory(order) == ([law, memory, jump] if goes_first else order)
    assert laws_before_memory([law, memory]) == [law, memory]


def test_beside_laws_that_explain_nothing_a_jump_has_to_pay_for_itself_alone() -> None:
    law, jump, poor = judged(LAW, 0.1, 5.0), judged(JUMP, 20.0, 15.0), judged(JUMP, 15.0, 15.0)
    assert without_imitations([law, jump], [law, jump]) == [law, jump]
    assert without_imitations([law, poor], [law, poor]) == [law]


def test_a_law_that_is_not_significant_is_no_reason_against_a_jump() -> None:
    law, jump = judged(LAW, 100.0, 0.0), judged(JUMP, 50.0, 0.0)
    assert without_imitations([law, jump], [jump]) == [law, jump]


def test_a_stop_whose_stiffness_is_hardly_known_is_significant_by_what_it_explains() -> None:
    """Stiffness and place exchange for each other: neither is far from its null by itself.

    A gain of 60 is chi^2(2) under no effect: p = exp(-30) for each of the effects tested.
    """
    stop = end_stop(MODEL, "torque", "upper", 0.0, 0.1, 1e-3)
    assert stop is not None
    unused: Any = None
    found = Candidate(stop, (), MODEL, unused, 60.0, 10.0, wald=1.5)
    table: Any = SimpleNamespace(adjusted=lambda _: 1.0, tested=[None] * 40)
    assert p_value(table, found) == 1.0
    assert p_value(table, found, by_remainder=True) == pytest.approx(40 * 9.36e-14, rel=1e-3)


@pytest.mark.parametrize("noise_absorbs_misfit", [False, True])
def test_what_explains_nearly_as_much_is_compared_again_where_misfit_passed_for_noise(
    noise_absorbs_misfit: bool,
) -> None:
    assert COMPARISON.near_share == 0.8
    best, near, far = (judged(LAW, gain, 0.0) for gain in (100.0, 85.0, 75.0))
    at: Any = SimpleNamespace(noise_absorbs_misfit=noise_absorbs_misfit)
    expected = (near,) if noise_absorbs_misfit else ()
    assert near_ones(at, best, [best, near, far]) == expected


def as_fitted(effect: Effect, gain: float, left: float, late: int = 0, **more: float) -> Candidate:
    """A candidate that leaves so much of each of 100 samples, of which it misses the first ones."""
    used = np.arange(100)[:, None] >= late
    criterion = SimpleNamespace(
        data=[SimpleNamespace(used=used)],
        columns=lambda *_: (np.where(used, np.sqrt(2 * left), 0.0), None),
    )
    fit: Any = SimpleNamespace(criterion=criterion, x=None)
    return Candidate(effect, (), MODEL, fit, gain, 0.0, 0.0, **more)  # type: ignore[arg-type]


WIND = extra_input(MODEL, "torque", "wind", "m/s")
CALM: Any = SimpleNamespace(noise_absorbs_misfit=False, noise=SimpleNamespace(spectra={}))


@pytest.mark.parametrize("worse", [-0.1, 0.1])
def test_what_noise_of_the_inputs_alone_makes_worse_stays_a_rival(worse: float) -> None:
    """Each fit gives it another share of its error: of what was measured it leaves less."""
    best, other = as_fitted(LAW, 500.0, 1.0), as_fitted(JUMP, 480.0, 1.0 + worse)
    assert 500.0 - 480.0 > COMPARISON.strong
    rivals = [r.candidate for r in rivals_of(CALM, best, [best, other])]
    assert rivals == ([other] if worse < 0.0 else [])


def test_what_explains_little_is_no_rival_by_what_noise_of_the_inputs_it_takes_up() -> None:
    """Of an oven that radiates, a lag of the hall's temperature had a gain below zero."""
    best, lag = as_fitted(LAW, 500.0, 1.0), as_fitted(JUMP, -20.0, 0.9)
    assert rivals_of(CALM, best, [best, lag]) == ()


@pytest.mark.parametrize(("ahead", "is_open"), [(8.0, True), (11.0, False)])
def test_a_function_without_a_name_has_to_be_far_better_than_an_effect_with_one(
    ahead: float, is_open: bool
) -> None:
    """One record in twenty prefers a wrong power by six units of BIC."""
    root = next(e for e in unnamed_effects(MODEL, "torque", 0.1) if e.shape.startswith("sqrt"))
    assert COMPARISON.strong < ahead
    unnamed, named = as_fitted(root, 500.0, 1.0), as_fitted(LAW, 500.0 - ahead, 1.1)
    assert (rivals_of(CALM, unnamed, [unnamed, named]) != ()) is is_open
    assert rivals_of(CALM, named, [named, unnamed]) != ()


def test_a_channel_that_predicts_a_noisy_input_is_no_rival_by_smaller_errors() -> None:
    best, wind = as_fitted(LAW, 500.0, 1.0), as_fitted(WIND, 480.0, 0.9)
    assert rivals_of(CALM, best, [best, wind]) == ()


def test_a_late_sensor_is_compared_less_what_noise_of_the_inputs_gives_to_each() -> None:
    """2 (J_best - J_late) on 95 samples of both, of which 10 and 20 are noise of the inputs."""
    whole = as_fitted(WIND, 170.0, 1.0, of_inputs=10.0)
    late = as_fitted(JUMP, 180.0, 1.1, late=5, of_inputs=20.0)
    first, second = on_common_samples([whole, late])
    assert (first.gain, second.gain) == (170.0, pytest.approx(170.0 - 2 * 9.5 + 2 * 10.0))


@pytest.mark.slow
@pytest.mark.parametrize(("share", "is_told"), [(0.1, True), (0.3, False)])
def test_a_disturbance_that_moves_the_rate_rounds_off_the_kink_of_a_quadratic_law(
    share: float, is_told: bool
) -> None:
    """The mean of |w + v|(w + v) over a normal v is smooth at w = 0, as w + w^3 is."""
    square = quadratic_damping(MODEL, "torque")
    motion = np.sin(np.linspace(0.0, 60.0, 600))[:, None]
    left = share * np.random.default_rng(4).normal(0.0, np.sqrt(0.5), motion.shape)

    def found(effect: Effect, gain: float) -> Candidate:
        """Of each sample the same part of what it gains."""
        simulated = SimpleNamespace(y=motion, residual=left)
        criterion = SimpleNamespace(
            data=[None],
            simulated=lambda *_: simulated,
            columns=lambda *_: (np.full_like(motion, np.sqrt(2 - gain / motion.size)), None),
        )
        fit: Any = SimpleNamespace(criterion=criterion, x=None)
        return Candidate(effect, (), MODEL, fit, gain, 0.0, 0.0)

    at: Any = SimpleNamespace(
        noise_absorbs_misfit=False, noise=SimpleNamespace(spectra={"torque": None})
    )
    cube, jump = found(LAW, 500.0), found(JUMP, 490.0)
    rivals = rivals_of(at, cube, [cube, found(square, 480.0), jump])
    assert [r.candidate.effect.kind for r in rivals] == ([] if is_told else ["quadratic_damping"])


@pytest.mark.slow
def test_of_a_bias_and_a_gain_about_where_a_level_stays_the_bias_is_named() -> None:
    """A h' = q - c sqrt(h) has the gain 1 + s in h with (1 + s) A and sqrt(1 + s) c.

    A gain about a level is then a bias exactly.
    """
    A, c, Ts, N = 0.2, 0.003, 2.0, 630
    rng = np.random.default_rng(4)
    q = 0.0018 + 0.0004 * np.repeat(rng.choice([-1.0, 1.0], N // 45), 45)
    h = np.empty(N)
    h[0] = 0.5
    for k in range(N - 1):
        held = {"args": (q[k],), "rtol": 1e-8, "atol": 1e-10}
        step = solve_ivp(lambda _, x, q: (q - c * np.sqrt(x)) / A, (0.0, Ts), h[k : k + 1], **held)
        h[k + 1] = step.y[0, -1]
    level = h - 0.1 + 0.002 * rng.standard_normal(N)
    m = casid.Model("tank")
    inflow, x = m.input("q", "m^3/s", hold="zoh", known=True), m.state("h", "m", start=0.5)
    area = m.parameter("A", "m^2", start=0.1, lower=0.01, upper=2.0)
    outlet = m.parameter("c", "m^2.5/s", start=0.002, lower=1e-4, upper=1.0)
    terms = [inflow, -outlet * ca.sqrt(ca.fmax(x, 1e-6))]
    m.balance(x, "volume", inertia=area, terms=terms, unit="m^3/s")
    m.output("level", x, "m")
    record = casid.Record({"level": level, "q": q}, {"level": "m", "q": "m^3/s"}, Ts)
    found = casid.diagnose(casid.Problem("tank", m), record, advise=False)
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("sensor_bias", "level")
    assert ("sensor_scale", "level") in [(r.kind, r.where) for r in cause.alternatives]
    size = cause.parameters[0]
    assert size.value == pytest.approx(-0.1, abs=4 * size.std_error)


def test_an_effect_that_costs_more_than_it_gains_at_first_is_compared_again() -> None:
    """Under a noise that holds the misfit, gains are small beside what an instant costs."""
    best, second = judged(LAW, 17.0, 8.0), judged(LAW, 15.0, 8.0)
    jump, poor = judged(JUMP, 23.0, 17.0), judged(JUMP, 16.0, 17.0)
    feeble = judged(LAW, COMPARISON.relative_gain * 17.0 - 0.1, 0.0)
    assert leaders_of([best, second, jump, poor], 2) == [best, second, jump]
    assert leaders_of([best, second, jump, poor], 4) == [best, second, jump, poor]
    assert leaders_of([best, feeble], 2) == [best]
