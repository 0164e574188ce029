"""The experiments of a system under each class of its unknown inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from casid.identifiability.equations.system import System
from casid.identifiability.inputs.elimination import eliminate_unknown_inputs
from casid.identifiability.inputs.experiments import merge
from casid.identifiability.inputs.input_classes import as_harmonic, as_polynomial, as_zero


def systems_by_class(
    systems: System | Sequence[System],
    *,
    shared: Sequence[str] = (),
    degrees: Sequence[int] = (0, 1, 2),
) -> dict[str, tuple[System, ...]]:
    """The experiments for each class of unknown inputs, to compare their ranks.

    Parameters
    ----------
    shared : unknown inputs that are the same signal in all experiments; by default each experiment
        has its own.
    degrees : of the polynomials.

    Returns
    -------
    dict of class (``"arbitrary"``, ``"polynomial_0"``, ..., ``"harmonic"``, ``"zero"``) -> systems
    without unknown inputs.
    """
    given = (systems,) if isinstance(systems, System) else tuple(systems)
    if shared:
        given = (merge(given, shared=shared),)
    once = {id(s): s for s in given}  # replicas are one object, and stay one

    def each(made: Mapping[int, System]) -> tuple[System, ...]:
        return tuple(made[id(s)] for s in given)

    table = {"arbitrary": each({k: eliminate_unknown_inputs(s).system for k, s in once.items()})}
    for degree in degrees:
        made = {k: as_polynomial(s, degree) for k, s in once.items()}
        table[f"polynomial_{degree}"] = each(made)
    table["harmonic"] = each({k: as_harmonic(s) for k, s in once.items()})
    table["zero"] = each({k: as_zero(s) for k, s in once.items()})
    return table
