"""Where an expression has no finite value, the operation that has none is named."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from casid.model.singular_parts import singular_part

F, q, c = ca.SX.sym("F"), ca.SX.sym("q"), ca.SX.sym("c")
SYMBOLS = ca.vertcat(F, q, c)
EMPTY = np.array([0.0, 1.0, 2.0])  # F is zero


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        (F * (q / F - c), "divide by F, which is 0"),
        (ca.vertcat(c, c / (1 - q)), "divide by 1 - q, which is 0"),
        (c / F**2, "divide by F^2, which is 0"),
        (c * ca.log(F), "take the logarithm of F, which is 0"),
        (ca.sqrt(F - q), "take the root of F - q, which is -1"),
        (F**-1.5, "take a power of F, which is 0"),
        (ca.jacobian(ca.sqrt(c * F), c), "divide by 2 * sqrt(c * F), which is 0"),
    ],
)
def test_an_operation_without_a_value_is_said_with_its_operand(expression, said):
    assert str(singular_part(expression, SYMBOLS, EMPTY)) == said


@pytest.mark.parametrize("expression", [ca.if_else(F > 0, q / F, c), q + c, ca.exp(1e4 * c)])
def test_a_branch_that_is_not_taken_and_a_value_that_overflows_are_no_such_operation(expression):
    assert singular_part(expression, SYMBOLS, EMPTY) is None
