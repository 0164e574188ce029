"""Systems from formulas, as an equation file has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from casid.identifiability.equations.equation_text import parse_system
from casid.identifiability.equations.system import System


def system_of(
    equations: Mapping[str, str],
    outputs: Mapping[str, str],
    *,
    params: Sequence[str] = (),
    unknown: Sequence[str] = (),
    known: Sequence[str] = (),
    constants: Sequence[str] = (),
    name: str = "example",
    **more: Any,
) -> System:
    """A system of states with these derivatives; further fields as in an equation file."""
    return parse_system(
        {
            "states": list(equations),
            "params": list(params),
            "known_inputs": list(known),
            "unknown_inputs": list(unknown),
            "known_constants": list(constants),
            "equations": equations,
            "outputs": outputs,
            **more,
        },
        name=name,
    )
