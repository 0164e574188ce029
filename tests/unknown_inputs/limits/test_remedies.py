"""Remedies for an unknown input side by side: what is best, why, and what it costs."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.signal

from analysis.static_examples.formulas import variance_boundary
from analysis.static_examples.study import with_a_slow_input
from casid.errors import ModelError
from casid.estimation.prediction_error.polynomial.orders import Orders
from casid.unknown_inputs.limits.comparison import Comparison
from casid.unknown_inputs.limits.decision_map import REGIONS, DecisionMap, decision_map
from casid.unknown_inputs.limits.input_measurement import InputMeasurement
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.module_remedies import compare_module_remedies
from casid.unknown_inputs.limits.regression import Regression, Term, lags
from casid.unknown_inputs.limits.regression_limit import regression_limit
from casid.unknown_inputs.limits.remedies import Remedy, compare_remedies
from problems.static_input import VALUES, signals
from tests.report.golden_results import comparison

BOTH: dict[str, Term] = {"bK": "u_K", "bU": "u_U"}
TRUTH = {"bK": "bK", "bU": "bU"}
NUMBERS = {k: v for k, v in VALUES.items() if k != "beta"} | {"a1": 0.5, "a2": 1.2}


@pytest.fixture(scope="module")
def benchmark() -> Comparison:
    """The thesis's benchmark in letters, beta = 0."""
    return comparison()


def test_one_call_has_every_remedy_of_the_thesis_in_letters(benchmark: Comparison) -> None:
    assert benchmark.is_symbolic
    assert str(benchmark["neglect, LS"]["bK"]) == "alpha*bU + bK"
    assert benchmark["predict from y_U, two-stage"].bias("bK") == 0
    text = str(benchmark)
    for remedy in ("neglect, LS", "neglect, IV", "approximate by u_hat", "explain by delta2",
                   "predict from y_U, two-stage", "predict from y_U, first stage known",
                   "measure y_U, LS", "measure y_U, IV", "eliminate with u_I, LS"):  # fmt: skip
        assert remedy in text
    with pytest.raises(
        ModelError, match=r"symbolic comparison has no order; give numbers, comparison\.at"
    ):
        benchmark.best("bK")


def test_a_remedy_that_cannot_be_used_says_why(benchmark: Comparison) -> None:
    """With beta = 0, u_K is delta1: the two depend on each other (3.36 divides by beta)."""
    text = str(benchmark)
    assert "not possible: explain by delta1, delta2" in text
    assert "u_K - delta1 = 0" in text


def test_a_remedy_without_a_limit_at_some_numbers_says_so_there() -> None:
    """The letters have a limit, (3.36); at beta = 0 it does not exist, and the others do."""
    system = signals()
    compared = compare_remedies(
        system,
        "y_O",
        {"bK": "u_K", "bU": "u_U"},
        "u_U",
        {"bK": "bK", "bU": "bU"},
        known=["delta1", "delta2"],
    )
    there = compared.at({**VALUES, "beta": 0.0})
    with pytest.raises(ModelError, match="no limit at .*beta = 0.*leave one of them out"):
        there["explain by delta1, delta2"]
    assert there["neglect, LS"]["bK"] == pytest.approx(1.3 - 0.8 * 0.7)
    assert compared.at(VALUES)["explain by delta1, delta2"]["bK"] == pytest.approx(1.3 - 0.8 / 0.4)


def test_the_best_remedy_depends_on_the_number_of_samples(benchmark: Comparison) -> None:
    """Bias wins while the record is short: the crossover is (P_exact - P_biased)/bias^2."""
    numbers = benchmark.at(NUMBERS, N=1000)
    best = numbers.best("bK")
    assert best is not None
    assert best.remedy == "predict from y_U, two-stage"
    assert "measure y_U, LS is better up to N = 15" in best.why
    eiv, exact = numbers["measure y_U, LS"], numbers["predict from y_U, two-stage"]
    crossover = (exact.variance("bK") - eiv.variance("bK")) / eiv.bias("bK") ** 2
    assert 15 <= crossover < 16
    short = benchmark.at(NUMBERS, N=10).best("bK")
    assert short is not None
    assert short.remedy == "measure y_U, LS"
    assert "from N = 16 on predict from y_U, two-stage is better" in short.why


def test_accuracy_and_samples_say_the_same(benchmark: Comparison) -> None:
    numbers = benchmark.at(NUMBERS)
    for row in numbers.rows:
        if row.result is None or not row.estimates("bK"):
            continue
        N = row.result.samples_for("bK", 0.05)
        if math.isfinite(N):
            assert math.sqrt(row.result.amse("bK", N)) == pytest.approx(0.05)
        else:
            assert abs(row.result.bias("bK")) >= 0.05


def test_neglect_is_told_with_its_price(benchmark: Comparison) -> None:
    numbers = benchmark.at(NUMBERS)
    line = numbers.cost_of_neglecting("bK")
    assert "neglecting u_U leaves rmse 0.561 (bias -0.56), knowing it 0.0196" in line
    assert line.endswith("worth measuring")
    # A nearly perfect world: an input that hardly acts is not worth a noisy sensor.
    quiet = benchmark.at(NUMBERS | {"bU": -0.001, "alpha": 0.001, "le": 50.0})
    assert quiet.cost_of_neglecting("bK").endswith("not worth measuring")
    assert numbers.cost_of_neglecting("bU") == "bU: cannot be had while u_U is neglected"


def test_the_table_and_the_figure_hold_the_same_numbers(benchmark: Comparison) -> None:
    numbers = benchmark.at(NUMBERS)
    table = {(r["remedy"], r["coefficient"]): r for r in numbers.table()}
    row = table["measure y_U, IV", "bU"]
    assert row["variance"] == pytest.approx(0.926667, abs=1e-6)
    assert row["N wanted"] == pytest.approx(0.926667 / 0.05**2, rel=1e-5)
    assert row["amse at 1"] == pytest.approx(row["variance"])
    figure = numbers.plot()
    points = [t for t in figure.data if t.mode == "markers"]
    assert len(points) == len(table)
    drawn = {t.y[0]: t.x[0] for t in points[: len(points) - 8]}
    assert drawn["neglect, LS"] == pytest.approx(0.74)
    assert "u_U" in figure.layout.meta["caption"]
    lines = [t for t in figure.data if t.mode == "lines" and t.name == "neglect, LS"]
    assert lines[0].y[-1] == pytest.approx(0.56, rel=1e-3)  # the bias is what remains


def test_remedies_on_a_dynamic_system_are_those_of_a_simulation() -> None:
    """500 runs of N = 1000 in plain numpy; 3.5 Monte Carlo standard errors and O(1/N)."""
    compared = compare_remedies(
        with_a_slow_input(), "y", {"b1": ("u_K", 1), "b2": ("u_K", 2), "c1": ("u_U", 1)}, "u_U",
        {"b1": 1.0, "b2": 0.5, "c1": -0.7},
        known=[*lags("r", 1, 3), ("d", 1)], explain=[], measured={"u_U": "y_U"}, accuracy=0.03,
    )  # fmt: skip
    rng, runs, N = np.random.default_rng(11), 500, 1000
    f, n = scipy.signal.lfilter, N + 60

    def noise(variance: float) -> np.ndarray:
        return math.sqrt(variance) * rng.standard_normal((runs, n))

    r, w, d, tau, e = noise(1.0), noise(0.3), noise(0.4), noise(0.2), noise(0.2)
    uK = r + f([0, 0.6], [1, -0.7], w)
    uU = f([0, 0.5], [1], r) + f([1], [1, -0.8], w) + d
    y = f([0, 1, 0.5], [1], uK) + f([0, -0.7], [1], uU) + f([1, 0.4], [1], tau)

    def late(x: np.ndarray, k: int) -> np.ndarray:
        return x[:, 60 - k : n - k]

    def fit(phi: list[np.ndarray], z: list[np.ndarray] | None = None) -> np.ndarray:
        Phi = np.stack(phi, axis=1)
        if z is None:
            Z = Phi
        else:
            Z = np.stack(z, axis=1)
            first = np.linalg.solve(Z @ Z.swapaxes(1, 2), Z @ Phi.swapaxes(1, 2))
            Z = first.swapaxes(1, 2) @ Z
        left, right = Z @ Phi.swapaxes(1, 2), Z @ late(y, 0)[:, :, None]
        return np.asarray(np.linalg.solve(left, right)[:, :, 0])

    two = [late(uK, 1), late(uK, 2)]
    z = [late(r, 1), late(r, 2), late(r, 3), late(d, 1)]
    found = {
        "all inputs known, LS": fit([*two, late(uU, 1)]),
        "neglect, LS": fit(two),
        "neglect, IV": fit(two, z),
        "measure y_U, LS": fit([*two, late(uU + e, 1)]),
        "measure y_U, IV": fit([*two, late(uU + e, 1)], z),
    }
    for remedy, theta in found.items():
        result = compared[remedy]
        P = np.diag(result.covariance)
        error = np.abs(theta.mean(axis=0) - result.limit)
        assert np.all(error < 3.5 * np.sqrt(P / N / runs) + 2 / N), remedy
        ratio = N * theta.var(axis=0, ddof=1) / P
        assert np.all(np.abs(ratio - 1) < 3.5 * math.sqrt(2 / runs) + 4 / N), remedy
        assert result.std_error("b1", N) == pytest.approx(math.sqrt(P[0] / N))
    best = compared.best("c1")
    assert best is not None
    assert best.remedy == "measure y_U, IV"


@pytest.mark.slow
def test_modules_estimated_by_prediction_error_are_compared_as_well() -> None:
    """With white regressors apart from the sensor's noise, PEM is attenuated as (3.55) says."""
    system = LinearSignals.of(
        {
            "u_K": {"d1": 1}, "u_U": {"d2": 1}, "y_U": "u_U + e",
            "y": {"u_K": ([0, 1.0], [1, -0.5]), "u_U": ([0, -0.7], [1]), "tau": 1},
        },
        {"d1": 1.0, "d2": 0.6, "e": 0.4, "tau": 0.2},
    )  # fmt: skip
    orders = Orders(nb=1, nf={"u_K": 1, "u_U": 0})
    truth = {"b1[u_K]": 1.0, "f1[u_K]": -0.5, "b1[u_U]": -0.7}
    compared = compare_module_remedies(
        system, "y", ["u_K", "u_U"], "u_U", orders, truth, measured={"u_U": "y_U"}
    )
    assert compared["neglect, PEM"].bias("b1[u_K]") == pytest.approx(0, abs=1e-8)  # independent
    measured = compared["measure y_U, PEM"]
    assert measured["b1[u_U]"] == pytest.approx(-0.7 * 0.6 / (0.6 + 0.4), abs=1e-7)
    assert measured.residual_variance == pytest.approx(0.2 + 0.49 * 0.6 * 0.4 / 1.0)
    known, neglected = (compared[n].variance("b1[u_K]") for n in ("all inputs known, PEM",
                                                                 "neglect, PEM"))  # fmt: skip
    assert neglected / known == pytest.approx((0.2 + 0.49 * 0.6) / 0.2, rel=1e-6)
    assert "worth measuring" in compared.cost_of_neglecting("b1[u_K]")


def test_an_own_remedy_stands_beside_the_others() -> None:
    system = signals().at(VALUES | {"a1": 0.5, "a2": 1.2})
    own = Remedy("IV with delta1 alone", "own", Regression("y_O", {"bK": "u_K"}, ["delta1"]))
    compared = compare_remedies(
        system, "y_O", BOTH, "u_U", {"bK": 1.3, "bU": -0.8}, extra=[own], explain=[]
    )
    assert compared["IV with delta1 alone"]["bK"] == pytest.approx(1.3 - 0.7 * 0.8)


def test_several_inputs_behind_several_sensors_are_recovered_by_the_left_inverse() -> None:
    system = LinearSignals.of(
        {"y": "2*u1 - u2 + 0.5*uK + v", "s1": "u1 + u2 + n1", "s2": "u1 - u2 + n2", "s3": "u1"},
        {"u1": 1, "u2": 1, "uK": 1, "v": 0.1, "n1": 0, "n2": 0},
    )
    measured = InputMeasurement(["s1", "s2"], ["u1", "u2"], [[1, 1], [1, -1]])
    compared = compare_remedies(
        system, "y", {"bK": "uK", "b1": "u1", "b2": "u2"}, ["u1", "u2"],
        {"bK": 0.5, "b1": 2, "b2": -1}, measured=measured,
    )  # fmt: skip
    found = compared["measure u1 recovered, u2 recovered, LS"]
    np.testing.assert_allclose(found.limit, [0.5, 2.0, -1.0], atol=1e-12)


def test_an_input_without_a_sensor_is_neglected_beside_one_that_has_one() -> None:
    """u2 is left out, and drives nothing else: no bias, its power is noise."""
    system = LinearSignals.of(
        {"y": "2*u1 - u2 + 0.5*uK + v", "s1": "u1"}, {"u1": 1, "u2": 3, "uK": 2, "v": 0.5}
    )
    compared = compare_remedies(
        system, "y", {"bK": "uK", "b1": "u1", "b2": "u2"}, ["u1", "u2"],
        {"bK": 0.5, "b1": 2, "b2": -1}, measured={"u1": "s1"},
    )  # fmt: skip
    found = compared["measure s1 and neglect u2, LS"]
    np.testing.assert_allclose(found.limit, [0.5, 2.0], atol=1e-12)
    np.testing.assert_allclose(np.diag(found.covariance), [3.5 / 2, 3.5], rtol=1e-12)
    assert compared.best("b2") is None


# -- the decision map ----------------------------------------------------------------------------


def unit_map(points: int = 61) -> tuple[np.ndarray, np.ndarray, DecisionMap]:
    system = signals().at({"beta": 0, "lu": 0})
    eiv = regression_limit(
        system, Regression("y_O", {"bK": "u_K", "bU": "y_U"}), TRUTH, method="measuring"
    )
    neglect = regression_limit(
        system, Regression("y_O", {"bK": "u_K"}), {"bK": "bK"}, method="neglecting"
    )
    x, y = np.linspace(0.05, 2.5, points), np.linspace(0.02, 10, points)
    values = dict(alpha=1, l1=1, lO=1, bU=1, bK=0)
    return x, y, decision_map(eiv, neglect, "bK", ("l2", x), ("le", y), values)


def test_figure_3_5_has_the_boundaries_of_3_59() -> None:
    """Variance: le = (s^3 - s)/(1 + s - s^2) between 1 and 1.618; AMSE: s = 0.618 for every le."""
    x, y, drawn = unit_map()
    X, Y = np.meshgrid(x, y)
    np.testing.assert_array_equal(drawn.variance < 0, X - X**3 + Y * (1 + X - X**2) < 0)
    np.testing.assert_array_equal(drawn.amse < 0, X > (math.sqrt(5) - 1) / 2)
    assert set(np.unique(drawn.regions)) == {0, 2, 3}  # never in variance alone
    assert REGIONS[3] == "in both"
    unit = dict(alpha=1.0, l1=1.0, lO=1.0, bU=1.0)
    inside = x[(x > 1.02) & (x < 1.6)]
    boundary = np.array([variance_boundary(v, unit) for v in inside])
    np.testing.assert_allclose(boundary, (inside**3 - inside) / (1 + inside - inside**2))


def test_the_map_is_drawn_with_its_boundaries_and_labels() -> None:
    x, _, drawn = unit_map(21)
    figure = drawn.plot({"(3.58)": (x, x)})
    assert [t.type for t in figure.data] == ["heatmap", "contour", "contour", "scatter"]
    assert figure.layout.xaxis.title.text == "l2"
    assert "measuring" in figure.layout.meta["caption"]


def test_a_map_without_all_numbers_says_which_are_missing() -> None:
    system = signals().at({"beta": 0})
    one = regression_limit(system, Regression("y_O", {"bK": "u_K"}), {"bK": "bK"})
    two = regression_limit(system, Regression("y_O", BOTH), TRUTH)
    grid = np.linspace(0.1, 1, 3)
    with pytest.raises(ModelError, match=r"no value of alpha, .*; give values=\{\.\.\}"):
        decision_map(one, two, "bK", ("l2", grid), ("lO", grid), {"l1": 1})
    with pytest.raises(ModelError, match="le is no symbol of these estimators of bK"):
        decision_map(one, two, "bK", ("l2", grid), ("le", grid))
