"""Parameters that no data tell apart lie on curves; their formulas and invariants are theory."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from casid.algebra.prime_field import null_space
from casid.errors import IdentifiabilityError
from casid.identifiability.combinations.family import family
from casid.identifiability.combinations.null_direction import (
    NullDirection,
    normalised,
    null_directions,
)
from casid.identifiability.combinations.scalar_flow import integrate_scalar, rational_integral

SHIP = ["k", "A_x", "d", "K_r", "K_vdot", "K_delta", "z_f", "m", "zbar_m"]
KNOWN = ["M", "zbar_g", "zbar_s", "m_c", "zbar_c", "g"]


def ship_coefficients(v):
    """The 15 coefficients of (8.22)-(8.24), model (8.20), three records: nominal, calibration
    (m_c at zbar_c) and loaded (m at zbar_m), z_s = zbar_s + z_f (thesis, section 8.3)."""
    out = []
    for m, zbar in ((0, 0), (v["m_c"], v["zbar_c"]), (v["m"], v["zbar_m"])):
        zg, zs, zm = (b + v["z_f"] for b in (v["zbar_g"], v["zbar_s"], zbar))
        S = v["M"] * zg + m * zm
        A2 = v["A_x"] + v["M"] * zg * (zg - zs) + m * zm * (zm - zs) - v["K_vdot"] * zs
        above = (v["d"], v["k"] - v["K_vdot"] * v["g"], -(v["K_vdot"] + S), v["K_r"], v["K_delta"])
        out += [a / A2 for a in above]
    return out


def null_of(coefficients, parameters, known, free):
    """The null space of a Jacobian of rational functions, in exact arithmetic modulo p."""
    v = {n: sympy.Symbol(n) for n in (*parameters, *known)}
    jacobian = sympy.Matrix(coefficients(v)).jacobian([v[n] for n in parameters])
    parts = [part for e in jacobian for part in sympy.fraction(sympy.together(e))]
    function = sympy.lambdify(list(v.values()), parts, modules=[{}], cse=True)

    def null_at(values, p):
        got = function(*(values[n] for n in v))
        if any(b % p == 0 for b in got[1::2]):
            raise ZeroDivisionError
        entries = [a * pow(b, -1, p) % p for a, b in zip(got[::2], got[1::2], strict=True)]
        matrix = np.array(entries, dtype=np.int64).reshape(jacobian.shape)
        return normalised(null_space(matrix, p), [parameters.index(n) for n in free], p)

    return null_at


@pytest.fixture(scope="module")
def ship():
    null_at = null_of(ship_coefficients, SHIP, KNOWN, ["z_f"])
    (direction,) = null_directions(null_at, SHIP, ["z_f"], [*SHIP, *KNOWN])
    return family(direction)


def ship_truth(v, z):
    """The known family [E-21], lam = (zbar_c + z_f') / (zbar_c + z_f)."""
    zg, zs, zm = (v[n] + v["z_f"] for n in ("zbar_g", "zbar_s", "zbar_m"))
    lam, M, g = (v["zbar_c"] + z) / (v["zbar_c"] + v["z_f"]), v["M"], v["g"]
    arm = v["zbar_g"] - v["zbar_s"]
    new_zg = M * (v["zbar_g"] + z)
    Kv = lam * (v["K_vdot"] + M * zg) - new_zg
    A_x = lam * (v["A_x"] + M * zg * arm - v["K_vdot"] * zs) - new_zg * arm
    return {
        "k": lam * (v["k"] - v["K_vdot"] * g) + Kv * g,
        "A_x": A_x + Kv * (v["zbar_s"] + z),
        "d": lam * v["d"],
        "K_r": lam * v["K_r"],
        "K_vdot": Kv,
        "K_delta": lam * v["K_delta"],
        "z_f": z,
        "m": lam * v["m"] * zm / (v["zbar_m"] + z),
        "zbar_m": v["zbar_m"],
    }


def fractions(names, seed):
    rng = np.random.default_rng(seed)
    return {n: Fraction(*(int(i) for i in rng.integers(1, 100, 2))) for n in names}


def test_the_ships_family_is_the_one_of_the_thesis(ship):
    """E-21: nine parameters, rank 8 of the 15 coefficients; every formula equal in symbols."""
    v = {n: sympy.Symbol(n) for n in (*SHIP, *KNOWN)}
    truth = ship_truth(v, sympy.Symbol("z_f'"))
    assert ship.is_closed
    assert ship.free == "z_f"
    for n, formula in ship.formulas.items():
        assert sympy.cancel(formula - truth[n]) == 0


def test_z_bar_m_is_invariant_always_and_m_where_it_lies_as_high_as_the_calibration_load(ship):
    assert ship.unchanged == ("zbar_m",)
    (factor,) = ship.unchanged_where["m"]
    zbar_c, zbar_m = sympy.symbols("zbar_c zbar_m")
    assert sympy.solve(factor, zbar_m) == [zbar_c]
    assert ship.direction.entries["m"].subs(zbar_m, zbar_c) == 0
    v = fractions([*SHIP, *KNOWN], seed=1)
    v["zbar_m"] = v["zbar_c"]
    assert ship.at(v, Fraction(7, 3))["m"] == v["m"]
    assert "m is unchanged where" in str(ship)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_all_coefficients_of_three_records_are_the_same_along_the_ships_family(ship, seed):
    """Exactly, in fractions: the outputs know of the coefficients only."""
    v = fractions([*SHIP, *KNOWN], seed)
    moved = v | ship.at(v, Fraction(5, 13))
    assert moved["z_f"] != v["z_f"]
    assert ship_coefficients(moved) == ship_coefficients(v)


def test_the_slopes_at_the_ships_truth_are_those_of_the_digest(ship):
    """d/dz_f at Table 8.2 and 8.3 (k -238.0, A_x -.0618, ..., digest 8.6), to the digits given."""
    at = {"k": 10.38, "A_x": 0.1385, "d": 0.2067, "K_r": -0.5, "K_vdot": 0.1, "K_delta": -0.405}
    at |= {"z_f": -0.028, "m": 0.4, "zbar_m": -0.182, "M": 22.04, "zbar_g": 0.0, "g": 9.82}
    at |= {"zbar_s": -0.2, "m_c": 0.2, "zbar_c": -0.172}
    slopes = {n: float(v.subs(at)) for n, v in ship.direction.entries.items()}
    expected = {"k": -238.0, "A_x": -0.0618, "d": -1.0335, "K_r": 2.5, "K_vdot": -19.45}
    expected |= {"K_delta": 2.025, "m": -0.0952}
    for n, slope in expected.items():
        digits = len(str(slope).split(".")[1])
        assert slopes[n] == pytest.approx(slope, abs=0.51 * 10.0**-digits)


def test_the_invariants_of_the_ship_are_independent_functions_that_do_not_move(ship):
    """Nine parameters, one direction: zbar_m and seven functions are what can be identified."""
    assert len(ship.invariants) == 7
    assert sympy.Symbol("d") / (sympy.Symbol("z_f") + sympy.Symbol("zbar_c")) in ship.invariants
    v = fractions([*SHIP, *KNOWN], seed=4)
    moved = v | ship.at(v, Fraction(3, 11))

    def value(invariant, at):
        return invariant.subs(
            {n: sympy.Rational(x.numerator, x.denominator) for n, x in at.items()}
        )

    assert all(value(i, v) == value(i, moved) for i in ship.invariants)
    jacobian = sympy.Matrix([*ship.invariants]).jacobian(sympy.symbols(SHIP))
    assert value(jacobian, v).rank() == 7


@pytest.mark.parametrize("free", ["k", "d", "m"])
def test_the_ships_direction_can_follow_any_parameter_that_moves(ship, free):
    """Same curve: the speeds are divided by the new free parameter's speed."""
    other = ship.direction.following(free)
    assert other.entries[free] == 1
    for n, speed in other.entries.items():
        quotient = ship.direction.entries[n] / ship.direction.entries[free]
        assert sympy.cancel(speed - quotient) == 0
    with pytest.raises(IdentifiabilityError, match="does not move 'zbar_m'.*follow one of k, A_x"):
        ship.direction.following("zbar_m")


def direction_of(free, **entries):
    return NullDirection(free, {n: sympy.sympify(v) for n, v in entries.items()})


exponents = st.lists(st.integers(-3, 3).filter(bool), min_size=2, max_size=5)


@settings(deadline=None, max_examples=30)
@given(exponents, st.integers(0, 10**6))
def test_a_scaling_symmetry_comes_out_as_a_scaling_with_monomial_invariants(weights, seed):
    """theta_i -> lam^w_i theta_i: v_i = (w_i / w_0) theta_i / theta_0."""
    names = [f"t{i}" for i in range(len(weights))]
    symbols = [sympy.Symbol(n) for n in names]
    speeds = [
        sympy.Rational(w, weights[0]) * s / symbols[0]
        for w, s in zip(weights, symbols, strict=True)
    ]
    found = family(NullDirection("t0", dict(zip(names, speeds, strict=True))))
    common = np.gcd.reduce(weights) * np.sign(weights[0])
    assert list(found.weights.values()) == [int(w // common) for w in weights]
    assert len(found.invariants) == len(weights) - 1
    for invariant in found.invariants:
        powers = sympy.factor(invariant).as_powers_dict()
        assert all(power.is_integer for power in powers.values())
        assert sum(powers[s] * w for s, w in zip(symbols, weights, strict=True)) == 0
    rng = np.random.default_rng(seed)
    values = dict(zip(names, rng.uniform(0.5, 2.0, len(names)), strict=True))
    lam = 1.25
    moved = found.at(values, values["t0"] * lam ** float(weights[0]))
    for n, w in zip(names, weights, strict=True):
        assert moved[n] == pytest.approx(values[n] * lam**w, rel=1e-12)


def test_a_mass_damper_spring_without_a_known_force_tells_ratios():
    """m x'' + d x' + k x = w: d/m and k/m; the family scales all three."""
    null_at = null_of(lambda v: [v["d"] / v["m"], v["k"] / v["m"]], ["m", "d", "k"], [], ["m"])
    (direction,) = null_directions(null_at, ["m", "d", "k"], ["m"], ["m", "d", "k"])
    found = family(direction)
    m, d, k = sympy.symbols("m d k")
    assert set(found.invariants) == {d / m, k / m}
    assert "m' = m*lam, d' = d*lam, k' = k*lam" in str(found)
    assert found.at({"m": 2, "d": 3, "k": 5}, 4) == {"m": 4, "d": 6, "k": 10}


def test_two_free_parameters_give_two_families_each_leaving_the_other_where_it_is():
    """Only k1 k2 k3 is told: moving k1, or moving k2, k3 follows."""
    names = ["k1", "k2", "k3"]
    null_at = null_of(lambda v: [v["k1"] * v["k2"] * v["k3"]], names, [], ["k1", "k2"])
    one, two = (family(d) for d in null_directions(null_at, names, ["k1", "k2"], names))
    assert (one.unchanged, two.unchanged) == (("k2",), ("k1",))
    values = {"k1": 2, "k2": 3, "k3": 5}
    there = two.at(one.at(values, 4), 7)
    assert there == one.at(two.at(values, 7), 4) == {"k1": 4, "k2": 7, "k3": Fraction(15, 14)}


def test_a_rotation_keeps_the_radius_and_the_side_it_is_on():
    """Only a^2 + b^2 is told: db/da = -a/b, linear in b^2 (Bernoulli)."""
    found = family(direction_of("a", a="1", b="-a/b"))
    a, b = sympy.symbols("a b")
    assert found.invariants == (a**2 + b**2,)
    assert found.at({"a": 0.6, "b": -0.8}, 0.0)["b"] == pytest.approx(-1.0)
    with pytest.raises(IdentifiabilityError, match="no real value where a is 2.*stay closer"):
        found.at({"a": 0.6, "b": -0.8}, 2)


def test_a_shift_of_time_scales_an_amplitude_exponentially():
    """y = A exp(k (t - t0)): A' = A exp(k (t0' - t0)), invariant A exp(-k t0)."""
    found = family(direction_of("t0", t0="1", A="k*A", k="0"))
    A, k, t0 = sympy.symbols("A k t0")
    assert found.invariants == (A * sympy.exp(-k * t0),)
    moved = found.at({"A": 2.0, "k": 0.5, "t0": 1.0}, 3.0)
    assert moved == pytest.approx({"t0": 3.0, "A": 2.0 * np.exp(1.0), "k": 0.5})


def test_another_parameter_is_followed_where_only_that_gives_closed_forms():
    """dy/dx = 1 / (x + y) is not linear in y; dx/dy = x + y is linear in x."""
    found = family(direction_of("x", x="1", y="1/(x + y)"))
    assert (found.free, found.is_closed) == ("y", True)
    x, y = sympy.symbols("x y")
    (invariant,) = found.invariants
    gradient = sympy.diff(invariant, x) * (x + y) + sympy.diff(invariant, y)
    assert sympy.simplify(gradient) == 0


def test_a_family_that_does_not_integrate_says_so_and_gives_the_direction():
    """dx/dz = x^2 + z is Riccati's equation: Airy functions."""
    found = family(direction_of("z", z="1", x="x**2 + z", y="y/z", c="0"))
    assert not found.is_closed
    assert found.unsolved == ("x",)
    assert set(found.formulas) == {"z", "y"}
    assert "x moves, too, without a closed form: d x / d z = x**2 + z" in str(found)
    assert found.unchanged == ("c",)
    with pytest.raises(IdentifiabilityError, match="no closed form for x.*follow its direction"):
        found.at({"x": 1, "y": 1, "z": 1, "c": 1}, 2)


def test_an_entry_that_was_not_found_is_said_and_the_others_are_integrated():
    found = family(NullDirection("k", {"k": sympy.Integer(1), "m": None, "n": sympy.Integer(2)}))
    assert found.unsolved == ("m",)
    assert str(found.formulas["n"]) == "n - 2*(k - k')"
    assert "m moves, too, without a closed form: not found" in str(found)


def test_a_speed_with_an_unknown_initial_state_in_it_is_not_integrated():
    """The state may move along, and how is not told by the parameters' direction."""
    k, m, x0 = sympy.symbols("k m x0")
    entries = {"k": sympy.Integer(1), "m": m * x0 / k}
    assert family(NullDirection("k", entries)).is_closed
    assert family(NullDirection("k", entries, initial_states=("x0",))).unsolved == ("m",)


def test_a_parameter_alone_is_free():
    found = family(direction_of("b", b="1", a="0"))
    assert found.invariants == ()
    assert "the outputs do not depend on it" in str(found)
    assert found.at({"a": 1, "b": 2}, 5) == {"a": 1, "b": 5}


def test_a_name_that_means_something_else_to_sympy_is_a_symbol_like_others():
    """Parameters called E, I, lam or beta."""
    E, lam = sympy.Symbol("E"), sympy.Symbol("lam")
    found = family(NullDirection("E", {"E": sympy.Integer(1), "lam": lam / E, "I": -1 / E**2}))
    assert found.at({"E": 1, "lam": 2, "I": 3}, 2) == {"E": 2, "lam": 4, "I": Fraction(5, 2)}
    scaling = family(NullDirection("E", {"E": sympy.Integer(1), "lam": lam / E}))
    assert "lam' = lam*scale" in str(scaling)


def test_values_that_are_missing_are_named(ship):
    with pytest.raises(IdentifiabilityError, match="needs a value of .*zbar_c.*; add it"):
        ship.at(dict.fromkeys(SHIP, 1), 2)


def test_a_basis_that_is_not_normalised_is_refused():
    def null_at(values, p):
        return np.array([[2, 1]])

    with pytest.raises(IdentifiabilityError, match="normalise it"):
        null_directions(null_at, ["a", "b"], ["a"], ["a", "b"])
    with pytest.raises(IdentifiabilityError, match="divide the direction by it"):
        NullDirection("a", {"a": sympy.Integer(2)})


z, t, a, b = sympy.symbols("z t a b")


@pytest.mark.parametrize(
    "speed",
    [
        t / z,
        -t / (2 * z),
        t / (z + a) - t / (z + b) + b,
        a * t / z + z**2,
        a * t + b * z**2,
        z * t,
        t**2 / (z + a),
        a * t + b * t**3,
        b / (z + a) + 1 / z**2,
        1 - a * t / (2 * (a * z + b)),
    ],
)
def test_a_scalar_flow_starts_where_it_is_moves_as_it_should_and_keeps_its_constant(speed):
    flow = integrate_scalar(speed, t, z)
    new = sympy.Symbol("z'")
    formula, constant = flow.moved_to(new), flow.constant
    at = {a: 1.3, b: 0.7, z: 1.1, t: 0.8}
    assert float(formula.subs({**at, new: 1.1})) == pytest.approx(0.8, rel=1e-13)
    slope = sympy.diff(formula, new).subs({**at, new: 1.25})
    there = {**at, z: 1.25, t: formula.subs({**at, new: 1.25})}
    assert float(slope) == pytest.approx(float(speed.subs(there)), rel=1e-12)
    assert float(constant.subs(there)) == pytest.approx(float(constant.subs(at)), rel=1e-12)


@pytest.mark.parametrize("speed", [t**2 + 1, t / (z**2 + 1), sympy.sin(t), t**3 + t**2 + 1 / z])
def test_a_scalar_flow_without_a_simple_solution_is_left_alone(speed):
    assert integrate_scalar(speed, t, z) is None


def test_a_rational_functions_integral_has_it_as_its_derivative():
    function = (z**4 + a) / ((z + b) ** 3 * (2 * z - a))
    rational, logs = rational_integral(function, z)
    derivative = sympy.diff(rational, z) + sum(c * sympy.diff(base, z) / base for base, c in logs)
    assert sympy.cancel(derivative - function) == 0
