"""How a fitted model reaches the formats that `casid.export` writes.

As with `casid.presentation`, the one step upward is taken by name when something is exported: no
module of the packages below may import `casid.export`.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


def _of(module: str, function: str) -> Any:
    return getattr(importlib.import_module(f"casid.export.{module}"), function)


class Exportable:
    """A model that can be taken away: as a problem file, CasADi, C, python-control, Modelica, FMU.

    What is written is in SI units, its parameters at the estimates. Each method raises ModelError
    where the target cannot hold the model: the message says why, and what can.
    """

    __slots__ = ()

    def to_problem_file(self, path: str | Path, *, force: bool = False) -> Path:
        """Write a Python problem file with the extended model, as a person would have written it.

        The causes are terms like all others, with a comment; unknown parameters start at the
        estimates, in the units they were declared in. `casid identify` on it gives the same fit.
        A file that exists is written over only with `force`: it may be one written by hand.
        """
        return _written(_of("problem_file", "write_problem_file")(self, Path(path), force=force))

    def to_casadi(self, parameters: Sequence[str] = (), *, without_delays: bool = False) -> Any:
        """The equations and the step of the fit as one ``casadi.Function``.

        Named inputs: x (nx,), u (nu,), u_next (nu,) the inputs one sample later, t [s] on the
        record's clock, p (np,) the values of `parameters` in their order; all other parameters have
        their estimates. Named outputs: dx = f(x, u), y = h(x, u), and x_next the state one sample
        later. SI units, in the order of the model's states, inputs and outputs. Where sensors are
        delayed, y is what they give at this sample, and the last input and output are a memory,
        `past` and `past_next`, zeros in the first step.
        """
        return _of("casadi_function", "casadi_function")(
            self, parameters, without_delays=without_delays
        )

    def to_c(self, path: str | Path, *, without_delays: bool = False) -> Path:
        """Write CasADi's generated C (.c) and a header (.h); returns the path of the C file.

        `NAME_equations` has the right-hand sides and outputs, `NAME_step` the step of the fit.
        Where sensors are delayed the step has a memory of past outputs.
        """
        return _written(_of("c_code", "write_c")(self, Path(path), without_delays=without_delays))

    def to_control(
        self,
        at: Mapping[str, float] | None = None,
        *,
        time: float | None = None,
        pade: int | None = None,
        without_delays: bool = False,
    ) -> Any:
        """The model linearised at an operating point, as ``control.StateSpace``.

        Parameters
        ----------
        at : state or input -> its value there, in its unit; of what is not named, that where the
            first fitted record works (`operating_point`): 0 for what passes through it, else the
            mean.
        time : on the record's clock [s]; default the beginning of the first fitted record.
        pade : order of the Pade approximation of each delay of a sensor or an input.
        without_delays : leave out these delays; one of both is needed where there are any.
        """
        return _of("control_system", "control_system")(
            self, at, time=time, pade=pade, without_delays=without_delays
        )

    def to_modelica(self, path: str | Path) -> Path:
        """Write a Modelica file (.mo) with one model, named like the file."""
        return _written(_of("modelica", "write_modelica")(self, Path(path)))

    def to_fmu(self, path: str | Path, *, without_delays: bool = False) -> Path:
        """Write a functional mock-up unit (.fmu): FMI 2.0, model exchange and co-simulation.

        It is compiled for this machine, and holds its sources. In co-simulation it goes the steps
        of the fit where the communication step is the sample time and the importer gives the
        derivatives of inputs that are joined by straight lines. A model whose sensors are delayed
        is a unit for co-simulation alone, by whole samples; where a delay is shorter than a sample,
        set those derivatives before its output is read.

        Raises
        ------
        DataError
            If there is no C compiler.
        """
        return _written(_of("fmu", "write_fmu")(self, Path(path), without_delays=without_delays))


def _written(path: Any) -> Path:
    return Path(path)
