"""The ship of chapter 8: its indirect model is the thesis', its records obey its roll equation."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

import casid
from casid.algebra.symbolic import to_sympy
from casid.errors import IdentifiabilityError
from casid.model.dimensions import check_units
from problems import ship
from problems.ship import LOAD_CASES, NINE, NOISELESS, TABLE_8_2, Roll
from tests.support.shared import ROOT

V = TABLE_8_2
LOADED = {name: V[name] for name in ("m", "zbar_m")}
VARIANTS = [(turn, tied) for turn in ("K_r", "K_ur") for tied in (True, False)]


def symbols(names):
    return [sympy.Symbol(n) for n in names.split()]


def heights(tied):
    """S, A_1 (8.11) and z_s (8.21) of symbols."""
    A_x, M, zbar_g, m, zbar_m, z_f = symbols("A_x M zbar_g m zbar_m z_f")
    z_g, z_m = zbar_g + z_f, zbar_m + z_f
    z_s = sympy.Symbol("zbar_s") + z_f if tied else sympy.Symbol("z_s")
    return M * z_g + m * z_m, A_x + M * z_g**2 + m * z_m**2, z_s


def turning(turn):
    """K_r and K_ur of symbols (8.19)."""
    U, K_vdot, free = symbols(f"U K_vdot {turn}")
    return (free, K_vdot + free / U) if turn == "K_r" else ((free - K_vdot) * U, free)


def coefficients(values):
    """alpha1, alpha2, beta1, kappa1, gamma1 of (8.24) and A_2 of (8.18), from numbers alone."""
    v = {**V, **values}
    z_g, z_m, z_s = (v[n] + v["z_f"] for n in ("zbar_g", "zbar_m", "zbar_s"))
    S = v["M"] * z_g + v["m"] * z_m
    A_2 = v["A_x"] + v["M"] * z_g * (z_g - z_s) + v["m"] * z_m * (z_m - z_s) - v["K_vdot"] * z_s
    of_A_2 = [v["d"], v["k"] - v["K_vdot"] * v["g"], -(v["K_vdot"] + S), v["K_r"], v["K_delta"]]
    return [c / A_2 for c in of_A_2], A_2


# -- its equations ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("turn", "tied"), VARIANTS)
def test_the_direct_model_is_the_state_space_of_the_thesis(turn, tied):
    """(8.10) and (8.13)-(8.16), as printed, with (8.21)."""
    model = ship.roll_model(turn=turn, tied=tied)
    check_units(model)
    f, h = (to_sympy(e, exact_numbers=True) for e in (model.explicit().f, model.explicit().h))
    phi, p, vdot, r, delta, k, d, g, U = symbols("phi p vdot r delta k d g U")
    K_vdot, K_delta = symbols("K_vdot K_delta")
    (S, A_1, z_s), (_, K_ur) = heights(tied), turning(turn)
    torque = -(k + S * g) * phi - d * p + (K_vdot + S) * vdot + (K_ur + S) * U * r + K_delta * delta
    expected = [p, torque / A_1, p, z_s * torque / A_1 + g * phi - vdot - U * r]
    for found, wanted in zip([*f, *h], expected, strict=True):
        assert sympy.cancel(found - wanted) == 0


@pytest.mark.parametrize(("turn", "tied"), VARIANTS)
def test_eliminating_the_sway_acceleration_leaves_the_indirect_model_of_the_thesis(turn, tied):
    """(8.17)-(8.20), A_2 in both forms of (8.18), coefficients as in (8.22)-(8.24)."""
    model = ship.indirect_model(turn=turn, tied=tied)
    check_units(model)
    f = to_sympy(model.explicit().f, exact_numbers=True)
    phi, p, accel, r, delta = symbols("phi p accel r delta")
    k, d, g, A_x, M, m = symbols("k d g A_x M m")
    zbar_g, zbar_m, z_f, K_vdot, K_delta = symbols("zbar_g zbar_m z_f K_vdot K_delta")
    (S, A_1, z_s), (K_r, _) = heights(tied), turning(turn)
    z_g, z_m = zbar_g + z_f, zbar_m + z_f
    A_2 = A_x + M * z_g * (z_g - z_s) + m * z_m * (z_m - z_s) - K_vdot * z_s
    assert sympy.expand(A_2 - (A_1 - z_s * (K_vdot + S))) == 0
    alpha = [d / A_2, (k - K_vdot * g) / A_2]
    beta, kappa, gamma = -(K_vdot + S) / A_2, K_r / A_2, K_delta / A_2
    expected = -alpha[1] * phi - alpha[0] * p + beta * accel + kappa * r + gamma * delta
    assert f[0] == p
    assert sympy.cancel(f[1] - expected) == 0


def test_the_coefficients_have_the_values_of_the_thesis():
    """A_2 nominal, calibrated, loaded and the nominal coefficients, from Table 8.2."""
    e = ship.indirect_model().explicit()
    f = to_sympy(e.f, exact_numbers=True)[1]
    wanted_A_2 = {"nominal": 0.037876, "calibration": 0.036756, "loaded": 0.036364}
    for case, A_2 in wanted_A_2.items():
        values = {**V, **(LOAD_CASES[case] or LOADED)}
        row = f.subs(values)
        found = [float(sympy.diff(row, s)) for s in symbols("p phi accel r delta")]
        signs = [-1, -1, 1, 1, 1]
        expected, A_2_found = coefficients(values)
        assert A_2_found == pytest.approx(A_2, abs=5e-7)
        np.testing.assert_allclose(np.multiply(signs, found), expected, rtol=1e-12)
        if case == "nominal":
            published = [5.4573, 248.125, 13.6530, -13.2010, -10.6928]
            np.testing.assert_allclose(expected, published, rtol=2e-5)


# -- its records -----------------------------------------------------------------------------------


@pytest.mark.parametrize("known", [LOAD_CASES["nominal"], LOAD_CASES["calibration"], LOADED])
def test_a_record_without_noise_obeys_the_indirect_model(known):
    """phi' against (8.20) driven by the recorded a_s, r and delta, from the best initial state.

    Between samples the inputs are taken as straight lines, which a wave of w rad/s leaves by
    (w Ts)^2/12 of its amplitude: 0.5 % at the fastest, 12 rad/s.
    """
    from scipy.signal import lsim

    record = ship.roll_record(Roll(**known), sensors=NOISELESS, duration=20.0)
    (a1, a2, b, kappa, gamma), _ = coefficients(known)
    A, B = np.array([[0.0, 1.0], [-a2, -a1]]), np.array([[0.0] * 3, [b, kappa, gamma]])
    system = A, B, np.array([[0.0, 1.0]]), np.zeros((1, 3))
    u = np.column_stack([record[n] for n in ("accel", "r", "delta")])
    forced = lsim(system, u, record.t)[1]
    free = np.column_stack([lsim(system, 0.0 * u, record.t, X0=x)[1] for x in np.eye(2)])
    misfit = record["gyro"] - forced
    misfit -= free @ np.linalg.lstsq(free, misfit, rcond=None)[0]
    assert np.sqrt(np.mean(misfit**2)) < (12 * 0.02) ** 2 / 12 * np.std(record["gyro"])


def test_records_without_noise_return_the_true_parameters():
    """Eight parameters from three load cases, to the 0.5 % that straight lines leave."""
    estimate = casid.identify(
        ship.problem,
        ship.experiments(sensors=NOISELESS, duration=30.0),
        settings=casid.FitSettings(starts=1),
    )
    for name, true in ship.problem.truth.items():
        assert estimate[name] == pytest.approx(true, rel=(12 * 0.02) ** 2 / 12), name


def test_the_example_knows_what_its_load_case_knows():
    experiments = ship.problem.examples()
    assert [e.name for e in experiments] == ["nominal", "calibration", "loaded"]
    for e in experiments:
        assert e.known == LOAD_CASES[e.name]
    again = ship.draw(2)
    assert not np.array_equal(again[0].record["gyro"], experiments[0].record["gyro"])


# -- its problems ----------------------------------------------------------------------------------


def test_the_file_defines_a_problem_of_eight_parameters():
    problem = casid.load_problem(ROOT / "problems" / "ship.py")
    unknown = {n for n, p in problem.model.parameters.items() if not p.is_known}
    assert unknown == set(NINE) - {"z_f"} == set(problem.truth)


@pytest.mark.slow
def test_a_fit_of_all_nine_parameters_is_refused_with_what_to_know():
    """The calibration gives one equation, not two: rank 14 of 9 parameters and 6 states."""
    nine = ship.nine_parameters()
    assert set(nine.truth) == set(NINE)
    with pytest.raises(IdentifiabilityError, match="rank 14 of 15") as refusal:
        casid.identify(nine)
    assert "give one of them a known value" in str(refusal.value)


def test_the_second_calibration_stands_at_another_height():
    experiments = ship.two_calibrations().examples()
    known = [e.known["zbar_m"] for e in experiments if "zbar_m" in e.known]
    assert len(known) == len(set(known)) == 2
    assert experiments[-1].known == {}
