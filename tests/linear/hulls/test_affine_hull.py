"""Linear constraints found from g are those that were derived by hand, and nothing else."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from casid.errors import IdentifiabilityError, ModelError
from casid.linear.hulls.affine_hull import affine_hull, image_dimension, symbolic_hull
from casid.linear.sampled.difference_equation import difference_equation
from casid.model.model import Model
from problems.pendulum import direct_model

# Table 7.2 of Linder (2017) with the load on; T is a parameter here, so that it stays a letter.
VALUES = {
    "M": 22.04, "z_g": -0.018, "k": 10.39, "I_x": 0.1385, "d": 0.1067, "I_xm": 0.0, "m": 0.2,
    "z_m": -0.274, "z_s": -0.218, "T": 0.01,
}  # fmt: skip
NAMES = tuple(VALUES)
GEOMETRY = ("I_x", "M", "z_g", "I_xm", "m", "z_m")
S = VALUES["M"] * VALUES["z_g"] + VALUES["m"] * VALUES["z_m"]
I_2 = (
    VALUES["I_x"]
    + VALUES["M"] * VALUES["z_g"] * (VALUES["z_g"] - VALUES["z_s"])
    + VALUES["m"] * VALUES["z_m"] * (VALUES["z_m"] - VALUES["z_s"])
)


def pendulum(*, unreduced: bool = False) -> ca.Function:
    """(7.39): the bilinear difference equation's coefficients from the physical parameters."""
    p = ca.SX.sym("p", len(NAMES))
    M, z_g, k, I_x, d, I_xm, m, z_m, z_s, T = ca.vertsplit(p)
    S = M * z_g + m * z_m
    I_2 = I_x + M * z_g * (z_g - z_s) + I_xm + m * z_m * (z_m - z_s)
    den = 4 * I_2 + 2 * d * T + k * T**2
    a1, a2, b0 = (2 * k * T**2 - 8 * I_2) / den, (4 * I_2 - 2 * d * T + k * T**2) / den, -2 * T * S
    theta = [a1, a2, b0 / den, 0, -b0 / den] if unreduced else [a1, a2, b0 / den]
    return ca.Function("g", [p], [ca.vertcat(*theta)])


def by_hand(equation: str) -> tuple[list[float], float]:
    """Rows of Linder (2017), section 7.3.4, as printed."""
    k, d, T = VALUES["k"], VALUES["d"], VALUES["T"]
    beta1 = -S / I_2
    return {
        "7.41": ([-S / k, -S / k, -2 * T], S / k),
        "7.43": ([0.0, 1.0, -2 * d / S], 1.0),
        "7.45": ([beta1 * T, -beta1 * T, 8.0], beta1 * T),
        "7.47": ([d / k, d / k + T, 0.0], T - d / k),
    }[equation]


PAIRS = [
    ("7.41", ("I_x", "d")),
    ("7.43", ("I_x", "k")),
    ("7.45", ("k", "d")),
    *[
        ("7.47", (a, b))
        for i, a in enumerate(GEOMETRY)
        for b in GEOMETRY[i + 1 :]
        if {a, b} != {"I_x", "I_xm"}
    ],
]


@pytest.mark.parametrize(("equation", "free"), PAIRS)
def test_the_constraint_found_is_the_one_derived_by_hand(equation, free):
    """One row each; scaled alike, both agree to the rounding of a few operations."""
    hull = affine_hull(pendulum(), NAMES, VALUES, free)
    row, value = by_hand(equation)
    largest = max(row, key=abs)
    assert hull.rank == 1
    np.testing.assert_allclose(hull.B[0], np.array(row) / largest, rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(hull.b[0], value / largest, rtol=1e-13)
    assert hull.residual < 1e-14
    assert hull.nonlinear == 0


@pytest.mark.parametrize(("equation", "free"), PAIRS[:4])
def test_the_proof_has_the_same_constraint_in_letters(equation, free):
    proof = symbolic_hull(pendulum(), NAMES, {}, free)
    B, b = proof.numeric(VALUES)
    row, value = by_hand(equation)
    largest = max(row, key=abs)
    np.testing.assert_allclose(B, [np.array(row) / largest], rtol=1e-13, atol=1e-16)
    np.testing.assert_allclose(b, [value / largest], rtol=1e-13)
    assert not set(proof.known) & set(free)


def test_the_proof_of_7_47_in_letters():
    """[d/k, d/k + T, 0] theta = T - d/k, divided by its first entry."""
    import sympy

    d, k, T = sympy.symbols("d k T")
    proof = symbolic_hull(pendulum(), NAMES, {}, ("m", "z_m"), coefficients=("a1", "a2", "b0"))
    assert sympy.simplify(proof.B - sympy.Matrix([[1, 1 + T * k / d, 0]])) == sympy.zeros(1, 3)
    assert sympy.simplify(proof.b[0] - (T * k / d - 1)) == 0
    assert proof.known == ("k", "d", "T")
    assert "a1 + (" in str(proof)


def test_the_zero_pattern_of_the_numerator_is_found():
    """Unreduced, b0 + b1 q^-1 + b2 q^-2 is b0 (1 - q^-2) whatever is free, (7.33)."""
    free = ("I_x", "k", "d", "M", "m")
    hull = affine_hull(
        pendulum(unreduced=True), NAMES, VALUES, free, coefficients=("a1", "a2", "b0", "b1", "b2")
    )
    np.testing.assert_array_equal(hull.B, [[0, 0, 1, 0, 1], [0, 0, 0, 1, 0]])
    np.testing.assert_array_equal(hull.b, [0, 0])
    assert hull.relations() == ("b0 + b2 = 0", "b1 = 0")
    proof = symbolic_hull(pendulum(unreduced=True), NAMES, {}, free)
    np.testing.assert_array_equal(proof.numeric(VALUES)[0], hull.B)


def test_three_identifiable_unknowns_leave_no_constraint():
    hull = affine_hull(pendulum(), NAMES, VALUES, ("I_x", "k", "d"))
    assert (hull.rank, hull.dimension, hull.image_dimension) == (0, 3, 3)
    assert hull.B.shape == (0, 3)
    proof = symbolic_hull(pendulum(), NAMES, {}, ("I_x", "k", "d"))
    assert proof.numeric(VALUES)[0].shape == (0, 3)


def test_with_nothing_free_the_hull_is_the_point():
    hull = affine_hull(pendulum(), NAMES, VALUES, ())
    np.testing.assert_allclose(hull.B, np.eye(3))
    np.testing.assert_allclose(hull.b, [-1.966581, 0.983068, 0.035825], atol=5e-7)  # digest R.1, 4
    assert hull.image_dimension == 0


def test_a_parameter_that_enters_squared_leaves_a_nonlinear_constraint():
    """z_g moves theta on a curve that spans a plane: one linear constraint, one that is not."""
    hull = affine_hull(pendulum(), NAMES, VALUES, ("z_g",))
    assert (hull.rank, hull.dimension, hull.image_dimension, hull.nonlinear) == (1, 2, 1, 1)
    assert symbolic_hull(pendulum(), NAMES, {}, ("z_g",)).dimension == 2
    assert "1 nonlinear remain" in str(hull)


def test_unknowns_that_cannot_be_told_apart_lower_the_dimension_of_the_image():
    """Table 7.1 (a): I_x and I_xm enter as their sum."""
    assert image_dimension(pendulum(), NAMES, VALUES, ("I_x", "I_xm")) == 1
    assert image_dimension(pendulum(), NAMES, VALUES, ("I_x", "M", "m")) == 2  # Table 7.1 (b)


def test_the_constraint_does_not_depend_on_where_the_parameters_are_drawn():
    near = {"m": (0.19, 0.21), "z_m": (-0.28, -0.27)}
    wide = affine_hull(pendulum(), NAMES, VALUES, ("m", "z_m"))
    narrow = affine_hull(pendulum(), NAMES, VALUES, ("m", "z_m"), ranges=near, seed=3)
    np.testing.assert_allclose(narrow.B, wide.B, rtol=1e-13)
    half = affine_hull(pendulum(), NAMES, VALUES, ("m",), ranges={"m": (0.0, np.inf)})
    assert half.rank == 2


def test_exponentials_are_no_obstacle_to_the_numerical_hull():
    """Exact hold of a lag: a = -exp(-T/tau), b = K (1 + a). With K known, K a - b = -K."""
    p = ca.SX.sym("p", 2)
    a = -ca.exp(-0.1 / p[1])
    g = ca.Function("g", [p], [ca.vertcat(a, p[0] * (1 + a))])
    hull = affine_hull(g, ("K", "tau"), {"K": 0.5, "tau": 0.1}, ("tau",))
    np.testing.assert_allclose(hull.B, [[-0.5, 1.0]], atol=1e-12)
    np.testing.assert_allclose(hull.b, [0.5], rtol=1e-12)
    assert not hull.is_exact
    with pytest.raises(ModelError, match="not rational|exact algebra"):
        symbolic_hull(g, ("K", "tau"), {}, ("tau",))


def test_the_proof_takes_known_values_as_the_decimals_that_were_written():
    import sympy

    proof = symbolic_hull(pendulum(), NAMES, {"T": 0.01, "d": 0.1067}, ("m", "z_m"))
    k = sympy.Symbol("k")
    assert sympy.simplify(proof.B[1] - (1 + sympy.Rational(100, 1067) * k)) == 0


@pytest.mark.parametrize("seed", range(12))
def test_the_hull_of_an_affine_image_of_a_curved_surface_is_the_affine_map(seed):
    """theta = A h(x) + c with (K) functions h that no linear relation binds: n - K constraints.

    A has scales over twelve orders of magnitude; B A = 0 and B c = b up to rounding of their terms.
    """
    rng = np.random.default_rng(seed)
    x, n = ca.SX.sym("x", 2), int(rng.integers(4, 9))
    h = ca.vertcat(x[0] / (1 + x[0]), x[1] ** 2, x[0] * x[1] / (2 + x[1]))[
        : int(rng.integers(1, 4))
    ]
    scale = 10.0 ** rng.uniform(-6, 6, n)
    A = scale[:, None] * rng.standard_normal((n, h.numel()))
    c = scale * rng.standard_normal(n)
    hull = affine_hull(ca.Function("g", [x], [A @ h + c]), ("x", "y"), {}, ("x", "y"))
    assert hull.rank == n - h.numel()
    assert hull.image_dimension == min(2, h.numel())
    for image, right in ((A, 0.0 * hull.b[:, None]), (c[:, None], hull.b[:, None])):
        terms = np.abs(hull.B) @ np.abs(image) + np.abs(right)
        assert np.max(np.abs(hull.B @ image - right) / terms) < 1e-10


def test_the_constraint_follows_the_units_of_coefficients_and_parameters():
    """Parameters in other units leave B alone; coefficients in other units divide its columns."""
    q = ca.SX.sym("q", len(NAMES))
    unit = np.array([1e3, 1.0, 1e-3, 1e6, 1.0, 1.0, 1e3, 10.0, 10.0, 1.0])
    size = np.array([1e-4, 1.0, 1e5])
    g = ca.Function("g", [q], [size * pendulum()(q / unit)])
    values = dict(zip(NAMES, np.array(list(VALUES.values())) * unit, strict=True))
    own = affine_hull(pendulum(), NAMES, VALUES, ("I_x", "d"))
    other = affine_hull(g, NAMES, values, ("I_x", "d"))
    expected = own.B[0] / size
    np.testing.assert_allclose(other.B[0], expected / expected[0], rtol=1e-12)


# -- on difference equations of models -------------------------------------------------------------


def equation(method="bilinear"):
    model = direct_model().with_unknown("M", "z_g", "m", "z_m", "I_xm", "z_s")
    return difference_equation(model.eliminate("a_y", using="accel"), "gyro", 0.01, method=method)


@pytest.mark.parametrize(("row", "free"), PAIRS)
def test_the_models_own_regression_has_the_constraints_derived_by_hand(row, free):
    found = equation()
    values = {n: v for n, v in VALUES.items() if n != "T"} | {"g": 9.81}
    hull = affine_hull(found.g, found.parameters, values, free, coefficients=found.coefficients)
    expected, value = by_hand(row)
    largest = max(expected, key=abs)
    assert found.coefficients == ("a1", "a2", "b0[accel]")
    # The model divides by I_2 before it is discretised: a few roundings more than (7.39).
    np.testing.assert_allclose(hull.B, [np.array(expected) / largest], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(hull.b, [value / largest], rtol=1e-12)


def test_the_models_own_regression_has_the_constraint_proved():
    import sympy

    found = equation()
    proof = symbolic_hull(found.g, found.parameters, {}, ("m", "z_m"))
    d, k = sympy.symbols("d k")
    expected = sympy.Matrix([[1, 1 + k / (100 * d), 0]])
    assert sympy.simplify(proof.B - expected) == sympy.zeros(1, 3)
    assert sympy.simplify(proof.b[0] - (k / (100 * d) - 1)) == 0


@pytest.mark.parametrize(("method", "rank"), [("forward", 1), ("backward", 1), ("zoh", 0)])
def test_other_discretisations_have_constraints_of_their_own(method, rank):
    """Substitutions keep 7.47's kind of row, d/k known; an exact hold bends it into a surface."""
    found = equation(method)
    values = {n: v for n, v in VALUES.items() if n != "T"} | {"g": 9.81}
    hull = affine_hull(found.g, found.parameters, values, ("m", "z_m"))
    assert (hull.rank, hull.image_dimension, hull.nonlinear) == (rank, 2, 1 - rank)


def chain(n: int) -> Model:
    """n masses in a row, a force on the last one, springs and dampers between them."""
    model = Model("chain")
    x = [model.state(f"x{i}", "m") for i in range(n)]
    v = [model.state(f"v{i}", "m/s") for i in range(n)]
    force = model.input("F", "N")
    k = [model.parameter(f"k{i}", "N/m", start=100.0 + 10 * i) for i in range(n)]
    d = [model.parameter(f"d{i}", "N s/m", start=0.5 + 0.1 * i) for i in range(n)]
    pull = [
        -k[i] * (x[i] - (x[i - 1] if i else 0)) - d[i] * (v[i] - (v[i - 1] if i else 0))
        for i in range(n)
    ]
    for i in range(n):
        after = -pull[i + 1] if i + 1 < n else force
        mass = model.parameter(f"m{i}", "kg", start=1 + 0.2 * i)
        model.derivative(x[i], v[i])
        model.balance(v[i], f"mass {i}", inertia=mass, terms=[pull[i], after])
    model.output("y", v[-1], "m/s")
    return model


@pytest.mark.parametrize(
    ("free", "rank", "image"),
    [(("k0",), 10, 1), (("k0", "d0"), 9, 2), (("k0", "m1"), 8, 2), (("k0", "k1", "k2"), 4, 3)],
)
def test_the_rank_of_a_sixth_order_system_is_the_one_proved(free, rank, image):
    """Eleven coefficients at a tenth of a radian a sample, and the singular values still tell."""
    model = chain(3)
    found = difference_equation(model, "y", 0.01)
    values = {name: q.start for name, q in model.parameters.items()}
    hull = affine_hull(found.g, found.parameters, values, free)
    numbers = {name: v for name, v in values.items() if name not in free}
    assert hull.rank == symbolic_hull(found.g, found.parameters, numbers, free).rank == rank
    assert hull.image_dimension == image
    theta = found.theta(values)
    np.testing.assert_allclose(hull.B @ theta, hull.b, atol=1e-13 * np.abs(theta).max())


def test_a_proof_of_an_exact_hold_is_refused_early():
    found = equation("zoh")
    with pytest.raises(ModelError, match="degree beyond 30.*affine_hull, or discretise with"):
        symbolic_hull(found.g, found.parameters, {}, ("m", "z_m"))


# -- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "free", "ranges", "mend"),
    [
        (VALUES, ("I_X",), {}, "did you mean 'I_x'"),
        ({**VALUES, "kk": 1.0}, ("I_x",), {}, "did you mean 'k'"),
        ({"k": 1.0}, ("I_x",), {}, "no value for the known M, z_g, d.*add it to `values`"),
        (VALUES, ("I_x", "I_x"), {}, "named twice; name it once"),
        (VALUES, ("I_x",), {"k": (0, 1)}, "range is given for 'k', which is not free"),
        (VALUES, ("I_x",), {"I_x": (1, 0)}, "is empty; give \\(low, high\\)"),
        ({**VALUES, "k": np.nan}, ("I_x",), {}, "known value of k is nan; give a number"),
    ],
)
def test_wrong_names_and_values_are_refused_with_the_mend(values, free, ranges, mend):
    with pytest.raises(ModelError, match=mend):
        affine_hull(pendulum(), NAMES, values, free, ranges=ranges)


def test_a_function_of_other_arguments_is_refused():
    with pytest.raises(ModelError, match="must map one vector of the 2 parameters"):
        affine_hull(pendulum(), ("k", "d"), {"k": 1.0, "d": 1.0}, ())
    with pytest.raises(ModelError, match="2 names were given for 3 coefficients"):
        affine_hull(pendulum(), NAMES, VALUES, ("k",), coefficients=("a", "b"))


def test_coefficients_that_are_never_finite_are_refused():
    p = ca.SX.sym("p")
    g = ca.Function("g", [p], [ca.log(-(p**2))])
    with pytest.raises(ModelError, match="give `ranges` of p in which the model makes sense"):
        affine_hull(g, ("p",), {}, ("p",))


def test_a_function_of_two_branches_is_no_analytic_one():
    """|p| - p vanishes on one side only: no constraint may be found from that side alone."""
    p = ca.SX.sym("p")
    g = ca.Function("g", [p], [ca.vertcat(p, ca.fabs(p - 1e3))])
    hull = affine_hull(g, ("p",), {}, ("p",), ranges={"p": (1.0, 900.0)})
    assert hull.relations() == ("theta1 + theta2 = 1000",)
    assert affine_hull(g, ("p",), {}, ("p",), ranges={"p": (1.0, 9e6)}).rank == 0


def test_a_proof_that_grows_too_large_says_so():
    with pytest.raises(ModelError, match="numerators of more than 3 terms.*affine_hull"):
        symbolic_hull(pendulum(), NAMES, {}, ("m", "z_m"), limit=3)


def test_a_denominator_that_vanishes_at_the_known_values_is_refused():
    proof = symbolic_hull(pendulum(), NAMES, {}, ("I_x", "d"))
    with pytest.raises(ModelError, match="zero at the known values; call affine_hull"):
        proof.numeric({**VALUES, "M": 0.0, "m": 0.0})
    with pytest.raises(ModelError, match="need the known value of M, z_g"):
        proof.numeric({})


def test_a_rank_that_rounding_hides_is_refused():
    """Two coefficients that differ by 1e-6 exp(p), a straight line to 1e-10 over the range."""
    p = ca.SX.sym("p")
    g = ca.Function("g", [p], [ca.vertcat(p, p + 1e-6 * ca.exp(p))])
    with pytest.raises(IdentifiabilityError, match="give wider `ranges` of p"):
        affine_hull(g, ("p",), {}, ("p",), ranges={"p": (1.0, 1.02)})


def test_an_equation_fills_in_its_names_and_known_values():
    """The hull is that of g: the names are the equation's, the known values the model's."""
    equation = difference_equation(direct_model().eliminate("a_y", using="accel"), "gyro", 0.01)
    short = equation.constraints(["I_x", "d"], {"k": 10.39})
    values = equation.known | {"k": 10.39}
    long = affine_hull(
        equation.g, equation.parameters, values, ["I_x", "d"], coefficients=equation.coefficients
    )
    np.testing.assert_array_equal(short.B, long.B)
    np.testing.assert_array_equal(short.b, long.b)
    assert short.relations() == long.relations()
    assert short.known == {n: values[n] for n in equation.parameters if n not in ("I_x", "d")}
    with pytest.raises(ModelError, match="no value for the known k, d; add it to `values`, or"):
        equation.constraints("I_x")
    assert equation.constraints(["I_x", "k", "d"]).rank == 0


def test_a_single_free_parameter_needs_no_list():
    one, listed = (affine_hull(pendulum(), NAMES, VALUES, free) for free in ("I_x", ["I_x"]))
    assert one.free == ("I_x",)
    np.testing.assert_array_equal(one.B, listed.B)
    assert image_dimension(pendulum(), NAMES, VALUES, "I_x") == 1
    proof = symbolic_hull(pendulum(), NAMES, VALUES, "I_x")
    assert proof.numeric(VALUES)[0].shape == one.B.shape
    with pytest.raises(ModelError, match="'I_y' is not a parameter of the coefficients; did you"):
        affine_hull(pendulum(), NAMES, VALUES, "I_y")
