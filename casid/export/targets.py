"""What a fitted model is exported as, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import get_args

from casid.errors import DataError, nearest
from casid.estimation.fitted.fitted_model import FittedModel
from casid.export.naming import Target, checked_path

TARGETS: tuple[str, ...] = get_args(Target)


def export(
    fitted: FittedModel,
    target: str,
    path: str | Path,
    *,
    at: Mapping[str, float] | None = None,
    pade: int | None = None,
    without_delays: bool = False,
    say: Callable[[str], None] | None = None,
) -> Path:
    """Write a fitted model for one of `TARGETS`; returns the path.

    Parameters
    ----------
    at : operating point of a state space, SI.
    pade : order of the Pade approximation of the delays in a state space.
    without_delays : leave out the delays of sensors and inputs.
    say : takes what the user of a state space should know; by default a warning has it.

    Raises
    ------
    DataError
        For a target or a file ending that does not exist, or options of another target.
    ModelError
        If the target cannot hold the model.
    """
    require_target(target)
    if at and target != "control":
        raise DataError("an operating point belongs to a state space; export it as control")
    if pade is not None and target != "control":
        raise DataError(
            f"--pade is for a state space (--as control); {target} holds delays as such"
        )
    if without_delays and target in ("problem", "modelica"):
        raise DataError(f"export as {target} keeps the delays; leave --without-delays out")
    path = checked_path(Path(path), target)
    if target == "problem":
        return fitted.to_problem_file(path, force=True)  # refused by the caller, for any target
    if target == "modelica":
        return fitted.to_modelica(path)
    if target == "c":
        return fitted.to_c(path, without_delays=without_delays)
    if target == "fmu":
        return fitted.to_fmu(path, without_delays=without_delays)
    if target == "casadi":
        from casid.export.casadi_function import write_casadi

        return write_casadi(fitted, path, without_delays=without_delays)
    from casid.export.control_system import write_control

    return write_control(fitted, path, at, pade=pade, without_delays=without_delays, say=say)


def require_target(target: str) -> None:
    """Refuse a name that is none of `TARGETS`.

    Raises
    ------
    DataError
        With the names that are.
    """
    if target not in TARGETS:
        raise DataError(
            f"no export as {target!r}; it is one of {', '.join(TARGETS)}"
            f"{nearest(target, TARGETS, is_listed=True)}"
        )
