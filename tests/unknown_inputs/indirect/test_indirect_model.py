"""The indirect model in transfer functions: (4.9)-(4.18) and section 4.5 of Linder (2017)."""

from __future__ import annotations

import random
from fractions import Fraction
from typing import Any

import control
import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.algebra.rational import Rational
from casid.algebra.transfer_matrix import RationalMatrix, transfer_matrix
from casid.errors import ModelError
from casid.unknown_inputs.indirect.approximate_inverse import run_noncausally
from casid.unknown_inputs.indirect.direct_model import DirectModel, direct_model
from casid.unknown_inputs.indirect.indirect_model import indirect_model
from casid.unknown_inputs.indirect.left_inverse import left_inverse, lost_inputs
from casid.unknown_inputs.indirect.output_choice import choose_output
from casid.unknown_inputs.indirect.special_cases import closed_loop, special_case

q = Rational.shift()
s = Rational.derivative()
SEEDS = st.integers(0, 10**6)


def random_rational(rng: random.Random, delay: int = 0) -> Rational:
    """A stable first-order module b q^-delay (1 - c q^-1)/(1 - a q^-1), small fractions."""
    a, b, c = (Fraction(rng.randint(-9, 9), 10) for _ in range(3))
    return (b + Fraction(1, 20)) * (q - c) / (q - a) * q**-delay


def block(rng: random.Random, m: int, n: int, delay: int = 0) -> list[list[Rational]]:
    return [[random_rational(rng, delay) for _ in range(n)] for _ in range(m)]


def general_model(seed: int, nO: int = 1, nK: int = 1, nI: int = 1, nD: int = 1) -> DirectModel:
    """All blocks of (4.3)-(4.5), tall measurements, one additional signal, two noises."""
    rng = random.Random(seed)
    mI, mD = nI + 1, nD + 1
    return direct_model(
        G_OK=block(rng, nO, nK, 1),
        G_OI=block(rng, nO, nI),
        G_OD=block(rng, nO, nD, 1),
        H_O=block(rng, nO, 2),
        G_IK=block(rng, mI, nK),
        G_II=block(rng, mI, nI),
        G_ID=block(rng, mI, nD),
        G_IA=block(rng, mI, 1),
        H_I=block(rng, mI, 2),
        G_DD=block(rng, mD, nD),
        H_D=block(rng, mD, 2),
    )


def times(M: RationalMatrix, at: Fraction, v: list[Fraction]) -> list[Fraction]:
    return [sum((g * x for g, x in zip(row, v, strict=True)), Fraction(0)) for row in M.at(at)]


def total(*parts: list[Fraction]) -> list[Fraction]:
    return [sum(column, Fraction(0)) for column in zip(*parts, strict=True)]


# -- the identity ----------------------------------------------------------------------------------


@given(seed=SEEDS, nI=st.integers(1, 2), nD=st.integers(1, 2))
@settings(max_examples=8, deadline=None)
def test_the_indirect_model_is_the_direct_one_exactly_at_a_random_rational_q(
    seed: int, nI: int, nD: int
) -> None:
    """(4.11)-(4.18): y_O from u_K, y_I, y_D, u_A and tau is y_O from u_K, u_I, u_D and tau."""
    d = general_model(seed, nI=nI, nD=nD)
    m = indirect_model(d)
    rng = random.Random(seed + 1)
    z = Fraction(rng.randint(11, 99), 7)  # outside the unit circle, no pole

    def signal(n: int) -> list[Fraction]:
        return [Fraction(rng.randint(-99, 99), rng.randint(1, 9)) for _ in range(n)]

    u_K, u_I, u_D, u_A, tau = signal(1), signal(nI), signal(nD), signal(1), signal(2)
    y_O = total(
        times(d.G_OK, z, u_K), times(d.G_OI, z, u_I), times(d.G_OD, z, u_D), times(d.H_O, z, tau)
    )
    y_D = total(times(d.G_DD, z, u_D), times(d.H_D, z, tau))
    y_I = total(
        times(d.G_IK, z, u_K), times(d.G_II, z, u_I), times(d.G_ID, z, u_D),
        times(d.G_IA, z, u_A), times(d.H_I, z, tau),
    )  # fmt: skip
    found = total(
        times(m.G_OK, z, u_K), times(m.G_OI, z, y_I), times(m.G_OD, z, y_D),
        times(m.G_OA, z, u_A), times(m.H_O, z, tau),
    )  # fmt: skip
    assert found == y_O


def test_parameters_may_stay_letters() -> None:
    """Example 4.2: y_I = aK uK + aI uI: only bK - bI aK/aI and bI/aI are seen."""
    bK, bI, aK, aI = sympy.symbols("bK bI aK aI")
    d = direct_model(G_OK=bK, G_OI=bI, G_IK=aK, G_II=aI)
    m = indirect_model(d)
    assert sympy.simplify(m.G_OK[0, 0].expression() - (bK - bI * aK / aI)) == 0
    assert sympy.simplify(m.G_OI[0, 0].expression() - bI / aI) == 0
    assert m.matrix.parameters == ("aI", "aK", "bI", "bK")


def test_example_3_11_dynamics_that_sensors_share_are_lost() -> None:
    """y1 = G1bar G u, y2 = G2bar G u give y1 = G1bar/G2bar y2, though 1/G is improper, unstable."""
    shared = (q - 2) / ((q - Fraction(3, 2)) * (q - Fraction(1, 2)) ** 2)
    bar_1, bar_2 = 1 / (q - Fraction(1, 4)), 1 / (q - Fraction(1, 5))
    m = indirect_model(direct_model(G_OI=bar_1 * shared, G_II=bar_2 * shared))
    assert m.G_OI[0, 0].equals(bar_1 / bar_2)
    assert not m.f_II.is_proper
    assert not m.f_II.is_stable
    assert m.is_proper
    assert m.is_stable
    assert m.require_usable() is m
    assert "proper and stable" in repr(m)


def test_measurement_noise_confounds_and_acts_within_the_sample() -> None:
    """tau_I is in the model's input and in its error; a direct term makes the loop algebraic."""
    g = 1 / (q - Fraction(1, 2))
    m = indirect_model(
        direct_model(
            G_OK=g, G_OI=2 * g, G_II=g, H_O=[[1, 0]], H_I=[[0, 1]], names={"noise": ["e", "n"]}
        )
    )
    assert m.confounding_noise == ("n",)
    assert m.has_direct_term
    assert m.H_O[0, 1].equals(-2)
    assert "direct estimates are biased" in str(m)


# -- left inverses ---------------------------------------------------------------------------------


@given(seed=SEEDS)
@settings(max_examples=25, deadline=None)
def test_a_left_inverse_of_a_tall_matrix_is_proper_and_stable_unless_a_zero_forbids_it(
    seed: int,
) -> None:
    """Three measurements of one input without a common zero: there is one, f G = 1 exactly."""
    rng = random.Random(seed)
    zeros = [Fraction(rng.randint(11, 30), 10) for _ in range(3)]  # each alone is not invertible
    poles = [Fraction(rng.randint(-9, 9), 10) for _ in range(3)]
    G = transfer_matrix([[(q - z) / (q - p)] for z, p in zip(zeros, poles, strict=True)])
    f = left_inverse(G)
    common = zeros[0] == zeros[1] == zeros[2]
    assert f.is_usable != common
    assert (f.f @ G)[0, 0].equals(1)
    assert bool(f.unstable_zeros) == common


def test_rows_are_chosen_before_gains_and_the_quiet_before_the_loud() -> None:
    """Of three rows the first has an unstable zero, the second is weak: the third alone is used."""
    g = 1 / (q - Fraction(1, 2))
    f = left_inverse(transfer_matrix([[(q - 2) * g], [g * q / 100], [g * q]]))
    assert f.how == "from y3 alone"
    assert f.is_usable
    two = left_inverse(transfer_matrix([[(q - 2) * g], [(q - 3) * g]]))
    assert two.how == "all measurements, with a free gain"
    assert two.is_usable
    assert (two.f @ two.G)[0, 0].equals(1)


def test_continuous_time_has_a_free_gain_too() -> None:
    G = transfer_matrix([[(s - 1) / (s + 2)], [(s - 4) / (s + 3)]])
    f = left_inverse(G)
    assert f.is_usable
    assert (f.f @ G)[0, 0].equals(1)
    assert "free gain" in f.how


@pytest.mark.parametrize("x", [q, s])
def test_measurements_that_come_late_leave_an_inverse_that_looks_ahead_but_is_stable(
    x: Rational,
) -> None:
    """Both rows have an unstable zero and a relative degree, 1 and 2; together no finite zero."""
    pole = (x + Fraction(1, 2)) * (x + Fraction(1, 3))
    G = transfer_matrix([[(x - 2) / pole], [(x - 3) / (pole * (x + Fraction(1, 4)))]])
    f = left_inverse(G)
    assert not f.is_proper
    assert f.excess <= 2
    assert f.is_stable
    assert f.unstable_zeros == ()
    assert (f.f @ G)[0, 0].equals(1)
    assert f.approximations((0.0, 0.1))[0].kind == "delayed"


def test_the_refusal_names_the_zero_its_frequency_and_what_was_offered() -> None:
    """G = q^-2 (q - 1.25)/(q - .5) at Ts = 0.1 s: looks ahead, and a zero outside the circle."""
    z = Rational.shift(0.1)
    G = transfer_matrix([[(z - Fraction(5, 4)) / (z**2 * (z - Fraction(1, 2)))]])
    f = left_inverse(G)
    with pytest.raises(ModelError, match=r"improper: it needs 2 samples ahead") as refusal:
        f.require_usable()
    said = str(refusal.value)
    assert "q = 1.25 (|q| = 1.25, not inside the unit circle, 2.231 rad/s)" in said
    assert "delayed and mirrored: error up to" in said
    assert "noncausal, over a whole record" in said
    model = indirect_model(direct_model(G_OI=1 / (z - Fraction(1, 2)), G_II=G))
    with pytest.raises(ModelError, match="y_O / y_I is improper.*choose another output"):
        model.require_usable()


def test_a_mirrored_zero_has_the_right_amplitude_and_a_delay_the_right_shape() -> None:
    """f_a G = B exactly where f's poles are known: |B| = 1 for an all-pass, B(1) = 1."""
    G = transfer_matrix([[(q - Fraction(5, 4)) / (q - Fraction(1, 2))]])
    mirrored, noncausal = left_inverse(G).approximations((0.0, 0.3))
    w = np.linspace(0.0, 3.1, 50)
    assert mirrored.kind == "mirrored"
    np.testing.assert_allclose(np.abs(mirrored.B.frequency_response(w)), 1.0, atol=1e-12)
    achieved = (mirrored.f @ G).frequency_response(w)[:, 0, 0]
    np.testing.assert_allclose(achieved, mirrored.B.frequency_response(w), atol=1e-9)
    assert mirrored.f.is_stable
    assert mirrored.f.is_proper
    assert mirrored.error == pytest.approx(
        float(np.max(mirrored.error_at(np.linspace(0, 0.3, 500))))
    )
    assert noncausal.error == 0.0
    late = left_inverse(transfer_matrix([[q**-2]])).approximations((0.0, 0.1))[0]
    assert late.kind == "delayed"
    assert late.f[0, 0].equals(1)  # y itself, two samples late
    assert late.error == pytest.approx(2 * np.sin(0.1), rel=1e-9)  # |e^{-2jw} - 1|
    # Several inputs, complex zeros: the same scalar serves every entry.
    pair = q**2 - 2 * q + 2
    M = transfer_matrix([[pair / q**2, 1 / q], [0, (q - 3) / q]])
    both = left_inverse(M).approximations((0.0, 0.3))[0]
    product = (both.f @ M).frequency_response(w)
    B = both.B.frequency_response(w)
    np.testing.assert_allclose(product, B[:, None, None] * np.eye(2), atol=1e-8)
    assert both.f.is_stable


def test_a_zero_on_the_edge_leaks_where_nothing_can_be_known() -> None:
    """G = (q - 1)/(q - .5) passes no constant on: its inverse would integrate noise for ever."""
    z = Rational.shift(0.01)
    G = transfer_matrix([[(z - 1) / (z - Fraction(1, 2))]])
    f = left_inverse(G)
    assert not f.is_usable
    assert "q = 1 " in f.obstacles[0]
    (leaky,) = f.approximations()  # nor does it help to run it backward
    assert leaky.kind == "leaky"
    assert leaky.f.is_stable
    w = np.geomspace(0.1, 300.0, 40)
    achieved = (leaky.f @ G).frequency_response(w)[:, 0, 0]
    np.testing.assert_allclose(achieved, leaky.B.frequency_response(w), atol=1e-9)
    assert leaky.error_at(np.array([0.0]))[0] == pytest.approx(1.0)
    low, high = leaky.good_band() or (0.0, 0.0)
    assert 0 < low <= leaky.band[0] * 1.05
    assert high == pytest.approx(leaky.band[1])
    with pytest.raises(ModelError, match="leaky: error up to .* below 10 % from"):
        f.require_usable()
    # An accelerometer on a mass: two zeros at s = 0.
    two = left_inverse(transfer_matrix([[s**2 / (s**2 + s + 4)]])).approximations((1.0, 5.0))[0]
    assert two.kind == "leaky"
    assert two.f.is_stable


def test_in_continuous_time_an_improper_inverse_is_filtered_a_decade_above_the_band() -> None:
    G = transfer_matrix([[(1 - s) / (s + 2) ** 3]])
    f = left_inverse(G)
    assert f.excess == 2
    approximate = f.approximations((0.0, 0.2))[0]
    assert approximate.kind == "delayed and mirrored"
    assert approximate.f.is_proper
    assert approximate.f.is_stable
    w = np.array([0.0, 0.05, 0.2])
    achieved = (approximate.f @ G).frequency_response(w)[:, 0, 0]
    np.testing.assert_allclose(achieved, approximate.B.frequency_response(w), atol=1e-9)
    assert approximate.error_at(np.array([0.0]))[0] < 1e-12


def test_the_noncausal_inverse_undoes_the_filter_over_a_record() -> None:
    G = transfer_matrix([[(q - Fraction(5, 4)) / (q**2 * (q - Fraction(1, 2)))]])
    f = left_inverse(G).f
    rng = np.random.default_rng(1)
    u = rng.standard_normal(600)
    _, y = control.forced_response(G[0, 0].to_control(), inputs=u)
    found, valid = run_noncausally(f, y)
    # Valid from 1e-3 on; transients of the pole 1.25 die out backward as 0.8^k.
    np.testing.assert_allclose(found[valid, 0], u[valid], atol=1e-2)
    np.testing.assert_allclose(found[:450, 0], u[:450], atol=1e-9)
    assert valid.sum() > 500
    with pytest.raises(ModelError, match=r"pole q = 1 .*lies on the unit circle"):
        run_noncausally(transfer_matrix([[1 / (q - 1)]]), y)
    with pytest.raises(ModelError, match=r"give \(N, 1\)"):
        run_noncausally(f, np.zeros((9, 2)))


# -- special cases, section 4.5 --------------------------------------------------------------------


def test_the_special_cases_of_section_4_5_are_named() -> None:
    g = 1 / (q - Fraction(1, 2))
    cases = {
        "open loop, MIMO": direct_model(G_OK=[[g, g]]),
        "open loop, SISO": direct_model(G_OK=g),
        "classical errors in variables": direct_model(G_OD=g, G_DD=1),
        "errors in variables": direct_model(G_OD=g, G_DD=g),
        "sensor to sensor (S2SID)": direct_model(G_OI=g, G_II=g),
        "indirect input measurements": direct_model(G_OK=g, G_OI=g, G_II=g),
    }
    for name, model in cases.items():
        assert special_case(model).name == name
    fed_back = {
        "closed loop, SISO": cases["open loop, SISO"],
        "classical errors in variables, closed loop": cases["classical errors in variables"],
    }
    for name, model in fed_back.items():
        assert special_case(model, feedback=True).name == name


def test_open_loop_and_errors_in_variables_are_what_4_11_leaves() -> None:
    g, H = 1 / (q - Fraction(1, 2)), q / (q - Fraction(1, 3))
    known = indirect_model(direct_model(G_OK=g, H_O=H))
    assert known.matrix[0, 0].equals(g)
    assert known.H_O[0, 0].equals(H)
    eiv = indirect_model(direct_model(G_OD=g, G_DD=1, H_O=[[H, 0]], H_D=[[0, 1]]))
    assert eiv.matrix[0, 0].equals(g)  # (3.52): y_O = G y_U + (tau_O - G e_U)
    assert eiv.H_O[0, 1].equals(-g)
    s2 = indirect_model(direct_model(G_OI=g, G_II=3 * g / q))
    assert s2.matrix[0, 0].equals(q / 3)  # (3.66)


@given(seed=SEEDS)
@settings(max_examples=10, deadline=None)
def test_4_57_is_the_loop_solved_exactly(seed: int) -> None:
    rng = random.Random(seed)
    d = direct_model(G_OK=block(rng, 1, 2, 1), H_O=block(rng, 1, 1))
    F_y, F_r = transfer_matrix(block(rng, 2, 1)), transfer_matrix(block(rng, 2, 1))
    loop = closed_loop(d, F_y, F_r)
    z, tau, delta = Fraction(37, 11), [Fraction(3, 7)], [Fraction(-2, 5)]
    u = total(times(loop.from_noise, z, tau), times(loop.from_reference, z, delta))
    y = total(times(d.G_OK, z, u), times(d.H_O, z, tau))
    assert u == total(times(F_y, z, y), times(F_r, z, delta))


def test_an_ill_posed_loop_is_refused_with_its_mend() -> None:
    d = direct_model(G_OK=2 * q / (q - Fraction(1, 2)))
    half = transfer_matrix([[Fraction(1, 2)]])
    with pytest.raises(ModelError, match="vanishes at infinity.*a delay of one sample"):
        closed_loop(d, half, transfer_matrix([[1]]))
    assert closed_loop(d, transfer_matrix([[Fraction(1, 2) / q]]), half).from_noise.shape == (1, 0)


# -- choice of output and input, section 4.4 -------------------------------------------------------


def test_example_4_6_both_forms_are_one_relation() -> None:
    """(4.53) and (4.54): G12 of one is the inverse of the other, known parts accordingly."""
    G1K, G1I, G2K, G2I = sympy.symbols("G1K G1I G2K G2I")
    choice = choose_output([[G1I], [G2I]], [[G1K], [G2K]])
    by_output = {form.outputs: form.model for form in choice.forms}
    m53, m54 = by_output[("y1",)], by_output[("y2",)]
    assert sympy.simplify(m53.G_OK[0, 0].expression() - (G1K - G1I / G2I * G2K)) == 0
    assert sympy.simplify(m53.G_OI[0, 0].expression() - G1I / G2I) == 0
    assert sympy.simplify(m54.G_OK[0, 0].expression() - (G2K - G2I / G1I * G1K)) == 0
    assert sympy.simplify(m54.G_OI[0, 0].expression() - G2I / G1I) == 0


def test_example_4_6_the_form_that_is_proper_and_stable_is_recommended() -> None:
    """G1I two samples later than G2I: y2 cannot be had from y1 without looking ahead."""
    fast, late = q / (q - Fraction(1, 2)), (q - 2) / (q**2 * (q - Fraction(1, 2)))
    choice = choose_output([[late], [fast]], [[1 / q], [1 / q]])
    assert choice.recommended.outputs == ("y1",)
    assert choice.recommended.inputs == ("y2",)
    assert choice.recommended.is_usable
    assert "it alone is proper and stable" in choice.reason
    other = choice.forms[1]
    assert not other.is_usable
    assert any("improper" in o for o in other.model.obstacles)
    assert any("q = 2" in o for o in other.model.obstacles)
    swapped = choose_output([[fast], [late]], [[1 / q], [1 / q]])
    assert swapped.recommended.outputs == ("y2",)
    forced = choose_output([[late], [fast]], wanted=["y2"])
    assert forced.recommended.outputs == ("y2",)
    assert "no form is proper and stable" in forced.reason


def test_of_two_usable_forms_the_quieter_is_recommended() -> None:
    """y1 = 4 u + e1, y2 = u + e2: error of y1 from y2 is e1 - 4 e2, of y2 from y1 e2 - e1/4."""
    choice = choose_output([[4], [1]])
    assert choice.recommended.outputs == ("y2",)
    assert choice.recommended.amplification == pytest.approx(np.sqrt(1 + 1 / 16))
    assert choice.forms[1].amplification == pytest.approx(np.sqrt(17))
    quiet = choose_output([[4], [1]], noise={"y2": 0.01, "y1": 1.0})
    assert quiet.recommended.outputs == ("y1",)  # the quiet measurement is the better input
    assert "4.12" in choice.reason


def test_choices_that_determine_nothing_are_left_out() -> None:
    choice = choose_output([[1 / q, 0], [2 / q, 0], [0, 1], [1, 1]])
    assert len(choice.forms) == 5
    assert "inputs y1, y2: u_I2 cannot be recovered" in choice.left_out[0]
    with pytest.raises(ModelError, match="leave no output; measure more signals"):
        choose_output([[1 / q]])
    with pytest.raises(ModelError, match="no measurement 'y3'"):
        choose_output([[1], [1]], wanted=["y3"])


# -- bad input -------------------------------------------------------------------------------------


def test_inputs_that_cannot_be_recovered_are_named() -> None:
    """Column 2 is 3/(q - .5) times column 1: neither can be told from the other, u_I3 can."""
    g = 1 / (q - Fraction(1, 2))
    G = [[g, 3 * g * g, 1], [2 * g, 6 * g * g, 0], [g, 3 * g * g, g]]
    with pytest.raises(ModelError, match="u_I1, u_I2 cannot be recovered.*rank 2 of 3") as refusal:
        indirect_model(direct_model(G_OI=[[1, 1, 1]], G_II=G))
    assert "Measure another signal" in str(refusal.value)
    assert lost_inputs(transfer_matrix(G)) == ("u1", "u2")
    mended = [G[0], G[1], [g, 0, g]]
    assert indirect_model(direct_model(G_OI=[[1, 1, 1]], G_II=mended)).matrix.shape == (1, 3)


def test_a_filter_that_is_no_left_inverse_is_refused() -> None:
    g = 1 / (q - Fraction(1, 2))
    d = direct_model(G_OI=g, G_II=[[g], [2 * g]])
    half = transfer_matrix([[0, 1 / (2 * g)]])
    assert indirect_model(d, f_II=half).G_OI[0, 1].equals(Fraction(1, 2))
    with pytest.raises(ModelError, match="f G from u_I to u_I is 2, not 1; leave it out"):
        indirect_model(d, f_II=transfer_matrix([[0, 1 / g]]))
    with pytest.raises(ModelError, match="is 1 x 2, not 1 x 1"):
        indirect_model(d, f_II=transfer_matrix([[1 / g]]))


@pytest.mark.parametrize(
    ("blocks", "said"),
    [
        ({"G_OK": [[1, 2]], "G_IK": [[1]]}, "G_IK has 1 columns for u_K, but G_OK has 2"),
        ({"G_OK": 1, "H_O": [[1], [1]]}, "H_O has 2 rows for y_O, but G_OK has 1"),
        ({"G_OI": [[1, 1]], "G_II": [[1, 2]]}, "2 inputs u_I1, u_I2 are to be had from 1 meas"),
        ({"G_OI": 1}, "1 inputs u_I are to be had from 0 measurements; give G_II"),
        ({"G_II": 1}, "no output: give G_OK, G_OI or G_OD"),
        (
            {"G_OK": control.tf([1], [1, 0.5], 0.1), "H_O": control.tf([1], [1, 0.5], 0.2)},
            "G_OK has the sample time 0.1 s, H_O 0.2 s; resample one",
        ),
        ({"G_OK": 1 / (q - 3), "H_O": 1 / (s + 1)}, "G_OK is in q, H_O in s; convert both"),
    ],
)
def test_blocks_that_do_not_fit_are_refused(blocks: dict[str, Any], said: str) -> None:
    with pytest.raises(ModelError) as refusal:
        direct_model(**blocks)
    assert said in str(refusal.value)


def test_names_are_checked() -> None:
    with pytest.raises(ModelError, match="names has no 'output'"):
        direct_model(G_OK=1, names={"output": ["y"]})
    with pytest.raises(ModelError, match="2 known are named, but the blocks have 1"):
        direct_model(G_OK=1, names={"known": ["a", "b"]})
    d = direct_model(G_OK=1, names={"known": ["push"], "outputs": ["speed"]})
    assert indirect_model(d).inputs == ("push",)
    assert "speed" in repr(d)


def test_what_else_is_asked_wrongly_is_refused_with_its_mend() -> None:
    g = 1 / (q - Fraction(1, 2))
    known, eiv = direct_model(G_OK=g), direct_model(G_OD=g, G_DD=1)
    one = transfer_matrix([[1]])
    with pytest.raises(ModelError, match="for known inputs alone; close the loop of the indirect"):
        closed_loop(eiv, one, one)
    with pytest.raises(ModelError, match=r"F_y is \(1, 2\).*give \(1, 1\)"):
        closed_loop(known, transfer_matrix([[1, 1]]), one)
    letter = sympy.Symbol("a")
    with pytest.raises(ModelError, match="no value is given for a; give them with substitute"):
        left_inverse(transfer_matrix([[letter]])).approximations()
    late = left_inverse(transfer_matrix([[1 / q]]))
    with pytest.raises(ModelError, match="give .low, high. in rad/s with 0 <= low < high"):
        late.approximations((1.0, 0.5))
    with pytest.raises(ModelError, match="3 measurements are named, G_I has 2 rows; name each"):
        choose_output([[1], [1]], measurements=["a", "b", "c"])
    with pytest.raises(ModelError, match="G_K has 1 rows, G_I 2; give one a measurement"):
        choose_output([[1], [1]], [[1]])
    with pytest.raises(ModelError, match="all of them are wanted as outputs"):
        choose_output([[1], [1]], wanted=["y1", "y2"])
    with pytest.raises(ModelError, match="a filter in s cannot run on samples; sample it first"):
        run_noncausally(transfer_matrix([[1 / (s + 1)]]), np.zeros(9))


def test_a_form_in_letters_does_not_claim_to_be_stable() -> None:
    a, x = sympy.symbols("a q")
    chosen = choose_output([[a / (x - 0.5)], [1]], Ts=1.0)
    assert not any(form.is_usable for form in chosen.forms)
    assert "whether it is stable depends on a" in str(chosen)
    numbers = choose_output([[0.3 / (x - 0.5)], [1]], Ts=1.0)
    assert any(form.is_usable for form in numbers.forms)


def test_an_indirect_model_that_cannot_be_run_prints_what_can() -> None:
    m = indirect_model(direct_model(G_OK=1 / q, G_OI=1 / (q - 0.5), G_II=(q - 1.5) / (q - 0.2)))
    assert "instead: mirrored" in str(m)
