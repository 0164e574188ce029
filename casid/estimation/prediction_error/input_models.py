"""Models of an unknown input: recorded after all, a random walk, or noise of an estimated spectrum.

Each takes a direct model and returns one in which the unknown input is an input or a state.
"""

from __future__ import annotations

from dataclasses import replace

from casid.errors import ModelError
from casid.model.model import Model
from casid.model.units import unit_quotient


def as_known(model: Model, unknown: str) -> Model:
    """The model with its unknown input recorded in a channel of the same name."""
    require_unknown(model, unknown)
    new = model.copy()
    new.inputs[unknown] = replace(new.inputs[unknown], kind="known")
    return new


def as_random_walk(
    model: Model,
    unknown: str,
    *,
    measured: bool = False,
    integral: str | None = None,
    integral_unit: str | None = None,
) -> tuple[Model, str]:
    """The model with its unknown input as a state that is driven by white noise.

    Parameters
    ----------
    measured : the input has a noisy channel of its own name, which becomes an output.
    integral : channel of its integral (a speed where the input is an acceleration), an output too.
    integral_unit : SI unit of that channel.

    Returns
    -------
    The model, and the name of the white noise that drives the state: an unknown input, to be given
    as `White(name, sd)` with sd in units of the input's rate times sqrt(s).
    """
    require_unknown(model, unknown)
    unit = model.inputs[unknown].unit
    new = model.copy()
    state = new.state(new.free_name(f"{unknown} as state"), unit)
    rate = f"rate of {unknown}"
    new.derivative(state, new.unknown_input(rate, unit_quotient(unit, "s")))
    new.substitute_symbol(unknown, state)
    del new.inputs[unknown]
    if measured:
        new.output(unknown, state, unit)
    if integral is not None:
        unit = integral_unit or unit_quotient(unit, "s", -1)
        moved = new.state(new.free_name(f"integral of {unknown}"), unit)
        new.derivative(moved, state)
        new.output(integral, moved, unit)
    return new, rate


def as_shaped_noise(model: Model, unknown: str, *, bandwidth: float = 3.0) -> tuple[Model, str]:
    """The model with its unknown input as white noise through two poles, which are estimated.

        u'' + 2 zeta w u' + w^2 u = noise

    Fits an input that is smooth or comes back to zero, which a random walk does not. Only the
    input's spectrum matters, not its distribution: a telegraph through a lag has two real poles.

    Parameters
    ----------
    bandwidth : where the estimation of w starts [rad/s]; zeta starts at one.

    Returns
    -------
    The model, with the parameters "w of <unknown>" and "zeta of <unknown>", and the name of the
    white noise, to be given as `White(name, sd)` with sd in units of the input per s^2 times
    sqrt(s). Its variance fixes the high frequencies whatever w and zeta: easy to estimate.
    """
    require_unknown(model, unknown)
    unit = model.inputs[unknown].unit
    new = model.copy()
    state = new.state(new.free_name(f"{unknown} as state"), unit)
    slope = new.state(new.free_name(f"slope of {unknown}"), unit_quotient(unit, "s"))
    w = new.parameter(f"w of {unknown}", "rad/s", start=bandwidth, lower=1e-3, upper=1e3)
    zeta = new.parameter(f"zeta of {unknown}", "1", start=1.0, lower=0.02, upper=50.0)
    source = f"source of {unknown}"
    white = new.unknown_input(source, unit_quotient(unit, "s", 2))
    new.derivative(state, slope)
    new.derivative(slope, white - w**2 * state - 2 * zeta * w * slope)
    new.substitute_symbol(unknown, state)
    del new.inputs[unknown]
    return new, source


def require_unknown(model: Model, unknown: str) -> None:
    """Refuse a name that is not one of the model's unknown inputs."""
    names = [n for n, i in model.inputs.items() if i.kind == "unknown"]
    if unknown not in names:
        raise ModelError(
            f"{model.name}: {unknown!r} is not an unknown input; it has "
            f"{', '.join(names) or 'none (give the direct model, before eliminate)'}"
        )
