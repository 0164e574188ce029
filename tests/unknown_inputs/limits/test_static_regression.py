"""What an unknown input does to the estimates of a static system: Linder (2017), chapter 3.

Every closed form of the thesis, corrected, against the general machinery in letters, and against
a Monte Carlo in plain numpy that shares no code with it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
import pytest
import sympy as sp
from numpy.typing import NDArray

from analysis.static_examples.formulas import (
    FORMS,
    ClosedForm,
    a1,
    a2,
    alpha,
    bK,
    bU,
    l1,
    le,
    lO,
    lu,
    s,
)  # fmt: skip
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.linear_signals import LinearSignals
from casid.unknown_inputs.limits.regression import FirstStage, Regression
from casid.unknown_inputs.limits.regression_limit import regression_limit
from problems.static_input import signals

Array = NDArray[np.float64]
SAMPLE = dict(
    alpha=0.7, beta=0.4, bK=1.3, bU=-0.8, l1=1.2, l2=0.6, lu=0.5, lO=0.3, le=0.4, a1=0.5, a2=1.2
)
TRUTH = {"bK": "bK", "bU": "bU"}
SYSTEM = signals().with_signals({"delta1 + delta2": "delta1 + delta2"})


def by_example(name: str) -> ClosedForm:
    return next(f for f in FORMS if f.example == name)


@functools.cache
def _in_letters(example: str) -> Asymptotics:
    form = by_example(example)
    system = SYSTEM.at(form.special) if form.special else SYSTEM
    truth = {n: v for n, v in TRUTH.items() if n in form.regression.regressors}
    return regression_limit(system, form.regression, truth)


def in_letters(form: ClosedForm) -> Asymptotics:
    return _in_letters(form.example)


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f"{f.example} {f.equations}")
def test_the_closed_form_of_the_thesis_is_what_the_machinery_says(form: ClosedForm) -> None:
    found = in_letters(form)
    put = {sp.Symbol(k): v for k, v in form.special.items()}
    for name, expected in form.limit.items():
        assert sp.simplify((found[name] - expected).subs(put)) == 0
    for (one, other), expected in form.covariance.items():
        i, j = found.names.index(one), found.names.index(other)
        assert sp.simplify(sp.sympify(found.covariance[i, j] - expected).subs(put)) == 0


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f.example)
def test_numbers_and_letters_agree(form: ClosedForm) -> None:
    """The floats of a numeric system against the formula with the same numbers put in."""
    sample = SAMPLE | form.special
    by_formula = in_letters(form).at({k: v for k, v in sample.items() if k not in form.special})
    by_number = regression_limit(SYSTEM.at(sample), form.regression)
    np.testing.assert_allclose(by_number.limit, by_formula.limit.astype(float), rtol=1e-11)
    np.testing.assert_allclose(
        by_number.covariance, by_formula.covariance.astype(float), rtol=1e-9, atol=1e-12
    )


def test_the_numeric_sample_of_the_thesis_digest() -> None:
    neglected = regression_limit(SYSTEM.at(SAMPLE), Regression("y_O", {"bK": "u_K"}))
    assert neglected["bK"] == pytest.approx(0.65, abs=1e-12)  # (3.17)
    assert neglected.variance("bK") == pytest.approx(0.655875, abs=1e-12)  # (3.18)
    flat = SAMPLE | {"beta": 0}

    def variances(example: str) -> Array:
        form = by_example(example)
        found = regression_limit(SYSTEM.at(flat), form.regression)
        return np.asarray(np.diag(found.covariance), dtype=float)

    eiv = variances("3.9 errors in variables, LS")
    np.testing.assert_allclose(eiv, [0.565771, 0.325156], atol=1e-6)
    np.testing.assert_allclose(
        variances("3.10 errors in variables, IV"), [0.9174, 0.926667], atol=1e-6
    )
    known = variances("3.8 two stages, first known, beta = 0")
    estimated = variances("3.8 two stages, first estimated, beta = 0")
    assert known[0] == pytest.approx(1.0230, abs=1e-6)
    assert estimated[0] == pytest.approx(0.9174, abs=1e-6)


# -- what the formulas say -----------------------------------------------------------------------


@functools.cache
def neglecting() -> Asymptotics:
    form = by_example("3.3 neglect, LS")
    return regression_limit(SYSTEM.at({"beta": 0}), form.regression, {"bK": "bK"})


def errors_in_variables() -> Asymptotics:
    return in_letters(by_example("3.9 errors in variables, LS"))


def test_including_an_input_costs_variance_where_its_own_part_is_small() -> None:
    """P(3.3) > P(3.1) if and only if bU^2 (l2 + lu)^2 > alpha^2 lO l1 (Example 3.3, beta = 0)."""
    known = in_letters(by_example("3.1 both inputs known, beta = 0"))
    gain = sp.factor(neglecting().variance("bK") - known.variance("bK"))
    assert sp.simplify(gain * l1 * s - (bU**2 * s**2 - alpha**2 * lO * l1)) == 0


def test_a_measurement_beats_neglect_in_variance_as_3_58_says_with_l2_plus_lu() -> None:
    """(3.58) with s = l2 + lu: C1 s - C2 s^3 + le (C1 + C3 s - C2 s^2) < 0."""
    C1, C2, C3 = alpha**2 * lO * l1, bU**2, alpha**2 * bU**2 * l1
    criterion = C1 * s - C2 * s**3 + le * (C1 + C3 * s - C2 * s**2)
    difference = errors_in_variables().variance("bK") - neglecting().variance("bK")
    assert sp.simplify(difference - criterion / (l1 * (s + le) ** 2)) == 0


def unit_benchmark(value: float, noise: float) -> tuple[Asymptotics, Asymptotics]:
    """EIV and neglect for alpha = l1 = lO = bU = 1, l2 + lu = value, le = noise."""
    numbers = dict(alpha=1, bU=1, bK=1, l1=1, lO=1, l2=value / 2, lu=value / 2, le=noise)
    return errors_in_variables().at(numbers), neglecting().at(numbers)


@pytest.mark.parametrize("noise", [0.01, 1.0, 100.0, 1e6])
def test_a_measurement_however_noisy_lowers_the_variance_above_the_golden_ratio(
    noise: float,
) -> None:
    """(3.59): true for every le when s > (1 + sqrt 5)/2, and not for every le below."""
    golden = (1 + math.sqrt(5)) / 2
    eiv, neglect = unit_benchmark(golden * 1.001, noise)
    assert eiv.variance("bK") < neglect.variance("bK")
    eiv, neglect = unit_benchmark(golden * 0.999, 1e6)
    assert eiv.variance("bK") > neglect.variance("bK")


@pytest.mark.parametrize("noise", [0.01, 1.0, 100.0])
def test_a_measurement_lowers_the_amse_exactly_above_0_618_whatever_its_noise(
    noise: float,
) -> None:
    small = (math.sqrt(5) - 1) / 2
    for value, is_better in ((small * 1.001, True), (small * 0.999, False)):
        eiv, neglect = unit_benchmark(value, noise)
        assert (eiv.amse("bK") < neglect.amse("bK")) is is_better


def test_the_amse_difference_is_exactly_minus_s2_plus_s_minus_1_over_s_plus_le() -> None:
    put = {alpha: 1, bU: 1, l1: 1, lO: 1}
    difference = (errors_in_variables().amse("bK") - neglecting().amse("bK")).subs(put)
    assert sp.simplify(difference + (s**2 + s - 1) / (s + le)) == 0


def test_estimating_the_first_stage_puts_the_sensor_noise_where_the_unknown_excitation_was() -> (
    None
):
    """E-4: known gamma gives lO + bU^2 lu, estimated lO + bU^2 le, smaller or larger."""
    known = in_letters(by_example("3.8 two stages, first known, beta = 0"))
    estimated = in_letters(by_example("3.8 two stages, first estimated, beta = 0"))
    instruments = in_letters(by_example("3.10 errors in variables, IV"))
    ratio = sp.simplify(estimated.variance("bK") / known.variance("bK"))
    assert sp.simplify(ratio - (lO + bU**2 * le) / (lO + bU**2 * lu)) == 0
    assert sp.simplify(estimated.variance("bK") - instruments.variance("bK").subs({"beta": 0})) == 0


def test_instruments_use_nothing_of_what_nobody_commands() -> None:
    """(3.63) holds for every beta and holds no lu: tau_u gives no information."""
    found = in_letters(by_example("3.10 errors in variables, IV"))
    assert lu not in found.variance("bK").free_symbols
    assert sp.Symbol("beta") not in found.variance("bK").free_symbols


def test_a_noisy_copy_of_an_instrument_adds_nothing_to_it() -> None:
    """Two-stage least squares on three instruments projects on the two that are exact."""
    system = SYSTEM.at(SAMPLE)
    with_copy = LinearSignals.of(
        {
            "u_K": "d1 + 0.4*tu", "u_U": "0.7*d1 + d2 + tu", "y_U": "u_U + e",
            "y_O": "1.3*u_K - 0.8*u_U + tO", "copy": "d1 + n",
        },
        {"d1": 1.2, "d2": 0.6, "tu": 0.5, "tO": 0.3, "e": 0.4, "n": 0.2},
    )  # fmt: skip
    exact = regression_limit(
        system, Regression("y_O", {"bK": "u_K", "bU": "y_U"}, ["delta1", "delta2"])
    )
    more = regression_limit(
        with_copy, Regression("y_O", {"bK": "u_K", "bU": "y_U"}, ["d1", "copy", "d2"])
    )
    np.testing.assert_allclose(more.limit, exact.limit, rtol=1e-12)
    np.testing.assert_allclose(more.covariance, exact.covariance, rtol=1e-12)


def test_example_4_2_with_known_gains_is_examples_3_9_and_3_10() -> None:
    """(4.36): y_I - u_K stands for the unknown input as its measurement does, e = tau_I."""
    for way in (None, ["delta1", "delta2"]):
        system = SYSTEM if way else SYSTEM.at({"beta": 0})
        eliminated = regression_limit(
            system, Regression("y_O", {"bK": "u_K", "bU": "u_I"}, way), TRUTH
        )
        measured = regression_limit(
            system, Regression("y_O", {"bK": "u_K", "bU": "y_U"}, way), TRUTH
        )
        assert list(eliminated.limit) == list(measured.limit)
        assert (eliminated.covariance == measured.covariance).all()


def test_example_4_2_with_unknown_gains_tells_a_combination_alone() -> None:
    """y_I = aK u_K + aU u_U + e: instruments lead to bK - bU aK/aU and bU/aU, not to bK."""
    aK, aU = sp.symbols("aK aU")
    system = SYSTEM.with_signals({"y_A": "aK*u_K + aU*u_U + e_U"})
    found = regression_limit(
        system, Regression("y_O", {"bK": "u_K", "bU": "y_A"}, ["delta1", "delta2"]), {"bK": bK}
    )
    assert sp.simplify(found["bK"] - (bK - bU * aK / aU)) == 0
    assert sp.simplify(found["bU"] - bU / aU) == 0
    # Another system with the same limits: bK cannot be told.
    # bU' aK'/aU' = bU aK'/aU is bU aK/aU + bU/aU for aK' = aK + 1.
    twin = {bK: bK + bU / aU, bU: 2 * bU, aK: aK + 1, aU: 2 * aU}
    for name in ("bK", "bU"):
        moved = found[name].subs(twin, simultaneous=True)
        assert sp.simplify(moved - found[name]) == 0
    assert sp.simplify(found.bias("bK") + bU * aK / aU) == 0


def test_approximating_well_means_the_right_ratio_and_scale() -> None:
    """(3.29): no bias for a1/a2 = alpha and a2 = 1."""
    found = in_letters(by_example("3.5 approximate by a1 delta1 + a2 delta2"))
    assert sp.simplify(found.bias("bK").subs({a1: alpha * a2})) == 0
    assert sp.simplify(found.bias("bU").subs({a2: 1})) == 0
    assert sp.simplify(found["bK"] - bK - (alpha - a1 / a2) * bU) == 0


# -- Monte Carlo in plain numpy ------------------------------------------------------------------

RUNS, N = 1500, 300


def draws(v: dict[str, float]) -> dict[str, Array]:
    """(RUNS, N) samples of every signal; no code of casid."""
    rng = np.random.default_rng(36)
    d1, d2, tu, tO, e = (
        math.sqrt(v[k]) * rng.standard_normal((RUNS, N)) for k in ("l1", "l2", "lu", "lO", "le")
    )
    uK, uU = d1 + v["beta"] * tu, v["alpha"] * d1 + d2 + tu
    return {
        "delta1": d1, "delta2": d2, "u_K": uK, "u_U": uU, "y_U": uU + e,
        "y_O": v["bK"] * uK + v["bU"] * uU + tO, "u_hat": v["a1"] * d1 + v["a2"] * d2,
        "delta1 + delta2": d1 + d2, "u_I": uU + e,
    }  # fmt: skip


@pytest.fixture(scope="module")
def simulated() -> Callable[[float], dict[str, Array]]:
    made: dict[float, dict[str, Array]] = {}

    def of(beta: float) -> dict[str, Array]:
        if beta not in made:
            made[beta] = draws(SAMPLE | {"beta": beta})
        return made[beta]

    return of


def solved(y: Array, phi: list[Array], zeta: list[Array]) -> Array:
    """(RUNS, d) solutions of sum zeta (y - phi' theta) = 0 in each run."""
    Phi, Zeta = np.stack(phi, axis=1), np.stack(zeta, axis=1)
    left = Zeta @ np.swapaxes(Phi, 1, 2)
    return np.asarray(np.linalg.solve(left, Zeta @ y[:, :, None])[:, :, 0])


def estimated(r: Regression, data: dict[str, Array]) -> Array:
    """Every run's estimate, first stages included."""
    own = dict(data)
    for name, stage in r.generated.items():
        assert isinstance(stage, FirstStage)
        psi = [data[str(t)] for t in stage.known]
        gamma = solved(data[str(stage.measured)], psi, psi)
        if stage.is_known:
            gamma = np.tile([SAMPLE["alpha"], 1.0], (RUNS, 1))
        own[name] = sum(gamma[:, [i]] * p for i, p in enumerate(psi))
    phi = [own[str(t)] for t in r.regressors.values()]
    zeta = phi if r.instruments is None else [own[str(t)] for t in r.instruments]
    return solved(own[str(r.output)], phi, zeta)


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f.example)
def test_monte_carlo_has_the_limit_and_the_covariance(
    form: ClosedForm, simulated: Callable[[float], dict[str, Array]]
) -> None:
    """3.5 Monte Carlo standard errors: sd/sqrt(RUNS) of means, P sqrt(2/RUNS) of variances.

    Estimates from N samples differ from their limits by O(1/N) as well: bias and relative change
    of the covariance are a few 1/N, below a third of these tolerances.
    """
    sample = SAMPLE | form.special
    theory = regression_limit(SYSTEM.at(sample), form.regression)
    theta = estimated(form.regression, simulated(float(sample["beta"])))
    P = theory.covariance
    error = np.sqrt(np.diag(P) / N / RUNS)
    assert np.all(np.abs(theta.mean(axis=0) - theory.limit) < 3.5 * error + 1.0 / N**1.5)
    found = N * np.cov(theta.T).reshape(P.shape)
    spread = np.sqrt((np.outer(np.diag(P), np.diag(P)) + P**2) / RUNS)
    assert np.all(np.abs(found - P) < 3.5 * spread + 4.0 / N * np.sqrt(np.outer(*[np.diag(P)] * 2)))


ESTIMATED_STAGES = {
    "first stage complete": FirstStage("y_U", ["delta1", "delta2"]),
    "first stage lacks delta2": FirstStage("y_U", ["delta1 + delta2"]),
}


@pytest.mark.parametrize("case", ESTIMATED_STAGES)
def test_two_stages_that_are_biased_vary_as_both_stages_together_say(case: str) -> None:
    """beta = 1: tau_u moves u_K as well, so that the second residual is correlated with what the
    first stage is made of; both stages' errors and their correlation count."""
    sample = SAMPLE | {"beta": 1.0, "bU": -3.0, "le": 3.0, "lO": 0.05}
    regression = Regression(
        "y_O", {"bK": "u_K", "bU": "predicted"}, generated={"predicted": ESTIMATED_STAGES[case]}
    )
    theory = regression_limit(SYSTEM.at(sample), regression)
    some = {k: v for k, v in sample.items() if k not in ("l2", "le")}
    by_formula = regression_limit(SYSTEM.at(some), regression).at({"l2": 0.6, "le": 3.0})
    np.testing.assert_allclose(by_formula.covariance, theory.covariance, rtol=1e-9)
    theta = estimated(regression, draws(sample))
    P = np.diag(theory.covariance)
    assert np.all(np.abs(theta.mean(axis=0) - theory.limit) < 3.5 * np.sqrt(P / N / RUNS) + 2 / N)
    ratio = N * theta.var(axis=0, ddof=1) / P
    assert np.all(np.abs(ratio - 1) < 3.5 * math.sqrt(2 / RUNS) + 4 / N)


@pytest.mark.parametrize(
    ("kind", "excess"), [("binary", -2.0), ("uniform", -1.2), ("laplace", 3.0)]
)
def test_what_a_biased_estimate_varies_depends_on_the_kurtosis_of_the_externals(
    kind: str, excess: float
) -> None:
    """Neglecting an input that the known one drives: a binary reference leaves less variance."""
    rng = np.random.default_rng(5)
    runs, n = 4000, 200
    x = {
        "binary": lambda: rng.choice([-1.0, 1.0], (runs, n)),
        "uniform": lambda: rng.uniform(-math.sqrt(3), math.sqrt(3), (runs, n)),
        "laplace": lambda: rng.laplace(0, math.sqrt(0.5), (runs, n)),
    }[kind]()
    x = math.sqrt(2.5) * x
    w, e = rng.standard_normal((2, runs, n))
    u, y = x + w, 2 * x + 0.3 * e
    estimate = np.sum(u * y, axis=1) / np.sum(u * u, axis=1)
    system = LinearSignals.of(
        {"u": "x + w", "y": "2*x + 0.3*e"},
        {"x": 2.5, "w": 1, "e": 1},
        excess_kurtosis={"x": excess},
    )
    found = regression_limit(system, Regression("y", {"b": "u"}))
    gaussian = regression_limit(
        LinearSignals.of({"u": "x + w", "y": "2*x + 0.3*e"}, {"x": 2.5, "w": 1, "e": 1}),
        Regression("y", {"b": "u"}),
    )
    variance = found.variance("b")
    # With heavy tails the sample variance spreads more: its own fourth moment, not 2.
    spread = np.std((estimate - estimate.mean()) ** 2) * n / math.sqrt(runs)
    assert abs(n * estimate.var() - variance) < 3.5 * spread + 8.0 / n * variance
    assert (variance < gaussian.variance("b")) is (excess < 0)
    assert abs(variance - gaussian.variance("b")) > 4 * spread


def test_a_formula_is_told_in_letters_and_in_numbers() -> None:
    system, found = SYSTEM, neglecting()
    assert "in a1, a2, alpha" in repr(system)
    assert str(found["bK"]) == "alpha*bU + bK"
    text = str(found)
    assert "alpha*bU" in text
    assert "bU**2*l2" in text
    assert found.at(SAMPLE)["bK"] == pytest.approx(0.74)
