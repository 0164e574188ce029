"""Names of effects as an engineer says them, beside the identifiers that files and options have."""

from __future__ import annotations

import re
from collections.abc import Iterable

_NAMES = {
    "quadratic_damping": "quadratic damping in {place}",
    "cubic_damping": "cubic damping in {place}",
    "coulomb_friction": "dry friction in {place}",
    "asymmetric_friction": "friction that differs with direction in {place}",
    "stribeck_friction": "Stribeck friction in {place}",
    "cubic_stiffness": "cubic stiffness in {place}",
    "quadratic_stiffness": "one-sided stiffness in {place}",
    "deadzone": "dead zone in {where}",
    "backlash": "backlash in {where}",
    "end_stop": "end stop in {place}",
    "cogging": "cogging in {place}",
    "offset": "constant {quantity} in {place}",
    "periodic_disturbance": "periodic disturbance in {place}",
    "missing_mode": "unmodelled mode in {place}",
    "parameter_drift": "drift of {where}",
    "parameter_jump": "jump of {where}",
    "scheduled_parameter": "change of {own} with {source}",
    "extra_input": "{where} as a further input",
    "sensor_bias": "bias of {where}",
    "sensor_scale": "gain error of {where}",
    "sensor_lag": "lag of {where}",
    "time_delay": "delay of {where}",
    "cross_axis": "cross-axis sensitivity of {where}",
    "lever_arm": "lever arm of {where}",
    "saturation": "clipping of {where}",
    "rectified": "rectification of {where}",
    "outliers": "outliers in {where}",
    "hold": "inter-sample behaviour of {where}",
    "actuator_lag": "actuator lag of {where}",
    "actuator_saturation": "saturation of the command {where}",
    "unknown": "unidentified term",
}

TOGETHER = " and "
"""Between the places of what acts in several at once: one force, or the parts of a vector."""

FOR_A_WHILE = "for a while"
"""How the descriptions end of changes that are over before the record is."""

FOR_ONE_SAMPLE = "for one sample"
"""How they end where the change is over a sample later."""

DURING_THE_RECORD = "during the record"
"""How the descriptions end of changes of a gain that stay."""

GAIN_OF_INPUT = "the gain by which the input"
"""How the description begins of a gain that is no sensor's."""

RATE = "rate"
"""Shape of the saturation of a command whose actuator moves at no more than a rate."""

RATE_LIMIT = "the actuator moves at no more than a rate"
"""What it does, in words."""

DIGITAL = "digital filter"
"""Shape of the lag of a sensor whose samples have passed one."""

ACTS_LATE = "acts late"
"""Shape of the delay of a measured input that is not its sensor's."""

SETS_IN, GROWS_STEADILY = "sets in", "grows steadily"
"""What the descriptions say of a constant from an instant on, and of a bias that drifts."""

_COURSES = {
    "offset": {SETS_IN: "step"},
    "sensor_bias": {DURING_THE_RECORD: "step", GROWS_STEADILY: "drift"},
}
"""What is added to the words for a constant that is not there all the time."""

RELAXATION, RELAXES = "relaxation", "relaxes with a time constant"
"""Shape of the force of a spring and a damper in series, and what it does, in words."""

LATER_THAN_RECORDED = "acts later than it is recorded"
RECORDED_LATE = "is recorded later than it acts"
"""What a measured input does: the system is late, or its sensor is. The one undoes the other."""

BESIDE_ITS_ZERO = "acts beside its zero"
"""What a command does whose bias is no sensor's."""

BY_ANOTHER_GAIN = "acts by another gain than in the model"
"""What a command does whose gain error is no sensor's."""

ADVANCE = "an advance"
"""What a delay that is turned round is."""

RADIATION = "heat radiated"
"""How the description begins of what is exchanged between the fourth powers of temperatures."""

OVER_A_RESISTANCE = "as over a series resistance"
"""How the description ends of an output that also shows the flow into a store."""

_CHANGE_OF_GAIN = "change of the gain of {where}"
_FOR_A_WHILE = {"parameter_jump": "change of {where}", "sensor_scale": _CHANGE_OF_GAIN}
"""What is over again is no jump."""

_DEAD_TIME = "dead time of {where} (it acts late)"
_DELAYS = {
    ACTS_LATE: _DEAD_TIME,
    LATER_THAN_RECORDED: _DEAD_TIME,
    ADVANCE: "advance of {where}",
    RECORDED_LATE: "delay of the record of {where} (its sensor is late)",
}

BETWEEN_SAMPLES = " between its samples"
"""How the descriptions end of what an input does there."""

GROWS, OPPOSES = "that grows with", "that opposes"
OVERFLOW, CLAMP = "an overflow", "a clamp"
"""In descriptions of laws that circuits and stores have where bodies have friction and stops."""

A_CONSTANT = "a constant "
"""How the description begins of a constant in a balance; what it is of follows."""

WIND = f"{A_CONSTANT}wind or current"
"""How the description of a medium that moves begins."""

MEDIUM, RISING_MEDIUM = "medium", "step of the medium"
"""Shapes of one that moves all the time, and from an instant on or for a while."""

_CONSTANT = re.compile(rf"{A_CONSTANT}([a-z ]+?)(?= acts | sets in |$)")

_SIZE = re.compile(r"\|\(([^()|]*)\)\|")
"""The size of a difference, whose bars need no brackets inside."""

_LAWS = (
    "quadratic_damping",
    "cubic_damping",
    "coulomb_friction",
    "cubic_stiffness",
    "quadratic_stiffness",
    "end_stop",
)
"""Kinds that are called by what a body does, and by their law where the balance is no force's."""

ANYWHERE = "model"
"""The place of an unknown cause whose balance or output is not determined."""


def unknown_place(where: str) -> str:
    """The place of an unknown cause in words."""
    return "the model" if where == ANYWHERE else where


def constant_quantity(description: str) -> str:
    """What a constant in a balance is by its description: `torque`, `voltage`, else `term`."""
    found = _CONSTANT.match(description)
    return found[1] if found else "term"


def law_of(kind: str, description: str) -> str:
    """What an effect is called by beside its kind, as far as its description says it, else empty.

    The law of a circuit or a store, which has no friction and no spring, or the quantity that is
    constant in a balance.
    """
    if kind == "offset" and _CONSTANT.match(description):
        return f"{A_CONSTANT}{constant_quantity(description)}"
    if kind not in _LAWS:
        return ""
    is_law = description.startswith((OVERFLOW, CLAMP)) or any(
        f" {what} " in description for what in (GROWS, OPPOSES)
    )
    return description if is_law else ""


def place_of_law(law: str, where: str) -> str:
    """Where a law acts, after its words; nothing where they end with the place itself."""
    if law.endswith(f" {where}"):
        return ""
    return f" in the {where} balance" if where.isidentifier() else f" in {where}"


def effect_words(kind: str, where: str, *, description: str = "") -> str:
    """An effect and its place in words; a kind of the user's own keeps its name.

    Parameters
    ----------
    description : of the effect, where it is known: it tells the two delays of an input apart, and
        the laws of a circuit or a store from those of a body, and it says what is constant.
    """
    if kind not in _NAMES:
        return f"{kind} in {where}"
    if kind == "unknown" and description.startswith(RADIATION):
        return f"radiation in {where.partition(': ')[0]}"
    if kind == "unknown":
        at, _, shape = where.partition(": ")
        like = " like " + _SIZE.sub(r"|\1|", shape) if shape else ""
        return f"unidentified term{like} in {unknown_place(at)}"
    at, _, variant = where.partition(": ")
    place = f"the {at} balance" if at.isidentifier() else at
    own, _, source = at.partition("~")
    if kind == "actuator_saturation" and (variant == RATE or description == RATE_LIMIT):
        return f"rate limit of the actuator of {at}"
    if kind == "missing_mode" and (variant == RELAXATION or RELAXES in description):
        return f"force that relaxes in {place}"
    delay = _DELAYS.get(description) or _DELAYS.get(variant)
    if kind == "time_delay" and delay:
        return delay.format(where=at)
    if kind == "hold" and description.endswith(BETWEEN_SAMPLES):
        course = description.removesuffix(BETWEEN_SAMPLES)
        return f"{_NAMES[kind].format(where=at)} ({course})"
    if kind == "cross_axis" and description.endswith(OVER_A_RESISTANCE):
        return f"series resistance of {at}"
    law = law_of(kind, description).partition(",")[0]
    if law and kind in _LAWS:
        return f"{law.removeprefix('an ').removeprefix('a ')}{place_of_law(law, at)}"
    words = _NAMES[kind].format(
        place=place,
        where=at,
        own=own,
        source=source or "the state",
        quantity=constant_quantity(description),
    )
    for how_long in (FOR_A_WHILE, FOR_ONE_SAMPLE):
        if description.endswith(how_long):
            return f"{_FOR_A_WHILE.get(kind, words).format(where=at)} {how_long}"
    if kind == "sensor_scale" and (variant or description.endswith(DURING_THE_RECORD)):
        return _CHANGE_OF_GAIN.format(where=at)
    courses = [course for says, course in _COURSES.get(kind, {}).items() if says in description]
    variant = "" if variant in (MEDIUM, RISING_MEDIUM) else variant
    variant = variant or "".join(courses)
    return f"{words} ({variant})" if variant else words


def unsaid(words: str, description: str) -> str:
    """The description of an effect, empty where the words for it say the same."""
    return "" if description.removeprefix("an ").removeprefix("a ") in words else description


def place_words(where: str) -> str:
    """The place of an effect in words: a parameter that depends on something is said so."""
    own, _, source = where.partition("~")
    return f"the dependence of {own} on {source}" if source else where


def either_words(names: Iterable[str]) -> str:
    """`a`, `a or b`, `a, b or c`: one of them, each once."""
    *first, last = dict.fromkeys(names)
    return f"{', '.join(first)} or {last}" if first else last


def bracketed(name: str) -> str:
    """A name, or a sum of names in brackets."""
    return name if name.replace("_", "").isalnum() or not name else f"({name})"
