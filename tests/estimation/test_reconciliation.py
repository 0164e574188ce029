"""Readings that must satisfy equations: estimates, contradictions, and who is to blame."""

from __future__ import annotations

import numpy as np
import pytest

import casid
from casid.estimation.reconciliation import LEVEL, Reconciliation


def repeated(values: list[float], sds: list[float]) -> Reconciliation:
    """One unknown mass, read several times."""
    r = Reconciliation("scales")
    m = r.unknown("m", 1.0, "kg")
    for i, (value, sd) in enumerate(zip(values, sds, strict=True)):
        r.equation(f"reading {i}", r.reading(f"m{i}", value, sd, "kg") - m)
    return r


def test_readings_of_one_quantity_give_their_weighted_mean() -> None:
    values, sds = [2.0, 2.3, 1.9], [0.1, 0.2, 0.4]
    found = repeated(values, sds).solve()
    weight = 1 / np.square(sds)
    mean = weight @ values / weight.sum()
    assert found["m"] == pytest.approx(mean, rel=1e-12)
    assert found.std_error("m") == pytest.approx(weight.sum() ** -0.5, rel=1e-10)
    assert found.statistic == pytest.approx(weight @ np.square(values - mean), rel=1e-10)
    assert found.degrees == 2
    assert found.is_consistent
    assert not found.blamed
    low, high = found.interval("m")
    assert high - low == pytest.approx(2 * 1.959964 * found.std_error("m"), rel=1e-6)
    assert any("Baarda" in line for line in found.references())


def test_a_line_through_points_with_errors_in_both_is_the_orthogonal_one() -> None:
    """Equal errors in both coordinates: the line through the mean along the first principal axis.

    At angle a the slope is tan a with tan 2a = 2 S_xy / (S_xx - S_yy) (K. Pearson 1901).
    """
    rng = np.random.default_rng(1)
    x = np.linspace(0, 5, 8)
    px, py = x + 0.1 * rng.normal(size=8), 1 + 0.7 * x + 0.1 * rng.normal(size=8)
    r = Reconciliation("line")
    a, b = r.unknown("a", 0.0), r.unknown("b", 1.0)
    for i in range(8):
        qx, qy = r.reading(f"x{i}", px[i], 0.1), r.reading(f"y{i}", py[i], 0.1)
        r.equation(f"point {i}", qy - a - b * qx)
    found = r.solve()
    S = np.cov(px, py)
    angle = 0.5 * np.arctan2(2 * S[0, 1], S[0, 0] - S[1, 1])
    assert found["b"] == pytest.approx(np.tan(angle), rel=1e-8)
    assert found["a"] == pytest.approx(py.mean() - np.tan(angle) * px.mean(), rel=1e-8)
    # chi-squared: the smaller eigenvalue is the mean square distance from the line.
    assert found.statistic == pytest.approx(7 * np.linalg.eigvalsh(S)[0] / 0.01, rel=1e-8)


def test_what_is_derived_has_the_covariance_of_its_formula() -> None:
    r = Reconciliation("rectangle")
    a, b = r.reading("a", 2.0, 0.01, "m"), r.reading("b", 3.0, 0.02, "m")
    r.derived("area", a * b, 1.0, "m^2")
    r.derived("edge", a + b, 1.0, "m")
    found = r.solve()
    J, C = np.array([[3.0, 2.0], [1.0, 1.0]]), np.diag([1e-4, 4e-4])
    np.testing.assert_allclose(found.covariance_of(["area", "edge"]), J @ C @ J.T, rtol=1e-9)
    assert found["area"] == pytest.approx(6.0, rel=1e-12)
    assert found.degrees == 0
    assert found.is_consistent
    assert "nothing to test" in str(found)


def test_a_reading_that_contradicts_is_named_with_the_correction_that_reconciles() -> None:
    found = repeated([2.0, 2.01, 1.99, 3.0, 2.0], [0.01] * 5).solve()
    assert not found.is_consistent
    assert len(found.blamed) == 1
    assert found.blamed[0].alternatives == ("m3",)
    # Against the mean of the other four: errors 0.01 and 0.01 / 2.
    assert found.blamed[0].corrections[0] == pytest.approx(-1.0, rel=1e-8)
    error = 0.01 * np.sqrt(1 + 1 / 4)
    assert found.blamed[0].std_errors[0] == pytest.approx(error, rel=1e-8)
    assert "CONTRADICT" in str(found)
    assert "m3 (-1 +- 0.011 kg)" in str(found)
    assert "CONTRADICTORY" in repr(found)


def test_two_faults_are_both_found_and_corrected_together() -> None:
    found = repeated([2.0, 2.01, 1.99, 3.0, 2.0, 1.5, 2.0], [0.01] * 7).solve()
    blamed = {b.alternatives: b.corrections[0] for b in found.blamed}
    assert blamed == pytest.approx({("m3",): -1.0, ("m5",): 0.5}, rel=1e-8)


def test_readings_that_stand_in_one_equation_alone_share_the_blame() -> None:
    """a + b = c: whichever is wrong, nothing else tells."""
    r = Reconciliation("sum")
    a, b = r.reading("a", 1.0, 0.01, "kg"), r.reading("b", 2.0, 0.03, "kg")
    c = r.reading("c", 3.5, 0.02, "kg")
    r.equation("sum", a + b - c)
    found = r.solve()
    (blame,) = found.blamed
    assert set(blame.alternatives) == {"a", "b", "c"}
    corrections = dict(zip(blame.alternatives, blame.corrections, strict=True))
    assert corrections == pytest.approx({"a": 0.5, "b": 0.5, "c": -0.5}, rel=1e-8)


def test_good_readings_are_called_contradictory_as_seldom_as_promised() -> None:
    rng = np.random.default_rng(2)
    r = repeated([1.0, 1.0, 1.0, 1.0], [0.1, 0.2, 0.1, 0.3])
    runs, p = 300, []
    for _ in range(runs):
        e = rng.normal(size=4) * [0.1, 0.2, 0.1, 0.3]
        p.append(r.solve({f"m{i}": 1.0 + e[i] for i in range(4)}).p_value)
    # Uniform p-values: a share of 0.2 below 0.2, four standard deviations of a proportion.
    assert abs(np.mean(np.array(p) < 0.2) - 0.2) < 4 * np.sqrt(0.2 * 0.8 / runs)
    assert np.mean(np.array(p) < LEVEL) < LEVEL + 4 * np.sqrt(LEVEL / runs)


def test_what_is_not_determined_or_said_twice_is_refused_with_a_mend() -> None:
    r = Reconciliation("open")
    a, b = r.unknown("a", 1.0), r.unknown("b", 2.0)
    r.equation("product", r.reading("p", 2.0, 0.1) - a * b)
    with pytest.raises(
        casid.IdentifiabilityError, match=r"a and b are not separately .* known value"
    ):
        r.solve()
    twice = repeated([1.0, 1.1], [0.1, 0.1])
    m = twice.reading("again", 1.0, 0.0)
    with pytest.raises(casid.ModelError, match="'m0' is declared twice; give another name"):
        twice.reading("m0", 1.0, 0.1)
    with pytest.raises(casid.ModelError, match="'reading 0' is there twice; give another name"):
        twice.equation("reading 0", m)
    with pytest.raises(casid.ModelError, match="no reading 'm7'; there are m0, m1"):
        repeated([1.0, 1.1], [0.1, 0.1]).solve({"m7": 1.0})
    with pytest.raises(casid.DataError, match="not negative, or declare it unknown"):
        twice.reading("bad", 1.0, -0.1)
    with pytest.raises(casid.ModelError, match="no equation; state what"):
        Reconciliation("empty").solve()
    unread = Reconciliation("unread")
    unread.equation("itself", unread.unknown("a", 1.0) - 1)
    with pytest.raises(casid.ModelError, match="no reading; give what was read"):
        unread.solve()
    same = repeated([1.0, 1.1], [0.1, 0.1])
    x = same.reading("x", 0.0, 0.1)
    same.equation("x", x)
    same.equation("x once more", 2 * x)
    with pytest.raises(casid.ModelError, match="1 of the 4 equations follow from the others; drop"):
        same.solve()
    stray = Reconciliation("stray")
    y = stray.reading("y", 0.0, 0.1)
    stray.equation("other", y - Reconciliation("else").reading("z", 0.0, 0.1))
    with pytest.raises(casid.ModelError, match="neither reading nor unknown; use what"):
        stray.solve()
    found = repeated([1.0, 1.1], [0.1, 0.1]).solve()
    with pytest.raises(
        casid.ModelError, match="no quantity 'mm'; there are m, m0, m1; did you mean 'm'"
    ):
        found["mm"]
