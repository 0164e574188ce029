"""The extended model that is reported ends at its minimum, those that were compared next to it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import casid
from casid.diagnosis.attempts import Attempts
from casid.diagnosis.search.adoption.refinement import Adoption
from casid.diagnosis.search.findings import _LastSteps
from casid.diagnosis.settings import DiagnosisSettings
from casid.diagnosis.solvers import SETTLED
from casid.estimation.simulation.fit import fit_model

TS, N = 0.05, 400


def record() -> casid.Record:
    """Displacements of a mass on a spring under a force, by scipy."""
    t = TS * np.arange(N)
    force = 3.0 * np.sin(1.3 * t) + 2.0 * np.sin(2.9 * t)

    def rate(at: float, z: np.ndarray) -> list[float]:
        return [z[1], float(np.interp(at, t, force)) - 9.0 * z[0] - 0.5 * z[1]]

    solved = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=TS)
    x = solved.y[0] + 2e-3 * np.random.default_rng(4).normal(size=N)
    return casid.Record({"F": force, "x_m": x}, {"F": "N", "x_m": "m"}, Ts=TS)


def spring() -> casid.Model:
    m = casid.Model("spring")
    x, v = m.state("x", "m"), m.state("v", "m/s")
    F = m.input("F", "N", hold="foh", known=True)
    d = m.parameter("d", "N s/m", start=0.4, lower=0.0)
    k = m.parameter("k", "N/m", start=10.0, lower=0.0)
    m.derivative(x, v)
    m.balance(v, "force", inertia=m.constant("M", 1.0, "kg"), terms=[F, -d * v, -k * x])
    m.output("x_m", x, "m")
    return m


@pytest.mark.parametrize("enough", [1e-2, SETTLED.enough])
def test_a_fit_that_was_near_enough_for_comparisons_is_continued_to_its_minimum(
    enough: float,
) -> None:
    settings = DiagnosisSettings(budget=60.0)
    near = replace(settings.refit, solver=replace(SETTLED, enough=enough))
    fit = fit_model(spring(), [casid.Experiment(record(), {}, "r")], near, throw=False)
    steps = _LastSteps(SimpleNamespace(attempts=Attempts()), None, settings, lambda _: True)
    found = steps.at_minimum(Adoption((), None, fit)).fit
    assert found.solution.is_converged
    assert found.solution.value <= fit.solution.value
    assert (found is fit) == fit.solution.is_converged
    assert fit.solution.is_converged == (enough < 1e-2)
