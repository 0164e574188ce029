"""Feedforward from measured unknown inputs, and inverse models: (6.22)-(6.24) of Linder (2017)."""

from __future__ import annotations

import random
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.unknown_inputs.indirect.direct_model import direct_model
from casid.unknown_inputs.indirect.feedforward import feedforward
from casid.unknown_inputs.indirect.indirect_model import indirect_model
from casid.unknown_inputs.networks.simulation import filtered

q = Rational.shift()


def module(rng: random.Random) -> Rational:
    """Minimum phase and biproper, small fractions."""
    a, b, c = (Fraction(rng.randint(-8, 8), 10) for _ in range(3))
    return (b + Fraction(17, 20)) * (q - c) / (q - a)


def loop_free(seed: int, n: int = 1):
    """n outputs, n actuators, one unknown input; the actuators do not act on its measurement."""
    rng = random.Random(seed)
    rows = [[module(rng) for _ in range(n)] for _ in range(n)]
    return direct_model(
        G_OK=rows,
        G_OI=[[module(rng)] for _ in range(n)],
        G_II=module(rng),
        H_O=[[module(rng)] for _ in range(n)],
        H_I=module(rng),
    )


@given(seed=st.integers(0, 10**6), n=st.integers(1, 2))
@settings(max_examples=15, deadline=None)
def test_with_feedforward_the_output_is_that_of_6_23_exactly(seed: int, n: int) -> None:
    """y_O = Gt_OK u* + Ht_O tau at a random rational q, whatever the unknown input is."""
    m = indirect_model(loop_free(seed, n))
    try:
        f = feedforward(m)
    except ModelError:
        return  # two actuators that act alike
    rng = random.Random(seed + 1)
    z = Fraction(rng.randint(11, 99), 7)
    u_I, tau, star = (Fraction(rng.randint(-9, 9), 4) for _ in range(3))

    def at(M) -> list[list[Fraction]]:
        return M.at(z)

    y_I = at(m.direct.G_II)[0][0] * u_I + at(m.direct.H_I)[0][0] * tau
    u_K = [star + row[0] * y_I for row in at(f.G_KI)]
    d = m.direct
    for i in range(n):
        y = sum((g * u for g, u in zip(at(d.G_OK)[i], u_K, strict=True)), Fraction(0))
        y += at(d.G_OI)[i][0] * u_I + at(d.H_O)[i][0] * tau
        wanted = sum((g * star for g in at(m.G_OK)[i]), Fraction(0)) + at(m.H_O)[i][0] * tau
        assert y == wanted


def test_the_inverse_model_6_24_is_6_22_solved_for_the_input():
    m = indirect_model(loop_free(3))
    f = feedforward(m)
    assert (f.G_KO @ m.G_OK)[0, 0].equals(1)
    assert (f.G_KO @ m.G_OI + f.G_KI)[0, 0].is_zero


def test_a_simulated_disturbance_is_gone():
    """In the time domain, from rest: the output with feedforward is zero to rounding."""
    d = loop_free(5)
    f = feedforward(indirect_model(d)).require_realisable()
    u_I = np.random.default_rng(0).standard_normal(500)
    y_I = filtered(d.G_II[0, 0], u_I)
    u_K = filtered(f.G_KI[0, 0], y_I)
    y = filtered(d.G_OK[0, 0], u_K) + filtered(d.G_OI[0, 0], u_I)
    alone = filtered(d.G_OI[0, 0], u_I)
    assert np.max(np.abs(y)) < 1e-10 * np.max(np.abs(alone))


def test_a_shared_delay_keeps_feedforward_realisable():
    """Gt_OK^-1 looks ahead, but Gt_OI is late as well."""
    m = indirect_model(direct_model(G_OK=0.5 / (q - 0.6), G_OI=0.2 / (q - 0.3), G_II=1.0 + 0 * q))
    f = feedforward(m)
    assert not f.inverse.is_proper
    assert f.is_realisable
    assert np.max(np.abs(f.left_over(np.linspace(0.01, 3, 20)))) < 1e-12


def test_a_late_actuator_is_refused_with_the_samples_and_what_is_left_by_an_approximation():
    m = indirect_model(
        direct_model(G_OK=0.5 / (q * (q - 0.6)), G_OI=0.2 * q / (q - 0.3), G_II=1.0 + 0 * q)
    )
    f = feedforward(m)
    with pytest.raises(ModelError, match="looks 2 samples ahead.*directly.*delayed"):
        f.require_realisable()
    late = next(a for a in f.approximations() if a.kind == "delayed")
    mended = f.approximated(late).require_realisable()
    omega = np.array([0.05, 0.2])
    left = np.abs(mended.left_over(omega)[:, 0, 0] / m.G_OI.frequency_response(omega)[:, 0, 0])
    assert np.allclose(left, late.error_at(omega), rtol=1e-9)
    ahead = next(a for a in f.approximations() if a.kind == "noncausal")
    with pytest.raises(ModelError, match="needs the future"):
        f.approximated(ahead)


def test_a_zero_outside_the_unit_circle_is_named_with_its_frequency():
    m = indirect_model(
        direct_model(G_OK=(q - 1.25) / (q - 0.6), G_OI=0.2 * q / (q - 0.3), G_II=1.0 + 0 * q)
    )
    f = feedforward(m)
    with pytest.raises(ModelError, match=r"from the zero .*1\.25"):
        f.require_realisable()
    mirrored = next(a for a in f.approximations() if "mirrored" in a.kind)
    assert f.approximated(mirrored).is_realisable


def test_a_zero_that_the_disturbance_shares_does_no_harm():
    shared = (q - 1.25) / (q - 0.6)
    m = indirect_model(direct_model(G_OK=shared, G_OI=shared * 0.2 / (q - 0.3), G_II=1.0 + 0 * q))
    assert feedforward(m).is_realisable


def test_the_loop_through_the_measurement_has_its_poles_at_the_zeros_of_the_direct_model():
    """1 - Gt_KI G_IK = Gt_OK^-1 G_OK: filters may be stable, and the loop they close is not."""
    own = (q - 1.25) / (q - 0.6)
    d = direct_model(G_OK=own, G_OI=1 + 0 * q, G_II=1 + 0 * q, G_IK=-1 + 0 * q)
    f = feedforward(indirect_model(d))
    assert f.matrix.is_proper
    assert f.G_KI[0, 0].is_stable  # Gt_OK = (2 q - 1.85)/(q - 0.6)
    assert [r.value for r in f.unstable_loop] == pytest.approx([1.25])
    with pytest.raises(ModelError, match=r"loop from u_K to y_I and back is unstable at .*1\.25"):
        f.require_realisable()
    apart = direct_model(G_OK=own, G_OI=own, G_II=1 + 0 * q)  # a measurement that u_K cannot reach
    assert feedforward(indirect_model(apart)).is_realisable


def test_fewer_actuators_than_outputs_are_refused():
    m = indirect_model(
        direct_model(G_OK=[[1 / q], [2 / q]], G_OI=[[1 / q], [1 / q]], G_II=1.0 + 0 * q)
    )
    with pytest.raises(ModelError, match="cannot move the 2 outputs.*as many actuators"):
        feedforward(m)


def test_a_model_without_a_known_input_has_nothing_to_feed_forward_with():
    m = indirect_model(direct_model(G_OI=0.2 / (q - 0.3), G_II=1.0 + 0 * q))
    with pytest.raises(ModelError, match="no known input u_K.*give G_OK"):
        feedforward(m)
