"""Two causes are told apart by the angle of their signatures, and that angle has a price.

The statistics behind the price are drawn here by hand: whitened residuals in the plane that two
signatures span (Vuong 1989 for alternatives that are not nested).
"""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from casid.diagnosis.advice.isolability import (
    isolability,
    likeness,
    separation_constant,
    separation_energy,
)
from casid.diagnosis.thresholds import PLANNING
from casid.errors import DataError
from casid.model.declarations import Parameter
from casid.model.effects.effect import Effect


def effect(kind: str, *, sided: str = "both", cost: int = 1) -> Effect:
    p = Parameter("size", "1", 0.0)
    return Effect(kind, "torque", (p,), lambda m, n: None, sided=sided, cost=cost)


def table(effects: list[Effect], signatures: np.ndarray, visible: list[float] | None = None):
    """What `isolability` reads of a score table, of signatures given as columns."""
    unit = signatures / np.linalg.norm(signatures, axis=0)
    shares = visible or [1.0] * len(effects)
    scores = tuple(
        SimpleNamespace(effect=e, energy=float(s @ s), unrobust=1.0 + i, visible=v)
        for i, (e, s, v) in enumerate(zip(effects, signatures.T, shares, strict=True))
    )
    return SimpleNamespace(scores=scores, cosines=unit.T @ unit)


def drawn_wins(energy: float, cosine: float, margin: float, n: int = 40_000) -> float:
    """Share of residuals in which the first of two causes, at work, wins by the margin."""
    rng = np.random.default_rng(5)
    e = rng.standard_normal((n, 2)) + np.sqrt(energy) * np.array([1.0, 0.0])
    b = np.array([cosine, np.sqrt(1 - cosine**2)])
    return float(np.mean(e[:, 0] ** 2 - (e @ b) ** 2 > margin))


def win_probability(energy: float, cosine: float) -> float:
    """Probability that D of (2) exceeds the margin, without the approximations of (3).

    The product of two independent normals is integrated over one of them.
    """
    scale = 2 * np.sqrt(1 - cosine * cosine)
    means = np.sqrt(energy * (1 + cosine) / 2), np.sqrt(energy * (1 - cosine) / 2)
    # Of the two factors, integrate over the one further from zero.
    far, near = max(means), min(means)
    s = far + np.linspace(-9, 9, 4001)
    s = s[np.abs(s) > 1e-9]
    limit = PLANNING.margin / scale / s
    tail = np.where(s > 0, norm.sf(limit - near), norm.cdf(limit - near))
    weight = norm.pdf(s - far)
    return float(np.sum(tail * weight) / np.sum(weight))


def exact_separation_energy(cosine: float) -> float:
    """As `separation_energy`, from `win_probability`."""
    about = separation_energy(cosine)

    def excess(logarithm: float) -> float:
        return win_probability(float(np.exp(logarithm)), cosine) - PLANNING.power

    return float(np.exp(brentq(excess, np.log(0.05 * about), np.log(20 * about), xtol=1e-4)))


def test_the_constant_is_that_of_the_margin_and_the_power():
    """x^2 - 2 z x - m = 0 at x^2 = the constant; m = 0 gives the 4 z^2 = 10.8 of coming first."""
    x = np.sqrt(separation_constant())
    assert x**2 - 2 * 1.6448536 * x - PLANNING.margin == pytest.approx(0, abs=1e-6)
    assert separation_constant(margin=0) == pytest.approx(4 * 1.6448536**2, rel=1e-6)
    assert separation_constant() == pytest.approx(21.12, abs=0.01)


@pytest.mark.parametrize("cosine", [0.0, -0.5, 0.9, 0.99])
def test_at_the_predicted_energy_the_right_cause_wins_as_often_as_asked(cosine):
    """The normal approximation leaves out a skewness that helps: a little more than 95 % win."""
    share = drawn_wins(separation_energy(cosine), cosine, PLANNING.margin)
    standard_error = np.sqrt(PLANNING.power * (1 - PLANNING.power) / 40_000)
    assert PLANNING.power - 3 * standard_error < share < PLANNING.power + 0.03


@pytest.mark.parametrize(("energy", "cosine"), [(5.0, 0.3), (20.0, 0.0), (300.0, 0.95)])
def test_the_probability_to_win_is_that_of_drawn_residuals(energy, cosine):
    drawn = drawn_wins(energy, cosine, PLANNING.margin)
    # Four binomial standard errors of 40 000 draws, at most 0.01.
    assert win_probability(energy, cosine) == pytest.approx(drawn, abs=0.01)


@pytest.mark.parametrize("cosine", [0.0, 0.7, 0.97])
def test_the_closed_form_is_near_the_exact_energy_and_on_the_safe_side(cosine):
    exact = exact_separation_energy(cosine)
    assert exact <= separation_energy(cosine) <= 1.15 * exact


def test_causes_of_one_signature_are_never_separated():
    assert separation_energy(1.0) == np.inf
    assert separation_energy(-1.0) == np.inf


@pytest.mark.parametrize(("margin", "power"), [(-1.0, 0.95), (6.0, 0.3), (6.0, 1.0)])
def test_a_margin_or_power_without_sense_is_refused(margin, power):
    with pytest.raises(DataError, match="give a margin of 0 or more"):
        separation_constant(margin=margin, power=power)


def test_a_one_sided_cause_does_not_imitate_the_opposite_of_another():
    """Friction of negative size is none: it takes nothing from damping that it opposes."""
    one, other, any_sign = effect("a", sided="positive"), effect("b", sided="positive"), effect("c")
    assert likeness(one, other, -0.8) == 0.0
    assert likeness(one, other, 0.8) == 0.8
    assert likeness(one, any_sign, -0.8) == -0.8


def test_pairs_stand_by_their_angle_and_equals_in_one_group():
    a, b = np.array([1.0, 0, 0]), np.array([0.0, 1, 0])
    signatures = np.column_stack([a, b, a + 0.02 * b, a + b, b])
    names = ["a", "b", "nearly a", "between", "hidden"]
    found = isolability(table([effect(n) for n in names], signatures, [1.0, 1.0, 1.0, 1.0, 1e-9]))
    assert found.undetectable == (("hidden", "torque"),)
    assert found.groups == ((("a", "torque"), ("nearly a", "torque")),)
    first = found.pairs[0]
    assert {first.first[0], first.second[0]} == {"a", "nearly a"}
    assert first.cosine == pytest.approx(1 / np.sqrt(1 + 0.02**2))
    # 45 degrees: cos^2 = 1/2 doubles what a right angle costs.
    between = next(p for p in found.of(("between", "torque")) if "a" in (p.first[0], p.second[0]))
    assert between.energy == pytest.approx(2 * separation_constant())
    last = found.pairs[-1]
    assert last.energy == pytest.approx(separation_constant())
    assert len(found.pairs) == 6


def test_the_file_lists_pairs_that_a_rival_makes_dearer_and_every_cosine():
    angles = np.deg2rad([0.0, 45.0, 90.0])
    found = isolability(
        table([effect(n) for n in "abc"], np.array([np.cos(angles), np.sin(angles)]))
    )
    written = found.to_json()
    assert [{*p["first"], *p["second"]} - {"torque"} for p in written["pairs"]] == [
        {"a", "b"},
        {"b", "c"},
    ]
    assert np.allclose(written["cosines"], found.cosines, atol=1e-6)


def test_causes_are_called_by_the_law_of_their_balance():
    """In lists of what acts alike, too, a voltage is no dry friction."""
    law = "a constant voltage that opposes i, as a brush drop does"
    dead = replace(effect("coulomb_friction"), where="coil", description=law)
    found = isolability(table([dead, effect("offset")], np.ones((5, 2))))
    words = "constant voltage that opposes i in the coil balance"
    assert found.words(dead.key) == words
    assert f"nearly alike: {words}, constant term in the torque balance" in str(found)


def test_the_dearer_cause_has_to_win_by_what_it_is_charged_for():
    """A jump costs as much as three parameters: 2 log N more (BIC)."""
    jump, plain = effect("jump", cost=3), effect("plain")
    t = table([jump, plain], np.eye(2))
    found = isolability(t, n_samples=1000)
    assert found.pairs[0].energy == pytest.approx(
        separation_constant(margin=PLANNING.margin + 2 * np.log(1000))
    )


def test_the_strongest_variant_stands_for_its_kind():
    signatures = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])
    found = isolability(table([effect("a"), effect("a"), effect("b")], signatures))
    assert found.keys == (("a", "torque"), ("b", "torque"))
    # The second variant scored more: [0, 1] against [1, 1].
    assert found.pairs[0].cosine == pytest.approx(np.sqrt(0.5))


def test_asking_for_a_cause_that_was_not_compared_names_those_that_were():
    found = isolability(table([effect("a"), effect("b")], np.eye(2)))
    with pytest.raises(DataError, match="request one of these: a in torque, b in torque"):
        found.of(("c", "torque"))


def test_the_numbers_are_plain_and_the_table_names_the_closest_pair():
    same = np.array([[1.0, -1.0, 0.5], [0.0, 0.0, 1.0]])
    found = isolability(table([effect("a"), effect("b"), effect("c")], same))
    plain = json.loads(json.dumps(found.to_json()))
    assert plain["pairs"][0]["energy"] is None  # never
    assert plain["groups"] == [[["a", "torque"], ["b", "torque"]]]
    lines = str(found).splitlines()
    assert all(word in lines[2] for word in ("a in torque", "b in torque", "never"))


def test_the_map_shows_every_cosine_with_those_alike_side_by_side():
    a, b = np.array([1.0, 0, 0]), np.array([0.0, 1, 0])
    signatures = np.column_stack([a, b, a + 0.1 * b, b + 0.1 * a])
    found = isolability(table([effect(n) for n in ("a", "b", "like a", "like b")], signatures))
    figure = found.plot()
    heat = figure.data[0]
    shown = [row[0][0].partition(" in ")[0] for row in heat.customdata]
    assert abs(shown.index("a") - shown.index("like a")) == 1
    i, j = shown.index("a"), shown.index("like b")
    assert heat.z[i][j] == pytest.approx(0.1 / np.sqrt(1.01))
    # Columns carry numbers alone, so that the map fits a telephone.
    assert list(figure.layout.xaxis.ticktext) == ["1", "2", "3", "4"]
    assert "nearly alike" in figure.layout.meta["caption"]


def test_a_record_that_shows_nothing_has_no_map():
    hidden = table([effect("a")], np.ones((2, 1)), [0.0])
    with pytest.raises(ValueError, match="no cause is visible"):
        isolability(hidden).plot()
