"""Where noise on an input is most of what least squares leaves, the estimate is found all the same.

The truth is `driven_shaft`: a wind with noise of a third of its motion, whose simulation wanders by
a hundred times the noise of the speeds.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import casid
from casid.estimation.errors_in_variables.equations import _K
from casid.estimation.errors_in_variables.input_noise import input_noise
from casid.estimation.errors_in_variables.removal import Corrected, without_input_noise
from casid.estimation.errors_in_variables.total_least_squares import total_least_squares
from casid.estimation.simulation.fit import FitSettings, fit_model, resolved_under
from casid.estimation.simulation.minimization import Fit
from casid.estimation.simulation.simulation_error import SimulationError
from tests.support.driven_shaft import TRUTH, shaft_model, shaft_record

ASTRAY = 2
"""A record whose least squares ends at a bound, with a third of the shaft's stiffness."""


@cache
def least_squares(seed: int) -> Fit:
    data = [casid.Experiment(shaft_record(seed), {}, "r")]
    return fit_model(shaft_model(), data, FitSettings(starts=1), throw=False)


def declared(criterion: SimulationError) -> np.ndarray:
    return np.array([v.start for v in criterion.variables])


def standard_errors(found: Corrected) -> dict[str, float]:
    assert found.covariance is not None, found.why_not
    return dict(zip(found.fit.criterion.names, np.sqrt(np.diag(found.covariance)), strict=True))


def test_the_root_is_found_where_least_squares_ends_at_a_bound() -> None:
    fit = least_squares(ASTRAY)
    assert "J2" in fit.solution.at_lower
    found = without_input_noise(fit, {})
    errors = standard_errors(found)
    assert not found.fit.solution.at_lower
    for name, value in TRUTH.items():
        assert abs(found.fit.values[name] - value) < 4.0 * errors[name]


def test_an_estimate_is_given_though_least_squares_has_no_minimum_to_converge_to() -> None:
    assert not least_squares(ASTRAY).solution.is_converged
    estimate = casid.identify(shaft_model(), shaft_record(ASTRAY), intervals="quick")
    assert estimate.is_converged
    assert estimate["k"] == pytest.approx(TRUTH["k"], rel=0.05)


def test_total_least_squares_leads_from_afar_next_to_the_truth() -> None:
    """From a tenth and from ten times the stiffness alike, up to what its noise allows."""
    c = least_squares(ASTRAY).criterion
    ends = []
    for times in (0.1, 10.0):
        x = declared(c)
        x[c.names.index("k")] *= times
        noise = input_noise(c, x, {})
        found = total_least_squares(c, [x], noise.noise.quiet(noise.sd))
        assert found is not None
        ends.append(dict(zip(c.names, found.tolist(), strict=True)))
    for end in ends:
        assert end["k"] == pytest.approx(TRUTH["k"], rel=0.1)
        assert end["J1"] == pytest.approx(TRUTH["J1"], rel=0.2)


def test_next_to_the_root_there_is_nowhere_better_to_begin() -> None:
    found = without_input_noise(least_squares(0), {})
    assert found.noise is not None
    assert total_least_squares(found.fit.criterion, [found.fit.x], found.noise) is None


def test_noise_on_the_inputs_that_adds_next_to_nothing_has_led_nowhere() -> None:
    """The stiffness is a tenth, and the wind is measured a thousand times as well as it is."""
    c = least_squares(ASTRAY).criterion
    x = declared(c)
    x[c.names.index("k")] *= 0.1
    sd = input_noise(c, x, {}).sd["V"] / 1000.0
    noise = input_noise(c, x, {"V": sd})
    assert total_least_squares(c, [x], noise.noise.quiet(noise.sd)) is None


def test_without_noise_on_the_inputs_there_is_none() -> None:
    c = least_squares(0).criterion
    noise = input_noise(c, declared(c), {"V": 0.0})
    assert total_least_squares(c, [declared(c)], noise.noise.quiet(noise.sd)) is None


def test_steps_are_as_fine_as_the_weights_of_the_noise_need() -> None:
    """Beside what the wind's noise leaves, steps too long for the shaft's resonance do not show."""
    fit = least_squares(1)
    found = without_input_noise(fit, {})
    assert found.noise is not None
    fine = found.fit.criterion
    assert fine.substeps > fit.criterion.substeps
    assert resolved_under(fine, found.fit.x, found.noise.whiten) is fine


def test_a_mean_over_neighbouring_frequencies_keeps_what_noise_gives_to_the_equations() -> None:
    """For a white residual that is the trace of K; the scatter of one draw is what it takes."""
    rng = np.random.default_rng(1)
    turned, passed = (
        rng.standard_normal((200, 2, *more)) + 1j * rng.standard_normal((200, 2, *more))
        for more in ((3,), ())
    )
    alone, mean = (_K([turned], [passed], lines) for lines in (1, 25))
    trace = [np.einsum("fana->n", K).real for K in (alone, mean)]
    assert trace[1] == pytest.approx(trace[0], rel=0.2)
    assert np.sum(np.abs(mean) ** 2) == pytest.approx(np.sum(np.abs(alone) ** 2) / 25, rel=0.3)


def test_a_state_that_a_record_begins_in_decides_nothing_about_its_noise() -> None:
    """A likelihood with initial states beside it is the same from whichever of them."""
    c = least_squares(0).criterion
    x = least_squares(0).x
    noise = input_noise(c, x, {}).noise
    at = c.simulated(x, 0)
    states = at.jacobian[:, :, [c.names.index(f"{n}(0)") for n in c.model.states]]
    moved = at.residual + states @ np.array([3.0, -2.0, 0.5])
    values = [noise.minus_log_likelihood([r], [states]) for r in (at.residual, moved)]
    assert values[1] == pytest.approx(values[0], abs=1e-4)
    assert noise.minus_log_likelihood([moved]) > noise.minus_log_likelihood([at.residual]) + 100.0
