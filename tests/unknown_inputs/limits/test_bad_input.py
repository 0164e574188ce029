"""What cannot be answered is refused: what, where, and how to mend it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy as sp

from casid.errors import IdentifiabilityError, ModelError
from casid.unknown_inputs.limits.input_measurement import InputMeasurement
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.regression import FirstStage, Regression
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.limits.remedies import compare_remedies
from problems.static_input import signals

WHITE = {"w": 1.0, "e": 0.1}


@pytest.mark.parametrize(
    ("pole", "text"), [(1.0, "z = 1, modulus 1"), (-1.25, "z = -1.25, modulus 1.25")]
)
def test_an_unstable_filter_names_its_pole(pole: float, text: str) -> None:
    with pytest.raises(ModelError, match=f"signal y: the filter of w has a pole at {text}.*stable"):
        LinearSignals.of({"y": {"w": ([1], [1, -pole])}}, WHITE)


def test_an_unstable_state_space_names_its_eigenvalue() -> None:
    with pytest.raises(ModelError, match=r"A has the eigenvalue 1\.1.*Give the stable closed loop"):
        LinearSignals.of_state_space(([[1.1]], [[1.0]], [[1.0]], [[0.0]]), {"w": 1}, signals=["y"])


def test_an_unstable_response_of_a_network_is_noticed() -> None:
    """On the circle an unstable pole looks like an answer that comes before its cause."""

    def response(z: Any) -> Any:
        return (1 / (1 - 1.2 / z))[:, None, None]

    system = LinearSignals.of_response(["y"], response, {"w": 1.0})
    with pytest.raises(ModelError, match="the responses of y have not died out.*stable"):
        regression_limit(system, Regression("y", {"a": ("y", 1)}))


def test_a_filter_that_sees_the_future_is_refused() -> None:
    import control

    with pytest.raises(ModelError, match=r"improper \(degree 2 over 1\).*delay it"):
        LinearSignals.of({"y": {"w": control.tf([1, 0, 0], [1, 0.5], 1.0)}}, WHITE)
    with pytest.raises(ModelError, match="begins with 0, so the filter needs the future"):
        LinearSignals.of({"y": {"w": ([1], [0, 1])}}, WHITE)


def test_continuous_time_is_refused_with_the_function_that_samples() -> None:
    import control

    with pytest.raises(ModelError, match="of continuous time; sample it first, control.sample_sys"):
        LinearSignals.of({"y": {"w": control.tf([1], [1, 1])}}, WHITE)


def test_sample_times_that_differ_are_refused() -> None:
    import control

    one, two = (control.tf([1], [1, 0.5], Ts) for Ts in (0.1, 0.2))
    with pytest.raises(ModelError, match=r"filter of e has sample time 0\.2 s, the system 0\.1 s"):
        LinearSignals.of({"y": {"w": one, "e": two}}, WHITE)
    system = LinearSignals.of({"y": {"w": one, "e": 1}}, WHITE)
    with pytest.raises(ModelError, match=r"prefilter has sample time 0\.2 s, the system 0\.1 s"):
        regression_limit(system, Regression("y", {"a": ("y", 1)}, prefilter=two))


def test_dependent_regressors_name_the_combination_symbolically_and_in_numbers() -> None:
    system = LinearSignals.of({"u1": "w + e", "u2": "k*w + k*e", "y": "u1"}, WHITE)
    regression = Regression("y", {"b1": "u1", "b2": "u2"})
    with pytest.raises(
        IdentifiabilityError, match=r"u1, u2 depend on each other.*u1 - 1/k\*u2 = 0"
    ):
        regression_limit(system, regression)
    with pytest.raises(IdentifiabilityError, match=r"u1 - 0\.5\*u2 = 0\. Leave one out"):
        regression_limit(system.at({"k": 2.0}), regression)


def test_weak_instruments_name_the_change_that_they_do_not_see() -> None:
    """delta1 alone moves u_K and u_U together where beta = 0: (1, -1/alpha) cannot be told."""
    system = signals().at({"beta": 0}).with_signals({"twice": "2*delta1"})
    regression = Regression("y_O", {"bK": "u_K", "bU": "u_U"}, ["delta1", "twice"])
    with pytest.raises(
        IdentifiabilityError,
        match=r"is not identifiable: d bK \(u_K\) = 1, d bU \(u_U\) = -1/alpha\. Give instruments",
    ):
        regression_limit(system, regression)


def test_too_few_instruments_are_counted() -> None:
    with pytest.raises(ModelError, match="1 instruments for the 2 coefficients bK, bU; give at le"):
        Regression("y_O", {"bK": "u_K", "bU": "u_U"}, ["delta1"])


def test_a_deficient_input_measurement_names_what_it_loses() -> None:
    system = LinearSignals.of(
        {"y": "u1 + u2 + u3 + v", "s1": "u1 + u2", "s2": "u3"}, dict(u1=1, u2=1, u3=1, v=1)
    )
    both = InputMeasurement(["s1", "s2"], ["u1", "u2", "u3"], [[1, 1, 0], [0, 0, 1]])
    with pytest.raises(
        IdentifiabilityError,
        match=r"rank 2 for the 3 inputs u1, u2, u3: u1, u2 cannot be recovered, since no sensor "
        r"detects a change of u1 by -?1, u2 by -?1\. Add a sensor",
    ):
        compare_remedies(
            system, "y", {"b1": "u1", "b2": "u2", "b3": "u3"}, ["u1", "u2", "u3"],
            {"b1": 1, "b2": 1, "b3": 1}, measured=both,
        )  # fmt: skip
    twice = InputMeasurement(["s1", "s2"], ["u1", "u2"], [[1.0, 3.0], [2.0, 6.0 + 1e-14]])
    with pytest.raises(IdentifiabilityError, match="rank 1 for the 2 inputs u1, u2: u1, u2 cannot"):
        twice.recover(system)
    with pytest.raises(ModelError, match=r"gain has shape \(1, 2\) for 2 sensors and 3 inputs"):
        InputMeasurement(["s1", "s2"], ["u1", "u2", "u3"], [[1, 1]]).recover(system)


def test_shapes_of_a_state_space_are_checked_one_by_one() -> None:
    A = 0.5 * np.eye(2)
    with pytest.raises(ModelError, match=r"B has shape \(2, 1\), not \(2, 2\), for 2 states"):
        LinearSignals.of_state_space((A, [[1], [0]], [[1, 0]], [[0]]), WHITE, signals=["y"])
    with pytest.raises(ModelError, match="1 outputs and no names; give signals="):
        LinearSignals.of_state_space((A, np.eye(2), [[1, 0]], [[0, 0]]), WHITE)
    with pytest.raises(ModelError, match=r"shape \(1, 2\), not \(1, signals, externals\)"):
        LinearSignals.of_response(["y"], lambda z: np.zeros((len(z), 2)), WHITE)


@pytest.mark.parametrize(
    ("definition", "text"),
    [
        ("2*w*e", "no linear combination of e, w; write it as a sum"),
        ("w + 1", "no linear combination of w"),
        ("b*missing", "holds none of the signals w, e; name the externals in variances"),
        ({"q": 1.0}, "'q' is not known there; known are w, e"),
        ({"w": "text with spaces ("}, "signal y: the filter of w"),
        ({"w": [1, 2, 3]}, "give a number, a pair"),
        ({"w": ([1, np.nan], [1])}, "not finite; give finite numbers"),
    ],
)
def test_a_signal_that_is_no_sum_of_filtered_sources_is_refused(definition: Any, text: str) -> None:
    with pytest.raises(ModelError, match=text.replace("(", r"\(")):
        LinearSignals.of({"y": definition}, WHITE)


def test_names_are_told_apart_and_near_ones_suggested() -> None:
    system = LinearSignals.of({"u_K": "w", "y": "u_K + e"}, WHITE)
    with pytest.raises(ModelError, match=r"'u_k' is not known there.*did you mean 'u_K'\?"):
        regression_limit(system, Regression("y", {"b": "u_k"}))
    with pytest.raises(
        ModelError, match="signal y is there already; give the new one another name"
    ):
        system.with_signals({"y": "w"})
    with pytest.raises(ModelError, match="truth of c: no coefficient of this regression, .* has b"):
        regression_limit(system, Regression("y", {"b": "u_K"}), {"c": 1})
    stage = FirstStage("y", ["w"])
    with pytest.raises(ModelError, match="generated signal u_K is a signal of the system; rename"):
        regression_limit(system, Regression("y", {"b": "u_K"}, generated={"u_K": stage}))


def test_variances_and_kurtoses_have_their_limits() -> None:
    with pytest.raises(ModelError, match="variance of w is -1; give a finite number, 0 or more"):
        LinearSignals.of({}, {"w": -1})
    with pytest.raises(ModelError, match="no distribution has less than -2"):
        LinearSignals.of({}, WHITE, excess_kurtosis={"w": -3})
    with pytest.raises(ModelError, match="no external signal; give variances="):
        LinearSignals.of({"y": "w"}, {})


def test_symbols_are_for_static_systems() -> None:
    b = sp.Symbol("b", positive=True)
    with pytest.raises(ModelError, match="dynamic system with the symbols b: symbols are for stat"):
        LinearSignals.of({"u": {"w": ([1], [1, -0.5])}, "y": {"u": b}}, WHITE)
    system = LinearSignals.of({"y": {"w": b, "e": 1}}, WHITE)
    with pytest.raises(ModelError, match="lags or a prefilter on a system with the symbols b"):
        regression_limit(system, Regression("y", {"a": ("y", 1)}))
    assert [str(s) for s in system.symbols] == ["b"]
    with pytest.raises(ModelError, match="at: 'c' is not known there; known are b"):
        system.at({"c": 1})


def test_a_signal_for_what_is_not_unknown_is_refused() -> None:
    with pytest.raises(ModelError, match="y_U is given for u_K, which is no unknown input; these"):
        compare_remedies(
            signals(), "y_O", {"bK": "u_K", "bU": "u_U"}, "u_U", {"bK": 1, "bU": 1},
            measured={"u_K": "y_U"},
        )  # fmt: skip


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"N": 0}, "N = 0; give a number of samples above 0"),
        ({"accuracy": {"c": 1}}, "accuracy of c = 1; give a value above 0 for one of b"),
        ({"accuracy": -0.1}, "accuracy of b = -0.1; give a value above 0"),
    ],
)
def test_samples_and_accuracies_are_positive_and_of_a_coefficient(
    given: dict[str, Any], text: str
) -> None:
    system = LinearSignals.of({"y": "2*w + e"}, WHITE)
    with pytest.raises(ModelError, match=text):
        compare_remedies(system, "y", {"b": "w"}, "w", {"b": 2}, **given)


def test_an_unknown_input_must_act_and_every_coefficient_have_a_truth() -> None:
    with pytest.raises(ModelError, match="unknown input y_U is no regressor; the regressors are"):
        compare_remedies(signals(), "y_O", {"bK": "u_K"}, "y_U", {"bK": 1})
    with pytest.raises(ModelError, match="no true value of bU; give truth="):
        compare_remedies(signals(), "y_O", {"bK": "u_K", "bU": "u_U"}, "u_U", {"bK": 1})
