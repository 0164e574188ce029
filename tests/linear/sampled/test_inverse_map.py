"""From coefficients back to physical parameters: numbers, derivatives, closed forms, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from casid.errors import IdentifiabilityError, ModelError, SolveError
from casid.linear.sampled.difference_equation import difference_equation
from casid.linear.sampled.discretisation import METHODS
from casid.linear.sampled.inverse_map import closed_form, continuous_form, invert
from tests.support.linear_models import NOMINAL, SHIP, indirect, ship, spring_chain

LOADED = NOMINAL | {"m": 0.2}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("T", [0.001, 0.01, 0.1])
def test_the_pendulums_parameters_come_back_from_its_coefficients(method, T):
    """I_x, k, d from the model's starts; rounding is multiplied by 1/(w T)^2."""
    e = difference_equation(indirect(), "gyro", T, method=method)
    found, _ = invert(e, e.theta(NOMINAL), {}, ("I_x", "k", "d"))
    np.testing.assert_allclose(found, [0.1385, 10.39, 0.1067], rtol=max(1e-10, 1e-13 / T**2))


@pytest.mark.parametrize("method", METHODS)
def test_the_load_comes_back_although_the_model_has_none(method):
    """m = 0 hides z_m at the start: the iteration is started elsewhere."""
    e = difference_equation(indirect(), "gyro", 0.01, method=method)
    found, _ = invert(e, e.theta(LOADED), NOMINAL, ("m", "z_m"))
    np.testing.assert_allclose(found, [0.2, -0.274], rtol=1e-8)


@pytest.mark.parametrize("start", [None, {"m": 0.1, "z_m": -0.2}])
@pytest.mark.parametrize("T", [0.001, 0.01, 0.1])
@pytest.mark.parametrize("method", METHODS)
def test_no_load_hides_its_place(method, T, start):
    """m = 0 comes back as rounding, below which z_m acts on nothing; m alone follows."""
    e = difference_equation(indirect(), "gyro", T, method=method)
    theta = e.theta(NOMINAL | {"m": 0.0, "z_m": -0.274})
    with pytest.raises(IdentifiabilityError, match=r"\(\+1 z_m\) .* declare one of these known"):
        invert(e, theta, NOMINAL, ("m", "z_m"), start)
    found, _ = invert(e, theta, NOMINAL | {"z_m": -0.274}, ("m",), start)
    assert found == pytest.approx([0.0], abs=1e-8)  # rounding, times 1/(w T)^2
    # A load of 10 mg moves theta by 1e-6 of itself: rounding leaves six digits of its place.
    light = e.theta(NOMINAL | {"m": 1e-5, "z_m": -0.274})
    np.testing.assert_allclose(invert(e, light, NOMINAL, ("m", "z_m"), start)[0][1], -0.274, 1e-6)


def test_parameters_that_no_start_separates_are_named_whatever_stops_the_iteration():
    """I_x, m, z_m act through S and I_2 alone."""
    e = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(IdentifiabilityError, match="do not determine I_x, m, z_m .* declare one"):
        invert(e, e.theta(LOADED), NOMINAL, ("I_x", "m", "z_m"), {"m": 0.1, "z_m": -0.2})
    found, _ = invert(e, e.theta(LOADED), NOMINAL, ("m", "z_m"))
    np.testing.assert_allclose(found, [0.2, -0.274], rtol=1e-8)


@settings(max_examples=40)
@given(
    k=st.floats(3.0, 40.0), d=st.floats(0.01, 2.0), I_x=st.floats(0.1, 1.0),
    T=st.floats(1e-3, 0.05), method=st.sampled_from(("bilinear", "forward", "backward")),
)  # fmt: skip
def test_round_trips(k, d, I_x, T, method):
    e = difference_equation(indirect(), "gyro", T, method=method)
    theta = e.theta({"k": k, "d": d, "I_x": I_x})
    assume(np.abs(theta).max() < 1e3)
    found, _ = invert(e, theta, {}, ("k", "d", "I_x"))
    np.testing.assert_allclose(e.theta(dict(zip(("k", "d", "I_x"), found, strict=True))), theta)
    # w T > 0.002, so rounding of 1e-16 in theta is at most 1e-10 in k, and more in a small d.
    np.testing.assert_allclose(found, [k, d, I_x], rtol=1e-8)


def test_7_37_agrees_with_the_numeric_inverse_off_the_model_set_too():
    """Estimated coefficients are not exact: formula and iteration agree anywhere."""
    e = difference_equation(indirect(), "gyro", 0.01)
    theta = e.theta(NOMINAL) + [1e-5, -2e-5, 3e-5]
    alpha, beta = e.continuous(theta)
    S = 22.04 * -0.018
    beta1 = beta["accel"][1]
    wanted = [
        -S / beta1 - 22.04 * -0.018 * (-0.018 + 0.218),
        -S * alpha[2] / beta1,
        -S * alpha[1] / beta1,
    ]
    found, _ = invert(e, theta, NOMINAL, ("I_x", "k", "d"))
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_the_derivative_is_that_of_the_inverse(method):
    """Against central differences of the inverse itself; foh has four coefficients for three."""
    e = difference_equation(indirect(), "gyro", 0.05, method=method)
    theta = e.theta(NOMINAL) + 1e-5 * np.arange(1, len(e.coefficients) + 1)
    free = ("I_x", "k", "d")
    _, jacobian = invert(e, theta, NOMINAL, free)
    assert jacobian.shape == (3, len(theta))
    h = 1e-7
    for i in range(len(theta)):
        step = h * np.eye(len(theta))[i]
        up, _ = invert(e, theta + step, NOMINAL, free)
        down, _ = invert(e, theta - step, NOMINAL, free)
        np.testing.assert_allclose(
            jacobian[:, i], (up - down) / (2 * h), rtol=1e-4, atol=1e-4 * np.abs(jacobian).max()
        )


def test_more_coefficients_than_parameters_are_weighted():
    """With the third coefficient alone trusted, that one is met and the others are not."""
    e = difference_equation(indirect(), "gyro", 0.01)
    theta = e.theta(NOMINAL) + [-1e-3, 0.0, 1e-3]
    found, _ = invert(e, theta, NOMINAL, ("I_x",), weight=np.array([[0.0, 0.0, 1.0]]))
    at = e.theta(NOMINAL | {"I_x": float(found[0])})
    assert at[2] == pytest.approx(theta[2], rel=1e-9)
    assert abs(at[0] - theta[0]) > 1e-4


def test_bounds_hold_and_have_no_derivative():
    e = difference_equation(indirect(), "gyro", 0.01)
    theta = e.theta(NOMINAL)
    found, jacobian = invert(e, theta, NOMINAL, ("I_x", "k", "d"), bounds={"d": (0.12, 1.0)})
    assert found[2] == 0.12
    np.testing.assert_array_equal(jacobian[2], 0.0)
    assert np.isfinite(found).all()


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000))
def test_the_ships_parameters_come_back(seed):
    """Five coefficients, five parameters (z_f, K_vdot, k known)."""
    rng = np.random.default_rng(seed)
    values = {n: v * rng.uniform(0.7, 1.3) for n, v in SHIP.items()}
    e = difference_equation(ship().eliminate("vdot", using="accel"), "gyro", 0.02)
    free = ("A_x", "d", "K_r", "K_delta", "K_vdot")
    A_2 = values["A_x"] + 22.04 * values["z_f"] * 0.2 - values["K_vdot"] * (values["z_f"] - 0.2)
    assume(A_2 > 0.01)
    known = {n: v for n, v in values.items() if n not in free}
    found, _ = invert(e, e.theta(values), known, free, start=SHIP)
    np.testing.assert_allclose(found, [values[n] for n in free], rtol=1e-6)


# -- closed forms ------------------------------------------------------------------------------


def symbols(*names):
    return [sympy.Symbol(n) for n in names]


def test_sympy_finds_7_37():
    form = closed_form(difference_equation(indirect(), "gyro", 0.01), ("d", "k", "I_x"))
    mass, z_g, m, z_m, z_s, I_xm = symbols("M", "z_g", "m", "z_m", "z_s", "I_xm")
    alpha1, alpha2, beta1 = symbols("alpha1", "alpha2", "beta1[accel]")
    S = mass * z_g + m * z_m
    wanted = {
        "d": -S * alpha1 / beta1,
        "k": -S * alpha2 / beta1,
        "I_x": -S / beta1 - (mass * z_g * (z_g - z_s) + I_xm + m * z_m * (z_m - z_s)),
    }
    for name, expression in wanted.items():
        assert sympy.simplify(form.expressions[name] - expression) == 0


@pytest.mark.parametrize(("known", "alpha"), [("d", "alpha1"), ("k", "alpha2")])
def test_sympy_finds_7_38_with_the_inertia_of_the_load(known, alpha):
    """(7.38) holds for I_xm = 0; in general I_x is replaced by I_x + I_xm (erratum E-12).

    With k known instead of d, (alpha1, d) is replaced by (alpha2, k).
    """
    e = difference_equation(indirect(), "gyro", 0.01)
    form = closed_form(e, ("m", "z_m"), using=(alpha, "beta1[accel]"))
    mass, z_g, z_s, I_x, I_xm = symbols("M", "z_g", "z_s", "I_x", "I_xm")
    a, beta1, damping = symbols(alpha, "beta1[accel]", known)

    def printed(inertia):
        w = a * (inertia + mass * z_g**2) + damping * (beta1 * z_s - 1)
        top = beta1 * damping + a * mass * z_g
        return {"m": -(top**2) / (a * w), "z_m": w / top}

    for name, expression in printed(I_x + I_xm).items():
        assert sympy.simplify(form.expressions[name] - expression) == 0
    assert sympy.simplify(form.expressions["m"] - printed(I_x)["m"]) != 0
    assert form.using == (alpha, "beta1[accel]")


def test_a_closed_form_evaluates_to_the_numeric_inverse():
    e = difference_equation(indirect(), "gyro", 0.01)
    form = closed_form(e, ("m", "z_m"), using=("alpha1", "beta1[accel]"))
    alpha, beta = e.continuous(e.theta(LOADED))
    numbers = dict(e.known) | LOADED | {"alpha1": alpha[1], "beta1[accel]": beta["accel"][1]}
    for name, wanted in (("m", 0.2), ("z_m", -0.274)):
        value = form.expressions[name].subs({sympy.Symbol(n): v for n, v in numbers.items()})
        assert float(value) == pytest.approx(wanted, rel=1e-8)


def at_arrays(expressions, values):
    """Sympy expressions at arrays of the values of their symbols."""
    symbols = sorted({s for e in expressions.values() for s in e.free_symbols}, key=str)
    function = sympy.lambdify(symbols, list(expressions.values()), "numpy")
    found = function(*(np.asarray(values[str(s)]) for s in symbols))
    return dict(zip(expressions, found, strict=True))


def test_closed_forms_take_whole_samples():
    """theta -> alpha, beta (7.36) -> m, z_m (7.38), for many coefficient vectors in one call."""
    e = difference_equation(indirect(), "gyro", 0.01)
    rng = np.random.default_rng(4)
    masses, places = rng.uniform(0.1, 0.5, 200), rng.uniform(-0.4, -0.2, 200)
    thetas = [e.theta(NOMINAL | {"m": m, "z_m": z}) for m, z in zip(masses, places, strict=True)]
    named = dict(zip(e.coefficients, np.array(thetas).T, strict=True)) | {"T": 0.01}
    continuous = at_arrays(continuous_form(e), named)
    form = closed_form(e, ("m", "z_m"), using=("alpha1", "beta1[accel]"))
    found = at_arrays(form.expressions, {**e.known, **NOMINAL, **continuous})
    np.testing.assert_allclose(found["m"], masses, rtol=1e-7)
    np.testing.assert_allclose(found["z_m"], places, rtol=1e-7)


@pytest.mark.slow
@settings(max_examples=30)
@given(m=st.floats(0.02, 3.0), z_m=st.floats(0.02, 0.5), sign=st.sampled_from([-1, 1]))
def test_a_load_above_or_below_is_found_from_the_same_start(m, z_m, sign):
    """m and z_m enter as m z_m and m z_m^2: between the signs of z_m the map is singular."""
    e = difference_equation(indirect(), "gyro", 0.01)
    values = NOMINAL | {"m": m, "z_m": sign * z_m}
    assume(abs(22.04 * -0.018 + m * sign * z_m) > 0.05)
    assume(0.1385 + 22.04 * 0.0036 * -1 + m * sign * z_m * (sign * z_m + 0.218) > 0.01)
    found, _ = invert(e, e.theta(values), NOMINAL, ("m", "z_m"))
    np.testing.assert_allclose(found, [m, sign * z_m], rtol=1e-6)


def test_the_ship_has_a_closed_form_too():
    """Five equations of which K_r, K_delta and the rest follow in turn."""
    e = difference_equation(ship().eliminate("vdot", using="accel"), "gyro", 0.02)
    form = closed_form(e, ("d", "A_x", "K_r", "K_delta"))
    theta = e.theta(SHIP)
    alpha, beta = e.continuous(theta)
    numbers = dict(e.known) | SHIP | {f"alpha{k}": alpha[k] for k in (1, 2)}
    numbers |= {f"beta1[{u}]": b[1] for u, b in beta.items()}
    for name in ("d", "A_x", "K_r", "K_delta"):
        value = form.expressions[name].subs({sympy.Symbol(n): v for n, v in numbers.items()})
        assert float(value) == pytest.approx(SHIP[name], rel=1e-8)


def test_no_closed_form_is_said():
    e = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(IdentifiabilityError, match="do not follow in closed form .* known"):
        closed_form(e, ("I_x", "I_xm"))
    with pytest.raises(ModelError, match="no coefficient 'alpha'; did you mean"):
        closed_form(e, ("I_x",), using=("alpha",))


# -- refusals ----------------------------------------------------------------------------------


def test_more_parameters_than_coefficients_are_refused_before_any_iteration():
    e = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(IdentifiabilityError, match="4 parameters .* at least 1 known"):
        invert(e, e.theta(NOMINAL), NOMINAL, ("I_x", "k", "d", "m"))


def test_parameters_that_only_appear_in_a_sum_are_named():
    """I_x and I_xm: the direction I_x up, I_xm down moves nothing (Table 7.1, exception (a))."""
    e = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(IdentifiabilityError, match=r"do not determine I_x, I_xm .*declare one"):
        invert(e, e.theta(NOMINAL), NOMINAL | {"I_xm": 0.01}, ("I_x", "I_xm"))


def test_a_parameter_without_effect_is_named():
    """Gravity leaves the indirect model."""
    e = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(IdentifiabilityError, match="do not determine g"):
        invert(e, e.theta(NOMINAL), NOMINAL, ("g",))


def test_coefficients_that_no_parameters_give_are_refused():
    """An integrating spring: two coefficients that must multiply to something positive."""
    from casid.model.model import Model

    m = Model("squared")
    x, u, c = m.state("x", "1"), m.input("u", "1"), m.parameter("c", "1")
    m.derivative(x, u - (1 + c**2) * x)
    m.output("x", x, "1")
    e = difference_equation(m, "x", 0.1)
    theta = e.theta({"c": 0.5})
    with pytest.raises(SolveError, match="no c give these coefficients .* start nearer"):
        invert(e, theta * 0.0 - 2.0, {}, ("c",))


def test_wrong_names_and_lengths_are_refused():
    e = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(ModelError, match="did you mean 'I_x'"):
        invert(e, e.theta(NOMINAL), NOMINAL, ("I_X",))
    with pytest.raises(ModelError, match="2 coefficients given for 3"):
        invert(e, [1.0, 2.0], NOMINAL, ("I_x",))
    with pytest.raises(ModelError, match="no value for k"):
        invert(e, e.theta(NOMINAL), {"d": 0.1}, ("I_x",))


def test_bad_numbers_are_named():
    e = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(ModelError, match="a2 is nan; look for gaps"):
        invert(e, [1.0, np.nan, 0.1], NOMINAL, ("I_x",))
    with pytest.raises(ModelError, match="lower bound of I_x .* exchange"):
        invert(e, e.theta(NOMINAL), NOMINAL, ("I_x",), bounds={"I_x": (1.0, 0.1)})


def test_nothing_free_is_nothing_found():
    e = difference_equation(indirect(), "gyro", 0.01)
    found, jacobian = invert(e, e.theta(NOMINAL), NOMINAL, ())
    assert (found.shape, jacobian.shape) == ((0,), (0, 3))


def test_a_chain_of_two_masses_comes_back():
    """Six parameters from seven coefficients; the scale is fixed by the known force."""
    e = difference_equation(spring_chain(2), "q", 0.1)
    true = {"k0": 4.0, "k1": 6.0, "d0": 0.3, "d1": 0.2, "m0": 2.0, "m1": 1.5}
    start = {n: 1.1 * v for n, v in true.items()}
    found, jacobian = invert(e, e.theta(true), {}, tuple(true), start=start)
    np.testing.assert_allclose(found, list(true.values()), rtol=1e-7)
    assert jacobian.shape == (6, len(e.coefficients))


def test_a_parameter_may_stand_alone_but_not_twice():
    e = difference_equation(indirect(), "gyro", 0.01)
    theta = e.theta(NOMINAL)
    with pytest.raises(ModelError, match="parameter 'I_x' is named twice; name it once"):
        invert(e, theta, NOMINAL, ["I_x", "I_x"])
    with pytest.raises(ModelError, match="'I_x' is named twice"):
        closed_form(e, ["I_x", "I_x"])
    one, slope = invert(e, theta, NOMINAL, "I_x")
    listed, same = invert(e, theta, NOMINAL, ["I_x"])
    assert one == pytest.approx([0.1385])
    np.testing.assert_array_equal(one, listed)
    np.testing.assert_array_equal(slope, same)
    assert closed_form(e, "I_x").expressions == closed_form(e, ["I_x"]).expressions


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            {"start": {"dd": 0.1}},
            "a start is given for 'dd', which is no parameter; did you mean 'd'",
        ),
        ({"bounds": {"I_xx": (0.0, 1.0)}}, "a bound is given for 'I_xx', .* mean 'I_x'"),
    ],
)
def test_starts_and_bounds_of_no_parameter_are_refused(given, words):
    """Ignoring a misspelt bound would let the iteration leave it."""
    e = difference_equation(indirect(), "gyro", 0.01)
    with pytest.raises(ModelError, match=words):
        invert(e, e.theta(NOMINAL), NOMINAL, ("I_x", "d"), **given)
    mended = {"start": {"d": 0.2}, "bounds": {"I_x": (0.01, 1.0)}}
    found, _ = invert(e, e.theta(NOMINAL), NOMINAL, ("I_x", "d"), **mended)
    np.testing.assert_allclose(found, [0.1385, 0.1067], rtol=1e-8)
