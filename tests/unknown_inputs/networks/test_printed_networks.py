"""What a user gives for nodes and modules, and what is printed of filters that cannot be run."""

from __future__ import annotations

import casadi as ca
import control
import pytest
import sympy

from casid.algebra.rational import Rational
from casid.errors import ModelError
from casid.report.figures.network_drawing import roles
from casid.unknown_inputs.networks.confounders import confounders
from casid.unknown_inputs.networks.elimination import immerse
from casid.unknown_inputs.networks.equations import node_equations
from casid.unknown_inputs.networks.indirect_equations import (
    eliminate_by_measurement,
    indirect_equations,
)
from casid.unknown_inputs.networks.network import dynamic_network
from casid.unknown_inputs.networks.node_sets import node_sets
from casid.unknown_inputs.networks.prediction.predictors import compare_predictors
from casid.unknown_inputs.networks.predictor_inputs import predictor_inputs
from casid.unknown_inputs.networks.propositions import proposition_3_1

Q = Rational.shift(Ts=1.0)
MODULES = {("speed", "load"): 1 / (Q - 0.5), ("meter", "load"): 2 / (Q - 0.2)}


def test_a_text_is_one_node_wherever_nodes_are_asked_for():
    """Its letters are nodes of nobody; the same holds for a single number."""
    net = dynamic_network(MODULES, excitations="load", disturbances="speed", measured="speed")
    assert net.measured == ("speed",)
    assert tuple(net.excitations) == ("load",)
    assert tuple(net.disturbances) == ("speed",)
    assert dynamic_network({}, nodes="speed").nodes == ("speed",)
    both = net.with_sensors(("speed", "meter"))
    assert both.with_sensors("speed").measured == ("speed",)
    assert node_sets(both, "speed", sensors="speed").S == ("speed",)
    sets = node_sets(both, "speed", indirect="meter")
    assert sets.I == ("meter",)
    known = {("meter", "load")}
    assert node_sets(both, "speed", direct="meter", known=known).D == ("meter",)
    assert immerse(both, "speed").nodes == ("speed",)
    found = eliminate_by_measurement(both, "load", "meter")
    assert found.module("speed", "meter").equals((Q - 0.2) / (Q - 0.5) / 2)
    assert [p.kind for p in compare_predictors(net, "speed", sensors="speed").predictors]
    assert roles(both, "speed", "meter").role["meter"] == "predictor input"
    everyone = both.with_sensors(both.nodes)
    assert confounders(everyone, "speed", "load") == ()
    assert proposition_3_1(everyone, "speed", "load", "load").conclusion
    few = predictor_inputs(everyone, "speed", "load", sensors=("speed", "load"))
    assert few.sets[0].inputs == ("load",)
    assert dynamic_network({(2, 1): 1 / Q}, measured=2).measured == (2,)


def test_what_is_no_mapping_of_modules_is_refused_with_the_mend():
    with pytest.raises(ModelError, match="modules is a StateSpace; give a mapping of .to, from."):
        dynamic_network(control.ss(-0.5, 1, 1, 0))
    single = dynamic_network({("y", "u"): control.ss(-0.5, 1, 1, 0, 1.0)})
    assert single.module("y", "u").equals(1 / (Q + 0.5))


def test_casadi_mx_cannot_be_read_and_sx_can():
    with pytest.raises(ModelError, match=r"module Gab: a CasADi MX .* SX symbols \(ca.SX.sym for"):
        dynamic_network({("a", "b"): ca.MX.sym("k")})
    assert dynamic_network({("a", "b"): ca.SX.sym("k")}).parameters == ("k",)


@pytest.mark.parametrize("options", [{}, {"nodes": []}])
def test_a_network_without_nodes_is_refused(options):
    with pytest.raises(ModelError, match="no module and no node; give modules .* or nodes="):
        dynamic_network({}, **options)


def test_the_text_of_equations_marks_filters_that_cannot_be_run():
    """q^3 looks three samples ahead; a zero at 2 makes a pole there."""
    late = dynamic_network(
        {("a", "u"): 1 / (Q - 0.5), ("m", "u"): 1 / Q**3 / (Q - 0.5)}, measured=("a", "m")
    )
    text = str(indirect_equations(late, node_sets(late, "a")))
    assert "the filter of m in a is IMPROPER (samples it looks ahead: 3)" in text
    assert "the filter of e_m in a is IMPROPER" in text
    wrong = dynamic_network(
        {("a", "u"): 1 / (Q - 0.5), ("m", "u"): (Q - 2) / Q / (Q - 0.5)}, measured=("a", "m")
    )
    text = str(indirect_equations(wrong, node_sets(wrong, "a")))
    assert "the filter of m in a is UNSTABLE (pole q = 2" in text
    assert "IMPROPER" not in text
    s = Rational.derivative()
    slow = dynamic_network({("a", "u"): 1, ("m", "u"): 1 / (s + 1)}, measured=("a", "m"))
    assert "order of derivatives: 1" in str(indirect_equations(slow, node_sets(slow, "a")))


def test_equations_that_can_be_run_are_printed_without_marks_and_letters_claim_no_stability():
    good = dynamic_network(MODULES, measured=("speed", "meter"))
    assert "UNSTABLE" not in str(indirect_equations(good, node_sets(good, "speed")))
    a = sympy.Symbol("a")
    lettered = dynamic_network(
        {("y", "u"): 1 / (Q - 0.5), ("m", "u"): sympy.Symbol("q") ** -2 * a}, measured=("y", "m")
    )
    text = str(indirect_equations(lettered, node_sets(lettered, "y")))
    assert "IMPROPER (samples it looks ahead: 1)" in text
    assert "UNSTABLE" not in text
    assert "IMPROPER" not in str(node_equations(good, at=3))
