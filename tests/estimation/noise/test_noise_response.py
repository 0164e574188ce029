"""The response of outputs to noise: of windows, of a motion that bends it, and its slopes."""

from __future__ import annotations

import warnings

import casadi as ca
import numpy as np
import pytest

import casid
from casid.errors import SolveError
from casid.estimation.noise import noise_response, resolving_steps
from casid.estimation.noise.model_spectra import ModelSpectra
from casid.estimation.noise.noise_response import Response, with_windowed_spectra
from casid.estimation.noise.source_spectra import SourceSpectra
from casid.estimation.noise.thresholds import Steps
from casid.estimation.noise.varying_steps import steps_along
from casid.estimation.noise.windowed_response import windowed_spectra
from casid.estimation.simulation.simulation_error import SimulationError


@pytest.mark.parametrize("size", [0.0, 1e-200, 1e-160, 1e-3, 1e200])
def test_spectra_of_windows_keep_the_phase_of_the_response_and_replace_its_magnitude(size):
    """|gain|^2 is the spectrum of the windows, also where the response itself is nought.

    The response of a whole record may vanish at frequencies at which windows, which end, have
    power; near parameters at which a model is unstable it is as small or as large as numbers are.
    """
    omega = np.array([0.5, 1.5])
    gain = np.full((2, 1, 1), size * np.exp(0.3j))
    own = Response(omega, np.minimum(np.abs(gain), 1e100) ** 2, ("u",), gain)
    spectrum = np.array([4.0, 1e-12]).reshape(2, 1, 1, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = with_windowed_spectra(own, spectrum.astype(complex))
    assert found.gain is not None
    assert np.abs(found.gain[:, 0, 0]) == pytest.approx([2.0, 1e-6])
    assert found.gain2[:, 0, 0] == pytest.approx([4.0, 1e-12])
    if size:
        assert np.angle(found.gain) == pytest.approx(0.3)


def spring(friction: float = 0.0) -> SimulationError:
    """A mass on a spring that hardens, 400 samples of a random force, eight steps a sample."""
    m = casid.Model("spring")
    q, v, F = m.state("q", "m"), m.state("v", "m/s"), m.input("F", "N")
    k, d = m.parameter("k", "1/s^2", start=30.0), m.parameter("d", "1/s", start=0.8)
    c, unit = m.parameter("c", "1/(m s)^2", start=40.0), m.constant("mass", 1.0, "kg")
    m.derivative(q, v)
    reverses = m.constant("F_c", friction, "N") * ca.tanh(v / m.constant("slow", 1e-3, "m/s"))
    m.derivative(v, (F - reverses) / unit - k * q - d * v - c * q**3)
    m.output("q", q, "m")
    rng = np.random.default_rng(5)
    channels = {"F": 8 * rng.standard_normal(400), "q": rng.standard_normal(400)}
    record = casid.Record(channels, {"F": "N", "q": "m"}, Ts=0.05)
    return SimulationError(m, [casid.Experiment(record, {}, "r")], substeps=8)


def test_a_sample_is_linearised_over_so_few_steps_that_its_slopes_are_those_of_all(monkeypatch):
    """The error of Runge and Kutta's step is (slope Ts / steps)^5 / 120: here two do for eight."""
    criterion = spring()
    d, x = criterion.data[0], criterion.start
    states = criterion.simulated(x, 0).x
    assert noise_response._substeps(criterion, x, 0, states, d.u) <= 2
    few = steps_along(criterion, x, 0)
    monkeypatch.setattr(resolving_steps, "STEPS", Steps(resolved=0.0))
    whole = steps_along(spring(), x, 0)
    assert few.a == pytest.approx(whole.a, abs=10 * 1e-4 * np.max(np.abs(whole.a)))
    assert not np.array_equal(few.a, whole.a)


def test_a_reversal_of_friction_is_linearised_over_all_steps():
    """Within a millimetre a second its slope is 1000 1/s, and no sample of 0.05 s resolves it."""
    criterion = spring(friction=1.0)
    states = np.zeros((3, 2))
    assert noise_response._substeps(criterion, criterion.start, 0, states, np.zeros((3, 1))) == 8


def test_spectra_are_differentiated_along_the_tangents_of_the_motion():
    """In the place of a simulation for each parameter: one with tangents, and no other."""
    criterion = spring()
    x, omega = criterion.start, np.linspace(0.1, 3.0, 20)
    sources = SourceSpectra(("q",), np.ones(1), {"F": 0.1}, {}, ({"q": 1.0}, {"F": 1.0}))
    of = ModelSpectra(criterion, sources, [None])
    criterion.simulated(x, 0)
    found = of.spectra(x, 0, omega)[1]
    criterion.state_tangents = lambda *_: None  # the motion is simulated again
    again = of.spectra(x, 0, omega)[1]
    assert found.keys() == again.keys()
    for k, slope in again.items():
        assert np.max(np.abs(slope)) > 0.0
        # Differences over a share of 1e-4 of the parameter: so far is a bend from its tangent.
        assert found[k] == pytest.approx(slope, abs=1e-2 * np.max(np.abs(slope)))
    criterion.simulate = None  # linearised where the tangents lead
    del criterion.state_tangents
    assert of.spectra(x, 0, omega)[1].keys() == found.keys()


def test_where_the_simulation_diverges_the_response_is_refused():
    """A spring that softens with the cube of what it is stretched by leaves every state."""
    criterion = spring()
    x = criterion.start.copy()
    x[[v.name for v in criterion.variables].index("c")] = -1e4
    with np.errstate(all="ignore"), pytest.raises(SolveError, match="diverges at these values"):
        noise_response.noise_response(criterion, x, 0)


def test_a_response_that_overflows_within_a_window_is_refused():
    """A state that a sample magnifies by 1e20 leaves every number behind within 20 samples."""
    one = np.ones((1, 1))
    with np.errstate(all="ignore"), pytest.raises(SolveError, match="within a window of 40"):
        windowed_spectra((1e20 * one, one, one, one, one), 40, np.ones(1), np.array([0.5]))
