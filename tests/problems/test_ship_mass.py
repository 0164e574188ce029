"""Mass and centre of mass by tilting and ballasting: from readings to what later stages know.

Readings are made here by statics of its own: forces and moments of a rigid body on two supports, a
floating box whose buoyancy is integrated over its wetted section.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq, fsolve

import casid
from problems import ship
from problems.ship_mass import (
    ANYWHERE,
    DISPLACEMENT,
    TABLE_9_2,
    Box,
    Equilibrium,
    Supports,
    Tank,
    Weighing,
    as_prior,
    ballasting,
    ballasting_equations,
    calculated_results,
    tilting_equations,
    tilting_test,
)

SUPPORTS = Supports((-0.35, 5e-4), (0.36, 5e-4), (0.2, 5e-4), (0.3, 1e-3), (0.01, 1e-3))
M, X_G, Z_G = 22.0, -0.002, 0.0073


def weighed(load: float, zbar_m: float, *, x_shift: float = 0.0) -> Weighing:
    """Two supports carry a body: forces and moments about the level axis, level and tilted."""
    L1, L2, L3, a, x_m = (getattr(SUPPORTS, n)[0] for n in ("L1", "L2", "L3", "alpha", "xbar_m"))

    def loads(angle: float) -> np.ndarray:
        # Horizontal places after a rotation: x cos - z sin, z down.
        arms = [L * np.cos(angle) - L3 * np.sin(angle) for L in (L1, L2)]
        x_body = X_G * np.cos(angle) - Z_G * np.sin(angle)
        x_load = x_m * np.cos(angle) - zbar_m * np.sin(angle)
        right = [M + load, M * x_body + load * x_load]
        return np.linalg.solve(np.array([[1.0, 1.0], arms]), right)

    (m1, m2), (m1t, m2t) = loads(0.0), loads(a)
    return Weighing(load, m1, m2, m1t, m2t, zbar_m)


LOADS = [weighed(0.0, 0.0), weighed(0.2, -0.256), weighed(0.4, -0.268)]


def test_a_tilting_test_without_errors_gives_the_centre_of_mass_and_agrees_with_itself() -> None:
    found = tilting_test(LOADS, SUPPORTS)
    assert found["M"] == pytest.approx(M, rel=1e-10)
    assert found["xbar_g"] == pytest.approx(X_G, rel=1e-7)
    assert found["zbar_g"] == pytest.approx(Z_G, rel=1e-7)
    assert found.statistic < 1e-12
    assert found.degrees == 4 * len(LOADS) - 3


def test_one_weighing_gives_what_the_closed_forms_give() -> None:
    """(9.1)-(9.2) solved for xbar_g and zbar_g, where no equation is redundant but the forces."""
    w = weighed(0.2, -0.256)
    L1, L2, L3, a, x_m = (getattr(SUPPORTS, n)[0] for n in ("L1", "L2", "L3", "alpha", "xbar_m"))
    assert w.m1t is not None
    assert w.m2t is not None
    found = tilting_test([w], SUPPORTS)
    x_g = (L1 * w.m1 + L2 * w.m2 - w.m * x_m) / M
    level = L1 * (w.m1 - w.m1t) + L2 * (w.m2 - w.m2t)
    z_g = ((L3 * (w.m1t + w.m2t) - w.m * w.zbar_m) * np.sin(a) + level * np.cos(a)) / (
        M * np.sin(a)
    )
    assert found["xbar_g"] == pytest.approx(x_g, abs=1e-12)
    assert found["zbar_g"] == pytest.approx(z_g, abs=1e-11)


def test_an_error_of_the_geometry_reaches_the_estimate_by_the_slope_of_the_closed_form() -> None:
    """One weighing, exact but for alpha: d zbar_g/d alpha = -level / (M sin^2 alpha)."""
    w = weighed(0.0, 0.0)
    assert w.m1t is not None
    assert w.m2t is not None
    zero = {n: (getattr(SUPPORTS, n)[0], 0.0) for n in ("L1", "L2", "L3", "xbar_m")}
    only = Supports(**zero, alpha=(0.3, 1e-3))
    found = tilting_test([w], only, M=(M, 0.0), scale_sd=1e-9)
    level = -0.35 * (w.m1 - w.m1t) + 0.36 * (w.m2 - w.m2t)
    slope = level / (M * np.sin(0.3) ** 2)
    assert found.std_error("zbar_g") == pytest.approx(1e-3 * abs(slope), rel=1e-4)


@pytest.mark.slow
def test_intervals_of_the_tilting_test_cover_the_truth_as_often_as_they_say() -> None:
    equations = tilting_equations(LOADS, SUPPORTS)
    exact = equations.solve()
    rng, runs = np.random.default_rng(1), 400
    hits, p = {"M": 0, "xbar_g": 0, "zbar_g": 0}, []
    truth = {"M": M, "xbar_g": X_G, "zbar_g": Z_G}
    for _ in range(runs):
        noisy = {n: v + sd * rng.normal() for n, (v, sd) in exact.readings.items()}
        found = equations.solve(noisy)
        p.append(found.p_value)
        for name in hits:
            low, high = found.interval(name)
            hits[name] += low < truth[name] < high
    for name, count in hits.items():  # four standard deviations of a proportion
        assert abs(count / runs - 0.95) < 4 * np.sqrt(0.95 * 0.05 / runs), name
    assert abs(np.mean(np.array(p) < 0.2) - 0.2) < 4 * np.sqrt(0.2 * 0.8 / runs)


def test_the_published_table_contradicts_itself_and_the_readings_to_blame_are_named() -> None:
    """m1 + m2 = 22.685 + m and not 22.04 + m; tilted sums are 22.685 whatever the load.

    What is added to a tilted reading is the very load that was forgotten; which of the two
    supports it is missing from, the forces cannot say.
    """
    found = tilting_test(TABLE_9_2, M=DISPLACEMENT)
    assert not found.is_consistent
    blamed = {frozenset(b.alternatives): b.corrections for b in found.blamed}
    assert blamed.keys() == {
        frozenset({"M"}),
        frozenset({"m1t[0.2 kg]", "m2t[0.2 kg]"}),
        frozenset({"m1t[0.4 kg]", "m2t[0.4 kg]"}),
    }
    assert blamed[frozenset({"M"})] == pytest.approx([0.645], abs=1e-6)
    assert blamed[frozenset({"m1t[0.2 kg]", "m2t[0.2 kg]"})] == pytest.approx([0.2] * 2, abs=1e-6)
    assert blamed[frozenset({"m1t[0.4 kg]", "m2t[0.4 kg]"})] == pytest.approx([0.4] * 2, abs=1e-6)
    text = str(found)
    assert "M (+0.645 +- 0.01 kg)" in text
    assert "m1t[0.4 kg] (+0.4 +- 0.0078 kg) or m2t[0.4 kg] (+0.4 +- 0.0078 kg)" in text
    with pytest.raises(casid.DataError, match=r"settle first what is wrong with M \(\+0\.645"):
        as_prior(found, ["M"])


def test_the_table_agrees_with_itself_once_the_forgotten_load_is_added() -> None:
    mended = [replace(w, m2t=w.m2t + w.m) if w.m2t else w for w in TABLE_9_2]
    found = tilting_test(mended)
    assert found.is_consistent
    assert found["M"] == pytest.approx(22.685, abs=1e-9)
    assert tilting_test(TABLE_9_2[:1]).is_consistent  # without a load nothing is forgotten


def test_the_tabulated_heights_were_calculated_with_the_load_added_to_the_second_support() -> None:
    """Of all geometries one finds none that gives the tabulated results from the printed readings,
    or with the load added to m1t; with m2t one within the rounding of 0.01 mm.
    """
    rows = TABLE_9_2[:3]
    second = [replace(w, m2t=w.m2t + w.m) for w in rows if w.m2t]
    first = [replace(w, m1t=w.m1t + w.m) for w in rows if w.m1t]
    for mass in ((22.04, 0.005), (22.685, 0.005)):
        fits = calculated_results(second, ANYWHERE, M=mass)
        heights = [v for n, v in fits.residuals.items() if n.startswith("zbar_g")]
        assert np.max(np.abs(heights)) * 5e-6 / 3**0.5 < 1e-5
        for others in (rows, first):
            wrong = calculated_results(others, ANYWHERE, M=mass)
            heights = [v for n, v in wrong.residuals.items() if n.startswith("zbar_g")]
            assert np.max(np.abs(heights)) * 5e-6 / 3**0.5 > 7e-5
            assert wrong.statistic > 20 * fits.statistic


def test_without_a_tilt_the_height_is_not_seen_and_the_refusal_says_so() -> None:
    level = [replace(w, m1t=None, m2t=None) for w in LOADS]
    with pytest.raises(casid.IdentifiabilityError, match=r"zbar_g does not move .* add a reading"):
        tilting_test(level, SUPPORTS)
    with pytest.raises(casid.DataError, match="no weighing; give one"):
        tilting_test([])


# -- ballasting -----------------------------------------------------------------------------------

RHO, G = 1025.0, 9.81
LENGTH, BEAM, HEIGHT = 20.0, 6.0, 1.2
OWN, Y, Z = 120_000.0, 0.02, 0.35  # without ballast; y to port, z up
HULL = Box((LENGTH, 5e-3), (BEAM, 2e-3), (HEIGHT, 2e-3))


def tank(m: float) -> Tank:
    return Tank((m, 2.0), (2.8, 2e-3), (0.3, 2e-3))


def totals(m1: float, m2: float) -> tuple[float, float, float]:
    """Mass and first moments with tank 1 to starboard, tank 2 to port, by sums over masses."""
    h, a = 2.8, 0.3
    y = OWN * Y - m1 * h * np.cos(a) + m2 * h * np.cos(a)
    z = OWN * Z + (m1 + m2) * h * np.sin(a)
    return OWN + m1 + m2, y, z


def floating(m1: float, m2: float) -> Equilibrium:
    """The equilibrium of (B.1)-(B.2), the moments as those of masses at points."""
    total, y, z = totals(m1, m2)
    draft = total / (RHO * LENGTH * BEAM)
    lever = BEAM**2 / 12 / draft - (HEIGHT - draft / 2)
    phi = float(np.arctan2(y, z - total * lever))
    phi = (phi + np.pi / 2) % np.pi - np.pi / 2
    return read(draft, phi, m1, m2)


def read(draft: float, phi: float, m1: float, m2: float) -> Equilibrium:
    """What the sensors at both ends of the keel say."""
    depth = [draft * np.cos(phi) + s * BEAM / 2 * np.sin(phi) for s in (1, -1)]
    p = [(RHO * G * d, 5.0) for d in depth]
    return Equilibrium(tank(m1), tank(m2), p[0], p[1])


BEFORE, AFTER = floating(1000.0, 4000.0), floating(3500.0, 1500.0)


def test_ballasting_without_errors_gives_mass_and_centre_of_mass() -> None:
    found = ballasting(BEFORE, AFTER, HULL, rho=(RHO, 0.0), g=G)
    total, y, z = totals(3500.0, 1500.0)
    expected = {
        "Mbar": OWN,
        "ybar_g": Y,
        "zbar_up": Z,
        "M": total,
        "y_g": y / total,
        "z_g": z / total,
        "zbar_g": -z / total,
        "H": np.hypot(y, z) / total,
    }
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-6), name
    assert found.degrees == 1  # two forces for one mass
    assert found.statistic < 1e-10


def test_the_closed_forms_of_the_appendix_hold_at_the_estimate() -> None:
    """(B.5)-(B.9) with the polar form Hbar, phi_d of the centre of mass; k with the plus sign."""
    e = ballasting(BEFORE, AFTER, HULL, rho=(RHO, 0.0), g=G)
    Hbar = np.hypot(e["ybar_g"], e["zbar_up"])
    phi_d = np.arctan2(-e["ybar_g"], e["zbar_up"])
    m1, h1, a1 = e["m1[after]"], e["h1[after]"], e["phi1[after]"]
    m2, h2, a2 = e["m2[after]"], e["h2[after]"], e["phi2[after]"]
    total = e["Mbar"] + m1 + m2
    y_g = (-e["Mbar"] * Hbar * np.sin(phi_d) - m1 * h1 * np.cos(a1) + m2 * h2 * np.cos(a2)) / total
    z_g = (e["Mbar"] * Hbar * np.cos(phi_d) + m1 * h1 * np.sin(a1) + m2 * h2 * np.sin(a2)) / total
    assert e["y_g"] == pytest.approx(y_g, rel=1e-9)
    assert e["z_g"] == pytest.approx(z_g, rel=1e-9)
    assert e["M"] == pytest.approx(total, rel=1e-12)
    assert e["H"] == pytest.approx(np.hypot(y_g, z_g), rel=1e-9)
    # GM_T of (B.4) with BG from the centre of buoyancy to the centre of mass.
    draft = e["draft[after]"]
    GM = BEAM**2 / 12 / draft - (HEIGHT + z_g - draft / 2)
    assert e["GM_T"] == pytest.approx(GM, rel=1e-7)
    assert e["k"] == pytest.approx(total * G * GM + total * G * z_g, rel=1e-7)


def test_with_the_second_equilibrium_upright_its_moments_are_those_of_b3() -> None:
    def heel(m1: float) -> float:
        return totals(m1, 1500.0)[1]

    m1 = brentq(heel, 0.0, 5000.0)
    e = ballasting(BEFORE, floating(m1, 1500.0), HULL, rho=(RHO, 0.0), g=G)
    assert e["phi[after]"] == pytest.approx(0.0, abs=1e-9)
    b3 = e["Mbar"] * e["ybar_g"] - (m1 - 1500.0) * 2.8 * np.cos(0.3)
    assert abs(b3) < 1e-6 * e["Mbar"] * BEAM
    assert e["y_g"] == pytest.approx(0.0, abs=1e-8)
    assert e["k"] == pytest.approx(e["M"] * G * (e["GM_T"] + e["H"]), rel=1e-9)  # (B.9)


def section(draft: float, phi: float) -> tuple[float, float, float]:
    """Wetted area of a box's section, and its centroid (y, z) from the reference point."""
    y = (np.arange(4000) + 0.5) / 4000 * BEAM - BEAM / 2  # to port
    depth = draft - y * np.tan(phi)  # wetted height at y; starboard goes down
    width = BEAM / 4000
    area = float(np.sum(depth) * width)
    return (
        area,
        float(np.sum(depth * y) * width) / area,
        float(np.sum(depth**2 / 2) * width) / area - HEIGHT,
    )


def test_a_floating_box_is_described_up_to_the_change_of_its_lever_with_heel() -> None:
    """Buoyancy integrated over the wetted section. (B.1) takes the metacentre as fixed; the box's
    own lever grows by (I_T / nabla) tan^2(phi) / 2, which then is the error of the height.
    """

    def afloat(m1: float, m2: float) -> tuple[Equilibrium, float]:
        total, y, z = totals(m1, m2)

        def balance(state: np.ndarray) -> list[float]:
            area, y_b, z_b = section(*state)
            buoyancy = RHO * LENGTH * area
            c, s = np.cos(state[1]), np.sin(state[1])
            moment = y * c - z * s - buoyancy * (y_b * c - z_b * s)  # horizontal distances
            return [(total - buoyancy) / total, moment / total]

        draft, phi = fsolve(balance, [total / (RHO * LENGTH * BEAM), 0.0], xtol=1e-13)
        return read(draft, phi, m1, m2), float(phi)

    (before, heel), (after, _) = afloat(1000.0, 4000.0), afloat(2700.0, 2300.0)
    assert 0.01 < abs(heel) < 0.1
    found = ballasting(before, after, HULL, rho=(RHO, 0.0), g=G)
    total = totals(1000.0, 4000.0)[0]
    shift = BEAM**2 / 12 / found["draft[before]"] * np.tan(heel) ** 2 / 2 * total / OWN
    assert found["Mbar"] == pytest.approx(OWN, rel=1e-6)
    assert found["zbar_up"] == pytest.approx(Z - shift, abs=0.3 * shift)
    assert found["ybar_g"] == pytest.approx(Y, rel=0.05)


@pytest.mark.slow
def test_intervals_of_ballasting_cover_the_truth_as_often_as_they_say() -> None:
    equations = ballasting_equations(BEFORE, AFTER, HULL, rho=(RHO, 0.5), g=G)
    exact = equations.solve()
    names = ["Mbar", "y_g", "z_g", "k", "GM_T"]
    truth = {n: exact[n] for n in names}
    rng, runs = np.random.default_rng(2), 400
    hits = dict.fromkeys(names, 0)
    for _ in range(runs):
        noisy = {n: v + sd * rng.normal() for n, (v, sd) in exact.readings.items()}
        found = equations.solve(noisy)
        for name in names:
            low, high = found.interval(name)
            hits[name] += low < truth[name] < high
    for name, count in hits.items():
        assert abs(count / runs - 0.95) < 4 * np.sqrt(0.95 * 0.05 / runs), name


def test_two_equilibria_of_one_heel_do_not_show_the_height() -> None:
    m1 = brentq(lambda m: totals(m, 1500.0)[1], 0.0, 5000.0)
    upright = floating(m1, 1500.0)
    with pytest.raises(casid.IdentifiabilityError, match="zbar_up does not move .* add a reading"):
        ballasting(upright, upright, HULL, rho=(RHO, 0.0), g=G)
    with pytest.raises(casid.IdentifiabilityError, match="ybar_g and zbar_up are not separately"):
        ballasting(BEFORE, BEFORE, HULL, rho=(RHO, 0.0), g=G)


# -- what later stages know -----------------------------------------------------------------------


def test_what_is_known_of_the_ship_reaches_the_errors_of_what_is_estimated_later() -> None:
    """The load of problems/ship with mass and centre of mass from a tilting test: with the test's
    covariance the errors are larger than with its values alone, by the slope along each.
    """
    true = ship.TABLE_8_2
    test = tilting_test(LOADS, SUPPORTS)
    prior = as_prior(test, {"M": "M", "zbar_g": "zbar_g"})
    assert list(prior.values) == ["M", "zbar_g"]
    np.testing.assert_allclose(prior.matrix(), test.covariance_of(["M", "zbar_g"]))
    assert prior.matrix()[0, 0] == pytest.approx(test.std_error("M") ** 2)

    # The record's own ship has other values; the covariance is the tilting test's.
    records = ship.experiments(duration=20.0, sensors=ship.NOISELESS)

    def estimate(covariance: np.ndarray | None = None, **shift: float) -> casid.MomentEstimate:
        values = {n: true[n] + shift.get(n, 0.0) for n in ("M", "zbar_g")}
        return casid.multistage(
            ship.problem,
            records,
            [casid.StageSpec(())],
            prior=casid.Prior(values, covariance),
            settings=casid.MomentSettings(),
        )

    known, uncertain = estimate(), estimate(prior.matrix())
    steps = {"M": 0.01, "zbar_g": 1e-4}
    up = {n: estimate(**{n: step}) for n, step in steps.items()}
    down = {n: estimate(**{n: -step}) for n, step in steps.items()}
    for name in ("m", "zbar_m", "A_x", "k"):
        assert uncertain[name] == pytest.approx(known[name], rel=1e-9)
        slope = np.array([(up[n][name] - down[n][name]) / 2 / s for n, s in steps.items()])
        gained = uncertain.std_error(name) ** 2 - known.std_error(name) ** 2
        assert gained == pytest.approx(slope @ prior.matrix() @ slope, rel=0.02), name
    # The height of the centre of mass is what matters: it moves S = M z_g + m z_m by M.
    assert uncertain.std_error("k") > 2 * known.std_error("k")
