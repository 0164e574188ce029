"""Examples 4.2, 4.3, 4.4 and 5.1 of Linder (2017): identifiability gained and lost.

Static systems: inputs move, nothing else does. Every verdict is reached twice, from the symbolic
matrix and from the exact rank, by ways that share no step. Noise plays no part.
"""

from __future__ import annotations

import casadi as ca
import sympy as sp

from casid import Model
from casid.identifiability.equations.system import System
from casid.identifiability.rank.observability import observability
from casid.identifiability.symbolic.observability_matrix import observability_matrix
from casid.model.expressions import parse


def static(parameters: str, inputs: str, **outputs: str) -> System:
    """Outputs that are expressions of parameters and known inputs, without states."""
    symbols = {n: ca.SX.sym(n) for n in (*parameters.split(), *inputs.split())}
    return System(
        name=" and ".join(f"{y} = {text}" for y, text in outputs.items()),
        states=(),
        parameters=tuple(parameters.split()),
        outputs=tuple(outputs),
        symbols=symbols,
        f=ca.SX(0, 1),
        h=ca.vertcat(*[parse(text, symbols) for text in outputs.values()]),
        inputs=tuple(inputs.split()),
    )


def eliminated(parameters: str, y_O: str, y_I: str) -> System:
    """The indirect model: y_I, which becomes an input, is solved for the unknown input."""
    model = Model("static")
    symbols = {n: model.parameter(n, "1") for n in parameters.split()}
    symbols["u_K"] = model.input("u_K", "1", known=True)
    symbols["w"] = model.unknown_input("w", "1")
    model.output("y_O", parse(y_O, symbols), "1")
    model.output("y_I", parse(y_I, symbols), "1")
    e = model.eliminate("w", using="y_I").explicit()
    return System(
        name="indirect",
        states=(),
        parameters=e.parameters,
        outputs=e.outputs,
        symbols=dict(
            zip((*e.inputs, *e.parameters), ca.vertsplit(ca.vertcat(e.u, e.p)), strict=True)
        ),
        f=ca.SX(0, 1),
        h=e.h,
        inputs=e.inputs,
    )


def verdicts(system: System) -> dict[str, bool]:
    """What both ways say of each parameter."""
    symbolic = observability_matrix(system)
    exact = observability(system)
    assert symbolic.rank() == exact.rank
    assert symbolic.identifiable() == dict(exact.identifiable)
    return symbolic.identifiable()


b_K, b_I, a_K, a_I = sp.symbols("b_K b_I a_K a_I")


def test_a_measured_input_with_known_gains_leaves_b_K_identifiable() -> None:
    """Example 4.2, (4.35)-(4.36): y_I = u_K + u_I gives y_O = b_K u_K + b_I (y_I - u_K)."""
    indirect = eliminated("b_K b_I", "b_K*u_K + b_I*w", "u_K + w")
    assert set(indirect.inputs) == {"u_K", "y_I"}
    assert verdicts(indirect) == {"b_K": True, "b_I": True}
    by_hand = static("b_K b_I", "u_K y_I", y_O="b_K*u_K + b_I*(y_I - u_K)")
    assert verdicts(by_hand) == {"b_K": True, "b_I": True}


def test_a_measured_input_with_unknown_gains_confounds_b_K() -> None:
    """Example 4.2, (4.37)-(4.38): only b_K - b_I a_K/a_I and b_I/a_I are told.

    Along every null direction both combinations stand still, and b_K alone does not.
    """
    indirect = eliminated("b_K b_I a_K a_I", "b_K*u_K + b_I*w", "a_K*u_K + a_I*w")
    by_hand = static("b_K b_I a_K a_I", "u_K y_I", y_O="(b_K - b_I/a_I*a_K)*u_K + b_I/a_I*y_I")
    for system in (indirect, by_hand):
        assert not any(verdicts(system).values())
        O = observability_matrix(system)  # noqa: E741
        assert O.rank() == 2
        directions = O.null_directions()
        assert len(directions) == 2
        for told in (b_K - b_I * a_K / a_I, b_I / a_I):
            for v in directions:
                slope = sum(sp.diff(told, sp.Symbol(n)) * e for n, e in v.items())
                assert sp.simplify(slope) == 0
        assert any("b_K" in v for v in directions)


def test_knowing_the_path_of_the_known_input_mends_example_4_2() -> None:
    """b_K is lost "unless more information is known": a_K is what has to be known."""
    confounded = static("b_K b_I a_K a_I", "u_K y_I", y_O="(b_K - b_I/a_I*a_K)*u_K + b_I/a_I*y_I")
    assert verdicts(confounded.with_known("a_K", "a_I")) == {"b_K": True, "b_I": True}
    assert verdicts(confounded.with_known("a_K", "b_I")) == {"b_K": True, "a_I": True}
    # b_I/a_I is told anyway, so knowing both of them brings nothing new for b_K.
    assert verdicts(confounded.with_known("b_I", "a_I")) == {"b_K": False, "a_K": False}
    # a_K alone is enough: b_K is what stands before u_K, plus a_K times what stands before y_I.
    assert verdicts(confounded.with_known("a_K"))["b_K"]


def test_neglecting_the_unknown_input_loses_b2() -> None:
    """Example 4.3: "naturally, b2 is not identifiable if the unknown input is neglected"."""
    assert verdicts(static("b1 b2", "u_K", y_O="b1*u_K")) == {"b1": True, "b2": False}


def test_a_measured_input_tells_the_sign_of_b2() -> None:
    """Example 4.3, (4.44)-(4.45).

    With both inputs known b2 occurs squared: its sign is a *global* question. Locally b2 is
    identifiable there, too, since no b2 near b2_0 has the same square; the rank sees it in both
    models. What is gained is that y_O = b1 u_K + b2 y_I is solved by one b2 and not by two.
    """
    direct = static("b1 b2", "u_K u_U", y_O="b1*u_K + b2^2*u_U")
    indirect = eliminated("b1 b2", "b1*u_K + b2^2*w", "b2*w")
    assert verdicts(direct) == {"b1": True, "b2": True}
    assert verdicts(indirect) == {"b1": True, "b2": True}
    b2, u_U, y_I, known = sp.symbols("b2 u_U y_I b2_0", nonzero=True)
    assert len(sp.solve(b2**2 * u_U - known**2 * u_U, b2)) == 2
    assert len(sp.solve(b2 * y_I - known * y_I, b2)) == 1
    # The elimination really is (4.45): its output is linear in b2.
    assert observability_matrix(indirect, 0).entry("y_O", 0, "b2") == sp.Symbol("y_I")


def test_b2_is_lost_where_the_measured_input_has_the_same_gain() -> None:
    """Example 4.4, (4.46)-(4.47): y_O = b1 u_K + y_I does not contain b2."""
    direct = static("b1 b2", "u_K u_U", y_O="b1*u_K + b2*u_U")
    indirect = static("b1 b2", "u_K y_I", y_O="b1*u_K + y_I")
    assert verdicts(direct) == {"b1": True, "b2": True}
    for system in (indirect, eliminated("b1 b2", "b1*u_K + b2*w", "b2*w")):
        assert verdicts(system) == {"b1": True, "b2": False}
        assert observability_matrix(system).null_directions() == ({"b2": 1},)


def test_a_sum_of_parameters_is_told_and_its_terms_are_not() -> None:
    """Example 5.1, (5.8): y = (a1 + b1) u_K."""
    alone = static("a1 b1", "u_K", y_1="(a1 + b1)*u_K")
    assert verdicts(alone) == {"a1": False, "b1": False}
    assert observability_matrix(alone).null_directions() == ({"a1": 1, "b1": -1},)


def test_a_second_sensor_mends_example_5_1() -> None:
    """(5.9)-(5.10): y_2 = a1 u_K in the same experiment."""
    both = static("a1 b1", "u_K", y_1="(a1 + b1)*u_K", y_2="a1*u_K")
    assert verdicts(both) == {"a1": True, "b1": True}


def test_a_second_experiment_mends_example_5_1() -> None:
    """(5.11): the same two measurements from two experiments, each with its own input.

    As one artificial system with two inputs, or as two systems that share their parameters.
    """
    artificial = static("a1 b1", "u_1 u_2", y_1="(a1 + b1)*u_1", y_2="a1*u_2")
    assert verdicts(artificial) == {"a1": True, "b1": True}
    first = static("a1 b1", "u_K", y_1="(a1 + b1)*u_K")
    second = static("a1", "u_K", y_2="a1*u_K")
    assert dict(observability([first, second]).identifiable) == {"a1": True, "b1": True}
    assert observability([first, first]).deficiency == 1  # repeating the experiment does not help
