"""The ship's signals depend on one another as section 8.2 says, where its print is mended."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sympy

from analysis.ship_signals import study
from analysis.ship_signals.blocks import Diagram, Node, Wire, draw
from analysis.ship_signals.correlation import (
    SIGNALS,
    Drives,
    linear_records,
    sampled,
    simulator_records,
)
from analysis.ship_signals.diagrams import diagrams, worst_departure
from analysis.ship_signals.figures import bode, correlations, steps
from analysis.ship_signals.formulas import (
    a_s_of_delta,
    coefficients,
    direct_term_a_s,
    hull_at,
    hull_residue,
    loop_residue,
    printed_8_31,
    printed_8_86,
    printed_yaw_limit,
    responses,
    roll_at,
    roll_residue,
    symbolic_direct_terms,
    symbols,
    y_of_delta,
    yaw_limit,
)
from analysis.ship_signals.inward_heel import critical_height, lean
from analysis.ship_signals.model import (
    accelerometer,
    drawn_values,
    frequency_response,
    matrices,
    ship_model,
    values_of,
)
from casid.errors import ModelError
from casid.linear.linear_model import linearise
from casid.linear.loops.closed_loop import closed_loop_view
from problems.ship import LOAD_CASES as KNOWN
from problems.ship import TABLE_8_2, indirect_model
from problems.ship_4dof import LOAD_CASES, Coefficients, Ship, linearised, tangent


def draws(n: int, seed: int = 82):
    """Random letters and frequencies, with the exact responses there."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        values, s = drawn_values(rng), 1j * 10 ** rng.uniform(-1.5, 1.5)
        yield values, s, frequency_response(values, s)


# -- the model -----------------------------------------------------------------------------------


@pytest.mark.parametrize("case", LOAD_CASES)
def test_the_model_in_letters_is_the_linearised_simulator(case):
    c = replace(Coefficients(), K_rdot=0.2, N_pdot=-0.1, K_uv=0.4, N_uv=-3.0, Y_phiuu=1.0, N_up=0.2)
    body, load = Ship(coefficients=c), LOAD_CASES[case]
    E, F, B = matrices(values_of(body, load, 1.3))
    for other in (linearised(1.3, ship=body, load=load), tangent(1.3, ship=body, load=load)):
        np.testing.assert_allclose(E, other.E, rtol=0, atol=1e-12)
        np.testing.assert_allclose(F, other.F, rtol=0, atol=1e-11)
        np.testing.assert_allclose(B[:, 0], other.F_delta, rtol=0, atol=1e-12)
        np.testing.assert_allclose(B[:, 1], other.T[:, 1], rtol=0, atol=1e-12)


def test_state_space_and_transfer_functions_of_casid_and_python_control_agree():
    model, s = linearise(ship_model(values_of())), 0.3 + 2.1j
    den, num = model.transfer().evaluate()
    system, exact = np.asarray(model.to_control()(s)), frequency_response(values_of(), s)
    for i, y in enumerate(("gyro", "accel", "yaw")):
        for j, u in enumerate(("delta", "tau")):
            assert system[i, j] == pytest.approx(exact[f"{y}/{u}"], rel=1e-12)
            ratio = np.polyval(num[i][j], s) / np.polyval(den, s)
            assert ratio == pytest.approx(exact[f"{y}/{u}"], rel=1e-12)


def test_the_published_coefficients_of_the_roll_subsystem():
    """A_2 of three load cases, and the five of the nominal ship, to their printed digits."""
    for case, A_2 in {"nominal": 0.037876, "calibration": 0.036756, "loaded": 0.036364}.items():
        assert coefficients(values_of(load=LOAD_CASES[case]))["A_2"] == pytest.approx(A_2, abs=5e-7)
    found = coefficients(values_of())
    wanted = {"alpha1": 5.4573, "beta1": 13.6530, "kappa1": -13.2010, "gamma1": -10.6928}
    for name, value in wanted.items():
        assert found[name] == pytest.approx(value, abs=5.1e-5), name
    assert found["alpha2"] == pytest.approx(248.125, abs=5.1e-4)


@pytest.mark.parametrize("case", ["nominal", "calibration", "loaded"])
def test_they_are_those_of_the_eliminated_model(case):
    """beta1 s/(s^2 + alpha1 s + alpha2) is casid's transfer function after `eliminate` (8.20)."""
    names = indirect_model().parameters
    values = {n: TABLE_8_2[n] for n in names} | KNOWN[case]
    den, num = linearise(indirect_model()).transfer("gyro").evaluate(values)
    q = coefficients(values_of(load=LOAD_CASES[case]))
    np.testing.assert_allclose(den, [1.0, q["alpha1"], q["alpha2"]], rtol=1e-12)
    for column, name in zip(num[0], ("r", "delta", "accel"), strict=True):
        key = {"r": "kappa1", "delta": "gamma1", "accel": "beta1"}[name]
        np.testing.assert_allclose(np.trim_zeros(column), [q[key]], rtol=1e-12)


def test_what_the_roll_balance_leaves_out_is_refused_by_name():
    with pytest.raises(ModelError, match=r"K_uv = 0\.5 is left out.*Set it to 0"):
        coefficients(values_of() | {"K_uv": 0.5})


# -- the formulas --------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_formulas_are_the_model_identically_in_all_letters():
    """(8.33)-(8.35) and (8.22) are its rows; (8.27)-(8.36) follow, whatever G, F and A to H are."""
    assert not any(hull_residue())
    assert not any(roll_residue())
    assert {name for name, left in loop_residue().items() if left != 0} == set()


def test_the_formulas_are_the_state_space_at_random_frequencies():
    """To rounding: 1e-10, where 1e-14 is seen; 1 - F_y G cancels digits near a resonance."""
    for v, s, exact in draws(40):
        k, h = roll_at(v, s), hull_at(v, s)
        for name, found in responses(k, h, -1 / (v["K_vdot"] + v["S"])).items():
            assert found == pytest.approx(exact[name], rel=1e-10), name
        dr, dv = exact["yaw/delta"], exact["vdot/delta"]
        assert y_of_delta(k, dr, dv) == pytest.approx(exact["gyro/delta"], rel=1e-10)
        assert a_s_of_delta(k, dr, dv) == pytest.approx(exact["accel/delta"], rel=1e-10)


def test_the_printed_forms_are_wrong():
    """(8.31): + U G_dr for - U G_dr; (8.86): F_y and a sign lost. By more than 1 %, every time."""
    for v, s, exact in draws(40):
        k = roll_at(v, s)
        dr, dv = exact["yaw/delta"], exact["vdot/delta"]
        a = exact["accel/delta"]
        twice = 2 * k.U * dr / (1 - k.F_y * k.G)
        assert printed_8_31(k, dr, dv) - a == pytest.approx(twice, rel=1e-8)
        assert abs(printed_8_31(k, dr, dv) / a - 1) > 1e-2
        loop = np.array([[1.0, -k.G], [-k.F_y, 1.0]])
        _, mended = np.linalg.solve(loop, [k.G * (k.F_d + k.F_r * dr), -k.U * dr])
        assert a_s_of_delta(k, dr, 0) == pytest.approx(mended, rel=1e-10)
        assert abs(printed_8_86(k, dr) / mended - 1) > 1e-2


# -- direct terms --------------------------------------------------------------------------------


def test_the_torque_reaches_the_accelerometer_at_once_and_the_yaw_rate_never():
    """(8.36)-(8.38): lim G Fbar_y in letters; r has one integration more than r' has."""
    q, found = symbols(), symbolic_direct_terms()
    ratio = found["a_s"] / found["p'"] - direct_term_a_s(q) / coefficients(q)["beta1"]
    assert sympy.cancel(ratio) == 0
    turn = found["r'"] / found["p'"]
    assert sympy.cancel(turn - yaw_limit(q)) == 0
    assert sympy.cancel(turn - printed_yaw_limit(q)) != 0
    v = values_of()
    assert abs(accelerometer(v)[1][1]) > 1.0  # m/s^2 per N m
    near, far = (frequency_response(v, 1j * w) for w in (1e4, 1e5))
    assert far["accel/tau"] == pytest.approx(accelerometer(v)[1][1], rel=1e-3)
    assert abs(far["yaw/tau"] / near["yaw/tau"]) == pytest.approx(0.1, rel=1e-3)


def test_the_limit_of_the_loop_is_its_direct_term():
    """G Fbar_y approaches it as 1/s."""
    for v, _, _ in draws(10, seed=3):
        k, h = roll_at(v, 1e7j), hull_at(v, 1e7j)
        loop = k.G * (k.F_y - h.vdot_y - k.U * h.r_y)
        assert loop == pytest.approx(direct_term_a_s(v), rel=1e-4)
        assert abs(k.G * k.F_r * h.r_y) < 1e-4 * abs(loop)


# -- correlations --------------------------------------------------------------------------------


def test_the_signals_are_correlated_with_the_torque_as_lyapunov_has_it():
    """Fifteen numbers, each within 4.5 standard errors; all three correlations beyond five."""
    found = linear_records(sampled(), records=150, N=3000, seed=8)
    assert np.abs(found.z).max() < 4.5, dict(zip(found.names, found.z, strict=True))
    strength = np.abs(found.mean / found.error)
    for i, name in enumerate(SIGNALS):
        assert max(strength[i], strength[3 + i]) > 5, name


def test_the_simulator_shows_the_same_correlations():
    """Small motions: 0.4 deg of roll, where drag in sway is under 1 % of its linear damping."""
    system = sampled()
    found = simulator_records(system, records=8, seconds=120.0, settle=20.0, seed=9)
    assert np.abs(found.z[:6]).max() < 5.5, dict(zip(found.names, found.z, strict=True))
    assert np.all(np.abs(found.mean[[0, 1, 3, 4]] / found.error[[0, 1, 3, 4]]) > 5)


def test_only_the_accelerometer_holds_the_torque_of_the_same_instant():
    """What is gained within a sample falls as Ts for rates, and tends to the direct term."""
    coarse, fine = sampled(0.02).at_once(), sampled(0.0002).at_once()
    np.testing.assert_allclose(fine[[0, 2]] / coarse[[0, 2]], 0.01, rtol=0.05)
    direct = accelerometer(values_of())[1][1]
    assert fine[1] == pytest.approx(direct, rel=1e-3)
    assert coarse[1] == pytest.approx(direct, rel=0.05)


def test_noise_of_a_sensor_lowers_its_correlation_alone():
    system = sampled(drives=Drives(delta=0.1, tau=0.1))
    clean, noisy = system.correlation(), system.correlation(noise={"accel": 0.5})
    assert abs(noisy[1]) < 0.8 * abs(clean[1])
    np.testing.assert_array_equal(noisy[[0, 2]], clean[[0, 2]])


# -- the lean ------------------------------------------------------------------------------------


def test_the_lean_is_gone_at_z_r_0_where_S_plus_K_vdot_is_positive():
    low, level = lean(hull="chapter 9"), lean(0.0, hull="chapter 9")
    assert len(low.right) == 1
    assert low.onset < 0.0 < low.inward < low.outward
    assert (low.turn, level.turn) == (-1.0, -1.0)
    assert level.right == ()
    assert level.inward == 0.0
    assert level.outward > 0.0


def test_with_table_8_2_a_thousandth_of_the_lean_is_left_at_z_r_0():
    """S + K_vdot < 0: z_r* is 8.5 mm above the origin, so z_r = 0 is still below it."""
    low, level = lean(), lean(0.0)
    assert low.right == pytest.approx((4.794,), abs=1e-3)
    assert level.right[0] > 100.0
    assert 0.0 < level.inward < 1e-3 * low.inward
    star = critical_height().subs({sympy.Symbol(n): x for n, x in values_of().items()})
    assert float(star) == pytest.approx(-0.0085, abs=1e-4)
    assert len(lean(float(star) + 1e-3).right) == 1
    assert lean(float(star) - 1e-3).right == ()


# -- figures -------------------------------------------------------------------------------------


def test_the_block_diagrams_say_what_the_formulas_say():
    """Solved as graphs, at random systems: to rounding."""
    for v, s, _ in draws(5, seed=4):
        torque = -1 / (v["K_vdot"] + v["S"])
        for name, apart in worst_departure(roll_at(v, s), hull_at(v, s), torque=torque).items():
            assert apart < 1e-10, name


def test_a_wrong_sign_in_a_diagram_would_be_seen():
    v, s = values_of(), 0.2 + 1.7j
    k, h = roll_at(v, s), hull_at(v, s)
    loop = diagrams()["figure_8_5_accelerometer_loop"]
    wires = tuple(replace(w, sign=1) for w in loop.wires)
    g = {"G": k.G, "F_r": k.F_r, "F_d": k.F_d, "F_y": k.F_y, "U": k.U}
    right = loop.respond(g, {"r": 1.0})["y"]
    wrong = replace(loop, wires=wires).respond(g, {"r": 1.0})["y"]
    full = responses(k, h, 1.0)
    assert abs(full["gyro/delta"]) > 0.0
    assert right == pytest.approx(k.G * (k.F_r - k.U) / (1 - k.F_y * k.G), rel=1e-12)
    assert abs(wrong / right - 1) > 0.1


@pytest.mark.parametrize("name", diagrams())
def test_no_wire_runs_through_a_block(name):
    diagram = diagrams()[name]
    assert diagram.crossed() == []
    figure = draw(diagram)
    drawn = [s for s in figure.layout.shapes if s.type == "rect"]
    assert len(drawn) == len(diagram.blocks)
    tips = [a for a in figure.layout.annotations if a.showarrow]
    into = [w for w in diagram.wires if diagram.node(w.end).kind != "tap"]
    assert len(tips) == len(into)


def test_a_wire_that_ends_nowhere_or_runs_aslant_is_refused():
    nodes = (Node("u", "source", (0, 0)), Node("y", "sink", (1, 1)))
    with pytest.raises(ValueError, match=r"runs aslant.*corner, via="):
        Diagram("d", nodes, (Wire("u", "y"),))
    with pytest.raises(ValueError, match="'z', which is no node"):
        Diagram("d", nodes, (Wire("u", "z"),))
    with pytest.raises(ValueError, match="stand twice"):
        Diagram("d", (*nodes, nodes[0]), ())


def test_the_figures_hold_what_their_captions_claim():
    figure = bode()
    torque = {t.name: np.asarray(t.y) for t in figure.data if t.yaxis == "y2"}
    assert torque["accelerometer"][-1] > 1.0
    assert torque["yaw rate"][-1] < 1e-3
    low = lean(hull="chapter 9")
    traces = {t.name: np.asarray(t.y) for t in steps({"low": low}).data}
    assert traces["low, simulator"].min() < 0.0
    system = sampled()
    found = linear_records(system, records=20, N=400, seed=1)
    names = {t.name for t in correlations(system, [("linear", found)]).data}
    assert {"roll rate", "accelerometer", "yaw rate, linear"} <= names


# -- the study -----------------------------------------------------------------------------------


def test_the_study_meets_its_targets():
    """Its sections without records; the words on inputs rest on casid's verdicts."""
    values = {n: x for n, x in study.roll_table().items() if n != "U"}  # few letters: quick
    view = closed_loop_view(indirect_model(), values=values)
    sections = (study.five_states(), study.direct_terms(view), study.inputs(view), study.drawn())
    targets = [t for section in sections for t in section]
    assert [str(t) for t in targets if not t.is_met] == []
    assert len(targets) > 30
