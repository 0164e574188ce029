"""The model as C, compiled as a user compiles it."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from casid.arrays import Array
from casid.compiler import compiler
from tests.support.fitted_models import Simulated, assert_same, extended_emps

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler is found here")


def compiled(written: Path) -> Any:
    """A C file as a library, loaded."""
    library = written.with_suffix(".so")
    command = [str(compiler()), "-O2", "-Wall", "-Werror", "-shared", "-fPIC", str(written)]
    subprocess.run([*command, "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def pointer(values: Array) -> Any:
    """A C array of doubles."""
    return values.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


@needs_compiler
def test_the_c_step_is_the_step_of_the_fit(run: Simulated, tmp_path: Path) -> None:
    library = compiled(run.fitted.to_c(tmp_path / "model"))
    nx, ny = run.x.shape[1], run.y.shape[1]
    p = np.array(list(run.fitted.si_values.values()))
    x0 = np.array((ctypes.c_double * nx).in_dll(library, "model_x0"))
    assert np.array_equal((ctypes.c_double * len(p)).in_dll(library, "model_p"), p)
    y, x_next = np.zeros(ny), np.zeros(nx)
    states, outputs = [x0], []
    u = np.ascontiguousarray(np.hstack([run.u, np.zeros((len(run.t), 1))]))
    for k in range(len(run.t) - 1):
        t = ctypes.c_double(run.t[k])
        before = pointer(states[-1]), pointer(u[k]), pointer(u[k + 1]), t, pointer(p)
        library.model_step(*before, pointer(x_next), pointer(y))
        outputs.append(y.copy())
        states.append(x_next.copy())
    assert_same(np.array(outputs), run.y[:-1])
    assert_same(np.array(states), run.x[:-1])


def test_the_header_names_every_place_with_its_unit(tmp_path: Path) -> None:
    extended_emps().to_c(tmp_path / "rail.c")
    text = (tmp_path / "rail.h").read_text()
    for line in ("rail_x_v /* m/s */", "rail_u_force /* N */", "rail_p_F_c, /* N */"):
        assert line in text
    assert "#define RAIL_TS 0.001 /* s */" in text
    assert "4 Runge-Kutta steps" in text
