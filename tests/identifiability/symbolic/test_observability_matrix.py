"""Lie derivatives and the extended observability matrix are what the thesis writes out."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import casadi as ca
import pytest
import sympy as sp

from casid.errors import ModelError
from casid.identifiability.equations.system import System
from casid.identifiability.symbolic.lie_derivatives import lie_derivatives
from casid.identifiability.symbolic.observability_matrix import observability_matrix


def system(
    name: str,
    states: tuple[str, ...],
    parameters: tuple[str, ...],
    f: Callable[[dict[str, Any]], list[Any]],
    h: Callable[[dict[str, Any]], dict[str, Any]],
    inputs: tuple[str, ...] = (),
    **others: Any,
) -> System:
    """A System whose equations are functions of its symbols by name."""
    extra = [
        n for k in ("constants", "unknown_inputs", "input_derivatives") for n in others.get(k, ())
    ]
    s = {n: ca.SX.sym(n) for n in (*states, *parameters, *inputs, *extra)}
    outputs = h(s)
    right = ca.vertcat(*f(s)) if states else ca.SX(0, 1)
    return System(
        name=name,
        states=states,
        parameters=parameters,
        outputs=tuple(outputs),
        symbols=s,
        f=right,
        h=ca.vertcat(*outputs.values()),
        inputs=inputs,
        **others,
    )


def special_case() -> System:
    """(7.16) with m = z_m = I_xm = 0, z_g = g = 1, y = phid; I_x, k, d unknown and M known."""
    return system(
        "special case",
        ("x1", "x2"),
        ("k", "d", "I_x"),
        lambda s: [
            s["x2"],
            (-(s["k"] + s["M"]) * s["x1"] - s["d"] * s["x2"] + s["M"] * s["u"])
            / (s["I_x"] + s["M"]),
        ],
        lambda s: {"y": s["x2"]},
        ("u",),
        constants=("M",),
    )


def pendulum(*, moved: bool) -> System:
    """(7.16) with the eight parameters (7.17), y = [phid, a_s]; a_y = 0 where it is not moved."""

    def rate(s: dict[str, Any]) -> Any:
        S = s["M"] * s["z_g"] + s["m"] * s["z_m"]
        inertia = s["I_x"] + s["M"] * s["z_g"] ** 2 + s["I_xm"] + s["m"] * s["z_m"] ** 2
        moment = -(s["k"] + S * s["g"]) * s["phi"] - s["d"] * s["phid"]
        return (moment + (S * s["a_y"] if moved else 0)) / inertia

    return system(
        "pendulum",
        ("phi", "phid"),
        ("k", "d", "I_x", "M", "z_g", "I_xm", "m", "z_m"),
        lambda s: [s["phid"], rate(s)],
        lambda s: {
            "phid": s["phid"],
            "a_s": s["z_s"] * rate(s) + s["g"] * s["phi"] - (s["a_y"] if moved else 0),
        },
        ("a_y",),
        constants=("g", "z_s"),
    )


x1, x2, k, d, I_x, M = sp.symbols("x1 x2 k d I_x M")
u, u1, u2, u3 = (sp.Symbol("u" + "'" * i) for i in range(4))
I1, Mk = I_x + M, k + M
Ik = I1 * Mk


def test_every_entry_of_the_special_case_is_that_of_the_thesis() -> None:
    """Linder (2017), (7.18)-(7.19), written out by hand: five states, so at most y''''."""

    def U_k(a: Any, b: Any) -> Any:
        return 2 * d * M / I1**3 * a - M / I1**2 * b

    def U_d(a: Any, b: Any, c: Any) -> Any:
        return M * (2 * Ik - 3 * d**2) / I1**4 * a + 2 * d * M / I1**3 * b - M / I1**2 * c

    def U_I(a: Any, b: Any, c: Any, e: Any) -> Any:
        return 2 * d * (2 * d**2 - 3 * Ik) * M / I1**5 * a + U_d(b, c, e)

    columns = {
        "x1": [
            0,
            -Mk / I1,
            d * Mk / I1**2,
            (Ik - d**2) * Mk / I1**3,
            d * (d**2 - 2 * Ik) * Mk / I1**4,
        ],
        "x2": [
            1,
            -d / I1,
            (d**2 - Ik) / I1**2,
            d * (2 * Ik - d**2) / I1**3,
            (d**4 - (3 * d**2 - Ik) * Ik) / I1**4,
        ],
        "k": [
            0,
            -x1 / I1,
            d / I1**2 * x1 - x2 / I1,
            (2 * Ik - d**2) / I1**3 * x1 + 2 * d / I1**2 * x2 + U_k(0, u),
            d * (d**2 - 4 * Ik) / I1**4 * x1 + (2 * Ik - 3 * d**2) / I1**3 * x2 + U_k(u, u1),
        ],
        "d": [
            0,
            -x2 / I1,
            Mk / I1**2 * x1 + 2 * d / I1**2 * x2 + U_d(0, 0, u),
            -2 * d * Mk / I1**3 * x1 + (2 * Ik - 3 * d**2) / I1**3 * x2 + U_d(0, u, u1),
            (3 * d**2 - 2 * Ik) * Mk / I1**4 * x1
            + d * (4 * d**2 - 6 * Ik) / I1**4 * x2
            + U_d(u, u1, u2),
        ],
        "I_x": [
            0,
            Mk / I1**2 * x1 + d / I1**2 * x2 + U_I(0, 0, 0, u),
            -2 * d * Mk / I1**3 * x1 + (Ik - 2 * d**2) / I1**3 * x2 + U_I(0, 0, u, u1),
            (3 * d**2 - 2 * Ik) * Mk / I1**4 * x1
            + d * (3 * d**2 - 4 * Ik) / I1**4 * x2
            + U_I(0, u, u1, u2),
            2 * d * (3 * Ik - 2 * d**2) * Mk / I1**5 * x1
            - (d**2 - 2 * Ik) * (4 * d**2 - Ik) / I1**5 * x2
            + U_I(u, u1, u2, u3),
        ],
    }
    O = observability_matrix(special_case(), 4)  # noqa: E741
    assert O.rows == tuple(("y", order) for order in range(5))
    assert O.columns == ("x1", "x2", "k", "d", "I_x")
    for name, column in columns.items():
        for order, entry in enumerate(column):
            assert sp.simplify(O.entry("y", order, name) - entry) == 0, (name, order)


def test_with_an_informative_input_the_special_case_has_full_rank() -> None:
    """(7.18) has rank 5, and no derivative beyond n + n_theta - 1 = 4 is taken."""
    O = observability_matrix(special_case())  # noqa: E741
    assert (O.rank(), O.orders) == (5, 4)
    assert O.identifiable() == {"k": True, "d": True, "I_x": True}
    assert O.null_directions() == ()


def test_without_input_the_rank_drops_to_four_and_inertia_scales_with_stiffness_and_damping() -> (
    None
):
    """(7.20). A series of second order tells M_k/I_1 and d/I_1.

    Divided by its first entry the last column is (1, d/M_k). The thesis prints M_k/I_1 for d/M_k;
    that is the first entry before the division, but for its sign.
    """
    O = observability_matrix(special_case().substituted({"u": 0}))  # noqa: E741
    assert O.rank() == 4
    assert O.identifiable() == {"k": False, "d": False, "I_x": False}
    assert O.observable() == {"x1": True, "x2": True}
    reduced = O.row_reduced()
    identity = sp.eye(4)
    plain = identity.row_join(sp.Matrix([0, 0, -Mk / I1, -d / I1]))
    scaled = identity.row_join(sp.Matrix([0, 0, 1, d / Mk]))
    assert (reduced.matrix - plain).applyfunc(sp.simplify) == sp.zeros(4, 5)
    assert (reduced.normalized().matrix - scaled).applyfunc(sp.simplify) == sp.zeros(4, 5)
    (direction,) = O.null_directions()
    assert direction == {"k": Mk, "d": d, "I_x": I1}
    for pair in (("k", "d"), ("k", "I_x"), ("d", "I_x")):
        assert O.only(*pair).rank() == 4  # any two parameters are identifiable together


def zeros_ones_and_expressions(matrix: Any) -> list[str]:
    """Rows as the thesis prints them: 0, 1, and a cross for a symbolic expression."""
    return [
        " ".join(str(e) if e in (0, 1) else "x" for e in matrix[i, :])
        for i in range(matrix.shape[0])
    ]


@pytest.mark.slow
def test_the_pendulum_reduces_to_the_form_of_the_thesis() -> None:
    """(7.21), rank 5; sub-matrices (7.22) decide what is identifiable together (table 7.1)."""
    O = observability_matrix(pendulum(moved=True))  # noqa: E741
    form = O.row_reduced().normalized()
    assert form.columns == ("phi", "phid", "k", "d", "I_x", "M", "z_g", "I_xm", "m", "z_m")
    assert zeros_ones_and_expressions(form.matrix) == [
        "1 0 0 0 0 0 0 0 0 0",
        "0 1 0 0 0 0 0 0 0 0",
        "0 0 1 0 0 1 1 0 1 1",
        "0 0 0 1 0 x x 0 x x",
        "0 0 0 0 1 x x 1 x x",
    ]
    assert O.only("I_x", "I_xm").rank() == 3
    assert O.only("I_x", "I_xm").null_directions() == ({"I_x": 1, "I_xm": -1},)
    assert O.only("k", "d", "M").rank() == 5
    assert O.only("I_xm", "m", "z_m").rank() == 4  # the load alone is not told
    assert not any(O.identifiable().values())
    assert O.observable() == {"phi": True, "phid": True}


def test_the_pendulum_without_input_reduces_to_the_form_of_the_thesis() -> None:
    """(7.23), rank 4."""
    O = observability_matrix(pendulum(moved=False))  # noqa: E741
    assert zeros_ones_and_expressions(O.row_reduced().normalized().matrix) == [
        "1 0 0 0 0 0 0 0 0 0",
        "0 1 0 0 0 0 0 0 0 0",
        "0 0 1 0 1 1 1 1 1 1",
        "0 0 0 1 x x x x x x",
    ]
    assert O.only("I_x", "I_xm").rank() == 3


def test_force_and_mass_cannot_be_told_from_an_acceleration() -> None:
    """(7.1): a = F/m, so (F, m) and (2 F, 2 m) look alike."""
    a = system("thrown", (), ("F", "m"), lambda s: [], lambda s: {"a": s["F"] / s["m"]})
    O = observability_matrix(a)  # noqa: E741
    assert O.rank() == 1
    assert O.null_directions() == ({"F": sp.Symbol("F"), "m": sp.Symbol("m")},)
    assert O.without("m").identifiable() == {"F": True}


def mass_damper() -> System:
    return system(
        "mass and damper",
        ("v",),
        ("m", "c", "b"),
        lambda s: [(-s["c"] * s["v"] + s["b"] * s["F"]) / s["m"]],
        lambda s: {"v": s["v"]},
        ("F",),
    )


def test_mass_damping_and_gain_are_known_up_to_a_factor() -> None:
    """m v' = -c v + b F tells c/m and b/m only."""
    O = observability_matrix(mass_damper())  # noqa: E741
    assert O.rank() == 3
    (direction,) = O.null_directions()
    assert direction == {n: sp.Symbol(n) for n in ("m", "c", "b")}
    known_gain = observability_matrix(mass_damper().with_known("b"))
    assert known_gain.identifiable() == {"m": True, "c": True}


def linear_output(A: Any, B: Any, C: Any, D: Any, x: Any, inputs: list[Any], order: int) -> Any:
    """y^(k) = C A^k x + sum_{i<k} C A^(k-1-i) B u^(i) + D u^(k)."""
    y = C * A**order * x + D * inputs[order]
    for i in range(order):
        y += C * A ** (order - 1 - i) * B * inputs[i]
    return y


def test_a_linear_models_matrix_is_that_of_its_solution() -> None:
    """At a random rational point, against the closed form of y^(k), differentiated exactly."""
    names = ("p", "q", "r", "b")
    linear = system(
        "linear",
        ("x1", "x2"),
        names,
        lambda s: [
            s["x2"] + s["b"] * s["q"] * s["u"],
            -s["p"] * s["x1"] - 0.1 * s["q"] * s["x2"] / s["r"] + s["u"],
        ],
        lambda s: {"y1": s["x1"] * s["r"] + s["b"] * s["u"], "y2": s["x2"]},
        ("u",),
    )
    p, q, r, b = sp.symbols(names)
    A = sp.Matrix([[0, 1], [-p, -q / (10 * r)]])
    B, C, D = sp.Matrix([b * q, 1]), sp.Matrix([[r, 0], [0, 1]]), sp.Matrix([b, 0])
    inputs = [sp.Symbol("u" + "'" * i) for i in range(4)]
    state = sp.Matrix([x1, x2])
    unknown = [x1, x2, p, q, r, b]
    primes = [sp.Rational(n, 7) for n in (2, 3, 5, 11, 13, 17, 19, 23, 29, 31)]
    point = dict(zip([*unknown, *inputs], primes, strict=True))
    O = observability_matrix(linear, 3)  # noqa: E741
    for order in range(4):
        expected = linear_output(A, B, C, D, state, inputs, order).jacobian(unknown).subs(point)
        for i, y in enumerate(("y1", "y2")):
            row = [O.entry(y, order, c).subs(point) for c in O.columns]
            assert row == list(expected[i, :])


def test_a_pendulum_that_swings_far_tells_stiffness_damping_and_gain() -> None:
    """sin and cos stay as they are; without its gravity known, k and c only occur as a product."""
    far = system(
        "swing",
        ("x", "v"),
        ("k", "d", "c"),
        lambda s: [s["v"], -s["k"] * s["c"] * ca.sin(s["x"]) - s["d"] * s["v"]],
        lambda s: {"x": s["x"]},
    )
    second = lie_derivatives(far, 2)["x"][2]
    x, v, k_, d_, c = sp.symbols("x v k d c")
    assert sp.simplify(second - (-k_ * c * sp.sin(x) - d_ * v)) == 0
    O = observability_matrix(far)  # noqa: E741
    assert O.rank() == 4
    assert O.identifiable() == {"k": False, "d": True, "c": False}
    assert O.null_directions() == ({"k": k_, "c": -c},)


def test_identities_between_functions_are_not_missed() -> None:
    """a sin^2 + a cos^2 + b is a + b, although no cancellation is asked of the algebra."""
    hidden = system(
        "hidden",
        ("x",),
        ("a", "b"),
        lambda s: [ca.SX(1)],
        lambda s: {
            "x": s["x"],
            "y": s["a"] * (ca.sin(s["x"]) ** 2 + ca.cos(s["x"]) ** 2) + s["b"],
        },
    )
    O = observability_matrix(hidden)  # noqa: E741
    assert O.rank() == 2
    assert O.identifiable() == {"a": False, "b": False}


def test_inputs_derivatives_are_symbols_of_their_own() -> None:
    """An input's declared derivative is the derivative that (2.63) forms."""
    s = system(
        "filter",
        ("x",),
        ("a",),
        lambda s: [-s["a"] * s["x"] + s["rate"]],
        lambda s: {"y": s["x"] + s["u"]},
        ("u",),
        input_derivatives={"rate": ("u", 1)},
    )
    a, x = sp.symbols("a x")
    y, first, second = lie_derivatives(s, 2)["y"]
    assert y == x + u
    assert sp.simplify(first - (-a * x + 2 * u1)) == 0
    assert sp.simplify(second - (-a * (-a * x + u1) + 2 * u2)) == 0


def test_known_initial_states_have_no_column_and_special_ones_need_an_order() -> None:
    """S' = 1 + a S^2 from S(0) = 0: a is seen in S''' only, after two derivatives without it."""
    grown = system(
        "growth", ("S",), ("a",), lambda s: [1 + s["a"] * s["S"] ** 2], lambda s: {"y": s["S"]}
    )
    known = observability_matrix(grown.where(known_initial=("S",)))
    assert known.columns == ("a",)
    assert known.identifiable() == {"a": True}
    special = grown.where(initial_values={"S": Fraction(0)})
    with pytest.raises(ModelError, match="give orders"):
        observability_matrix(special)
    assert observability_matrix(special, 2).rank() == 0
    assert observability_matrix(special, 3).rank() == 1


def test_the_matrix_prints_with_its_labels() -> None:
    shown = str(observability_matrix(mass_damper(), 0))
    assert "1 x 4, rank 1" in shown
    assert [line.split() for line in shown.splitlines()[1:]] == [
        ["v", "m", "c", "b"],
        ["v", "1", "0", "0", "0"],
    ]
    latex = observability_matrix(mass_damper()).to_latex()
    assert r"\ddot{v}" in latex
    assert r"\dot{F}" in latex


def test_systems_that_have_no_such_matrix_are_refused_with_a_mend() -> None:
    unknown = mass_damper().where(inputs=(), unknown_inputs=("F",))
    with pytest.raises(ModelError, match="eliminate it with an output"):
        observability_matrix(unknown)
    with pytest.raises(ModelError, match=r"casid\.assess_identifiability"):
        observability_matrix(pendulum(moved=True), limit_seconds=0.0)
    corner = system(
        "dry friction",
        ("v",),
        ("c",),
        lambda s: [-s["c"] * ca.sign(s["v"])],
        lambda s: {"v": s["v"]},
    )
    with pytest.raises(ModelError, match="sign has no derivative everywhere.*write the branch"):
        observability_matrix(corner)
    with pytest.raises(ModelError, match="did you mean 'c'|no column"):
        observability_matrix(mass_damper()).only("cc")
