"""What a model declares: parameters, states, inputs, balances, and stages of its channels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import casadi as ca
import numpy as np

from casid.argument_types import methods_name_wrong_types
from casid.errors import ModelError

Expr = Any  # a CasADi SX expression, or a number where one is meant
Hold = Literal["zoh", "foh", "bandlimited"]
HOLDS: tuple[Hold, ...] = get_args(Hold)
"""What a recorded signal may do between its samples."""


def checked_hold(name: str, hold: Any) -> Hold:
    """What the input `name` does between its samples, as a user states it.

    Raises
    ------
    ModelError
        If it is none of `HOLDS`.
    """
    for known in HOLDS:
        if hold == known:
            return known
    raise ModelError(f"input {name}: hold={hold!r} is not known; use 'zoh', 'foh' or 'bandlimited'")


def expression_of(where: str, given: Any) -> Expr:
    """What a user gives for an expression, as an SX expression.

    Raises
    ------
    ModelError
        If it is neither a number nor made of the symbols of a model.
    """
    try:
        return ca.SX(given)
    except (NotImplementedError, TypeError):
        raise ModelError(
            f"{where} {given!r} is no expression; give a number, or one of the symbols that "
            "Model.state, Model.input and Model.parameter return"
        ) from None


def symbol_name(where: str, given: Any) -> str:
    """The name of a symbol, which is given as it is or by its name.

    Raises
    ------
    ModelError
        If it is neither.
    """
    if isinstance(given, ca.SX) and given.is_symbolic():
        return str(given.name())
    if not isinstance(given, str):
        raise ModelError(f"{where} is given as {given!r}; give its symbol or its name")
    return given


@methods_name_wrong_types(ModelError)
@dataclass(frozen=True, slots=True)
class Parameter:
    """A physical parameter: unknown with a start and bounds, or known with a value (SI units).

    Attributes
    ----------
    start, lower, upper : of an unknown parameter, in `unit`.
    value : of a known one; None where it is estimated.

    Raises
    ------
    ModelError
        If the bounds are exchanged, or the start of an unknown parameter lies outside them.
    """

    name: str
    unit: str
    start: float = 1.0
    lower: float = -np.inf
    upper: float = np.inf
    value: float | None = None
    is_constant: bool = False  # of nature or of geometry: no effect ever moves it
    is_searched: bool = False  # its bounds are the ends of a search, not those of the quantity

    def __post_init__(self) -> None:
        if self.lower > self.upper:
            raise ModelError(
                f"parameter {self.name}: lower bound {self.lower:g} lies above the upper bound "
                f"{self.upper:g}; exchange them"
            )
        if self.value is None and not self.lower <= self.start <= self.upper:
            raise ModelError(
                f"parameter {self.name}: start {self.start:g} lies outside its bounds "
                f"[{self.lower:g}, {self.upper:g}]; move the start inside or widen the bounds"
            )

    @property
    def is_known(self) -> bool:
        """True if the parameter has a value and is not estimated."""
        return self.value is not None

    @property
    def nominal(self) -> float:
        """The value of a known parameter, or where the estimate of an unknown one starts."""
        return self.start if self.value is None else self.value


@dataclass(frozen=True, slots=True)
class State:
    """A state: its initial value is estimated from `start`, unless it is known. SI units.

    `is_added` marks one that belongs to an effect: no place for further effects.
    """

    name: str
    unit: str
    start: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf
    initial: float | None = None
    is_added: bool = False

    @property
    def nominal(self) -> float:
        """The known initial value, or where the estimate of an unknown one starts."""
        return self.start if self.initial is None else self.initial


@dataclass(frozen=True, slots=True)
class Blend:
    """A parameter b in [0, 1] that moves an input towards another hold: all of it at b = 1."""

    parameter: str
    toward: Hold


@dataclass(frozen=True, slots=True)
class Input:
    """An input: a recorded channel, an unknown signal, or a generated function of time.

    Between its samples the signal is what `hold` says, u, plus b (w - u) for each of the `blends`,
    of parameter b towards a hold that gives w.
    """

    name: str
    unit: str
    kind: Literal["measured", "known", "unknown", "generated"] = "measured"
    hold: Hold = "foh"
    signal: Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]] | None = None
    blends: tuple[Blend, ...] = ()

    @property
    def holds(self) -> frozenset[Hold]:
        """Every hold that the signal is a part of."""
        return frozenset({self.hold, *(b.toward for b in self.blends)})


@dataclass(frozen=True, slots=True)
class EliminatedWith:
    """What an elimination took away: the unknown input, and the output it was eliminated with."""

    unknown: Input
    output: str
    residual: Expr  # 0 = output's expression - its measured symbol, before any branch was chosen
    input_place: int
    output_place: int


@dataclass(frozen=True, slots=True)
class Balance:
    """A named force or torque balance: inertia * d(rate)/dt = sum of terms.

    `unit` of the terms is SI; `declared` is the one that they are shown in, where that is another.
    """

    name: str
    rate: str
    inertia: Expr
    terms: tuple[Expr, ...]
    unit: str
    declared: str = ""

    @property
    def shown_unit(self) -> str:
        """The unit that what acts in it is shown in."""
        return self.declared or self.unit

    @property
    def total(self) -> Expr:
        """The sum of the terms."""
        return ca.SX(sum(self.terms[1:], self.terms[0]))


StageKind = Literal[
    "delay",
    "lag",
    "filter",
    "clip",
    "delay_input",
    "lead_input",
    "late_input",
    "lag_input",
    "play_input",
    "rate_input",
]


SENSED: Mapping[str, Literal["delay", "lag"]] = {"delay_input": "delay", "lead_input": "lag"}
"""What the stages of a measured input are, once it is an output again."""


@dataclass(frozen=True, slots=True)
class Stage:
    """What a sensor or an actuator does to its channel, beyond an expression.

    An output may be late (`delay`), pass a first-order lag (`lag`), be filtered by what samples it
    (`filter`) or be clipped (`clip`). Of an input what acted is found: the recorded column moved
    ahead (`delay_input`), rid of its sensor's lag (`lead_input`), or sent through an actuator's
    dead time (`late_input`), lag (`lag_input`), play (`play_input`) or largest rate (`rate_input`).
    The column is prepared before the simulation; `carrier` is the generated input that brings its
    change with `parameter` into the sensitivities.

    `least` is the narrowest play: without play the contacts are those of that one, not of noise.
    `begins` is where what acts through play stands as a record begins, in gaps beside the command.
    `share` is a further parameter, the part of what the stage does that is done: 0 or 1.
    """

    kind: StageKind
    channel: str
    parameter: str
    least: float = 0.0
    share: str = ""
    begins: float = 0.0

    @property
    def is_of_input(self) -> bool:
        """True if the stage prepares an input column."""
        return self.kind.endswith("_input")

    @property
    def makes_lines(self) -> bool:
        """True of what an actuator does that leaves an input as a line in each sample.

        A band-limited input stays one.
        """
        return self.kind in ("late_input", "lag_input", "rate_input")

    @property
    def parameters(self) -> tuple[str, ...]:
        """Parameters of the blend, the share last."""
        return (self.parameter, self.share) if self.share else (self.parameter,)

    @property
    def carriers(self) -> tuple[str, ...]:
        """Names of the inputs that carry the tangents of an input stage, one a parameter."""
        if not self.share:
            return (self.carrier,)
        return self.carrier, f"change of {self.channel} with {self.share}"

    @property
    def carrier(self) -> str:
        """Name of the input that carries the tangent of an input stage."""
        if self.kind == "delay_input":
            return f"slope of {self.channel}"
        return f"change of {self.channel} with {self.parameter}"

    @staticmethod
    def line_of(channel: str) -> tuple[str, str]:
        """Names of the inputs that say where an input's line in a sample begins and ends."""
        return f"start of {channel}", f"end of {channel}"
