"""Compiled steps are the interpreter's, to the last digit, and nothing needs a compiler."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from casid.arrays import Array
from casid.compiler import compiler
from casid.estimation.simulation.integration import machine_code
from casid.estimation.simulation.integration.machine_code import cache_folder
from casid.estimation.simulation.integration.simulator import Simulator, Trajectory
from tests.estimation.simulation.integration.test_simulator import (
    STICK_SLIP,
    TS,
    D,
    K,
    M,
    dragged,
    oscillator,
)

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler is found here")
RNG = np.random.default_rng(3)
U, P, X0 = RNG.normal(size=(400, 1)), np.array([M, D, K]), np.array([0.3, -0.2])
FREE = ["m", "d", "k"]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of its own for compiled steps, which are compiled at once."""
    monkeypatch.setenv("CASID_CACHE", str(tmp_path))
    monkeypatch.setattr(machine_code, "OPTIMISED_AFTER", (0, 0, 0, 1))
    monkeypatch.setattr(machine_code, "LOOKED_FOR", 0)
    return tmp_path / "steps"


def interpreted(monkeypatch: pytest.MonkeyPatch, Ts: float = TS) -> Trajectory:
    with monkeypatch.context() as without:
        without.setenv("CASID_CACHE", "")
        return Simulator(oscillator(), Ts, FREE).sensitivities(U, P, X0)


def assert_same(a: Trajectory, b: Trajectory) -> None:
    for one, other in ((a.y, b.y), (a.x, b.x), (a.dy, b.dy), (a.dx_end, b.dx_end)):
        assert one is not None
        assert other is not None
        # The same operations in the same order; other systems may bring other sines.
        np.testing.assert_allclose(one, other, rtol=1e-14, atol=0.0)


@needs_compiler
def test_compiled_and_interpreted_steps_agree(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled = Simulator(oscillator(), TS, FREE).sensitivities(U, P, X0)
    assert len(list(cache.glob("*.so"))) == 1
    assert_same(compiled, interpreted(monkeypatch))


@needs_compiler
def test_compiled_and_interpreted_steps_are_fine_at_the_same_samples(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run() -> Trajectory:
        simulator = Simulator(dragged(), 0.005, ["F_c"], substeps=32)
        return simulator.sensitivities(STICK_SLIP, np.array([10.0]), np.zeros(2))

    compiled = run()
    assert len(list(cache.glob("*.so"))) == 1
    monkeypatch.setenv("CASID_CACHE", "")
    assert_same(compiled, run())


@needs_compiler
def test_numbers_of_a_formula_are_no_part_of_its_code(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another sample time finds the same library, and keeps its own numbers."""
    slow = Simulator(oscillator(), TS, FREE).sensitivities(U, P, X0)
    fast = Simulator(oscillator(), TS / 2, FREE).sensitivities(U, P, X0)
    assert len(list(cache.glob("*.so"))) == 1
    assert_same(slow, interpreted(monkeypatch))
    assert_same(fast, interpreted(monkeypatch, TS / 2))


@needs_compiler
def test_a_beginning_that_has_decayed_to_a_subnormal_number_is_zero(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Damped critically, d = 2 sqrt(m k), at 5 1/s: below 1e-308 after 142 s. Only in the loop."""
    smallest, p, rest = np.finfo(float).tiny, np.array([M, 20.0, K]), np.zeros((3000, 1))

    def from_the_beginning() -> Array:
        found = Simulator(oscillator(), TS, FREE).sensitivities(rest, p, X0)
        return found.dy[-20:, 0, -2:]

    compiled = from_the_beginning()
    monkeypatch.setenv("CASID_CACHE", "")
    interpreted = from_the_beginning()
    assert np.all((interpreted != 0.0) & (np.abs(interpreted) < smallest))
    assert np.all(compiled == 0.0)
    assert 0.5 * smallest > 0.0


@needs_compiler
def test_the_loop_over_samples_is_compiled_once(cache: Path) -> None:
    s = Simulator(oscillator(), TS, FREE)
    s.simulate(U, P, X0)
    s.sensitivities(U, P, X0)
    assert len(list(cache.glob("*.so"))) == 2
    assert len(list(cache.glob("loop/*.so"))) == 1


@needs_compiler
def test_a_motion_comes_from_the_step_with_tangents_while_that_alone_is_compiled(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To the last digit, and until it has taken as long as a compiler for the motion alone."""
    monkeypatch.setattr(machine_code, "OPTIMISED_AFTER", (400, 1000, 0, 1))
    s = Simulator(oscillator(), TS, FREE)
    s.sensitivities(U, P, X0)
    assert len(list(cache.glob("*.so"))) == 1
    motion = s.simulate(U, P, X0)
    assert len(list(cache.glob("*.so"))) == 1
    for _ in range(200):
        s.simulate(U, P, X0)
    assert len(list(cache.glob("*.so"))) == 2
    expected = interpreted(monkeypatch)
    np.testing.assert_allclose(motion.y, expected.y, rtol=1e-14, atol=0.0)
    np.testing.assert_allclose(motion.x, expected.x, rtol=1e-14, atol=0.0)


@needs_compiler
def test_a_step_is_compiled_when_the_interpreter_has_taken_as_long(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CASID_CACHE", str(tmp_path))
    s = Simulator(oscillator(), TS)
    s.simulate(U, P, X0)
    assert not list(tmp_path.glob("steps/*.so"))
    for _ in range(600):
        s.simulate(U, P, X0)
    assert len(list(tmp_path.glob("steps/*.so"))) == 1


@needs_compiler
def test_a_long_step_is_translated_as_it_is_and_optimised_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What an optimising compiler takes for it goes with the square of its length."""
    monkeypatch.setenv("CASID_CACHE", str(tmp_path))
    monkeypatch.setattr(machine_code, "SHORT", 0)
    monkeypatch.setattr(machine_code, "COMPILED_AFTER", (1000, 0))
    monkeypatch.setattr(machine_code, "OPTIMISED_AFTER", (0, 0, 3000, 4000))
    s = Simulator(oscillator(), TS, FREE)
    for libraries in (1, 1, 1, 2, 2):  # with four passes of 400 samples to come
        run = s.sensitivities(U, P, X0)
        assert len(list(tmp_path.glob("steps/*.so"))) == libraries
        assert_same(run, interpreted(monkeypatch))


def test_without_a_compiler_steps_are_interpreted(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = interpreted(monkeypatch)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    assert_same(Simulator(oscillator(), TS, FREE).sensitivities(U, P, X0), expected)


@needs_compiler
def test_a_compiler_that_fails_is_no_error(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "broken"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    run = Simulator(oscillator(), TS, FREE).sensitivities(U, P, X0)
    assert not list(cache.glob("*.so"))
    assert_same(run, interpreted(monkeypatch))


def test_a_folder_that_others_can_write_to_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What lies there is run as the user."""
    (tmp_path / "steps").mkdir()
    (tmp_path / "steps").chmod(0o777)
    monkeypatch.setenv("CASID_CACHE", str(tmp_path))
    assert cache_folder() is None
