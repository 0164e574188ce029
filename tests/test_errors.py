"""Messages: names that are not there, and options as a shell takes them."""

from __future__ import annotations

import shlex

import pytest

import casid
from casid.errors import UnknownNameError, nearest, shell_option
from tests.support import samples


def test_a_name_that_a_result_does_not_hold_is_an_error_of_casid_and_a_key_error():
    estimate = samples.estimate()
    with pytest.raises(casid.CasidError) as caught:
        estimate["mass"]
    assert isinstance(caught.value, UnknownNameError)
    assert isinstance(caught.value, KeyError)
    assert str(caught.value) == f"no parameter 'mass'; there are {', '.join(estimate.names)}"


def test_names_that_a_message_lists_are_not_listed_twice():
    known = ["modelica", "fmu"]
    assert nearest("simulink", known) == "; known are: fmu, modelica"
    assert nearest("simulink", known, is_listed=True) == ""
    assert nearest("fmi", known, is_listed=True) == "; did you mean 'fmu'?"


@pytest.mark.parametrize("column", ["u", "Öldruck [bar]#3", "driver's torque"])
def test_an_option_in_a_message_is_taken_by_a_shell_as_it_stands(column):
    assert shlex.split(shell_option("--map", f"p={column}")) == ["--map", f"p={column}"]
