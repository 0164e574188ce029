"""Whether what a diagnosis said of a case is right.

Right
    The first cause is of the hidden kind, in the hidden place, with these exceptions and no other:

    - Timing. A hidden `time_delay`, `sensor_lag` or `hold` of the gyro or the accelerometer is any
      of the three in either of them: a short lag is a delay to first order, a sample that is held
      is half a sample late, and a delay of one of the two is an advance of the other. Timing of
      another channel, or of an actuator, is another cause.
    - A load. A hidden `parameter_jump` of m is one of any parameter of mass, inertia or lever that
      the load moves (`MOVED_BY_A_LOAD`). The damping, which it does not move, is not among them.
    - Stiffness and load. A jump of k may be reported as one of such a parameter, and a jump of m as
      one of k, only where the hidden one stands among the alternatives: the load moves the
      stiffness by gravity, but a first name alone would be wrong.

    A jump and a drift of the same parameter are two causes, as are two channels of `extra_input`.
Strictly right
    As above without the exceptions for timing and for stiffness and load.
In the set
    The hidden cause, with the exceptions for timing and a load, is the first one or one of its
    alternatives.
Named
    At least one cause that is not `unknown`.
Wrong name
    The first cause is named, it is not right, and the hidden one is not in the set either.
Doubtful
    The first cause is named, it is not right, but the hidden one is in the set. It counts neither
    as right nor as wrong.
Flagged
    A cause or an alternative is `unknown`, or the verdict says that something remains.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

Row = Mapping[str, Any]
Name = tuple[str, str]
"""Kind and place."""

TIMING = ("time_delay", "sensor_lag", "hold")
"""Kinds of one class,"""

PAIR = ("gyro", "accel")
"""in these channels."""

MOVED_BY_A_LOAD = ("m", "M", "I_x", "A_x", "z_g", "zbar_g", "z_m", "zbar_m")
"""Parameters any of which may stand for a load; k only beside them."""

UNKNOWN = "unknown"


def is_named(row: Row) -> bool:
    """True if some cause is named."""
    return any(c["kind"] != UNKNOWN for c in row.get("causes", ()))


def is_alarm(row: Row) -> bool:
    """True if the diagnosis says that the model lacks something."""
    return bool(row.get("verdict") == "deficient")


def is_flagged(row: Row) -> bool:
    """True if the diagnosis says that there is something that it does not know."""
    return row.get("unexplained") is not None or any(
        kind == UNKNOWN for cause in row.get("causes", ()) for kind, _ in reported(cause)
    )


def is_right(row: Row, *, strictly: bool = False) -> bool:
    """True if the first cause is the hidden one."""
    causes = row.get("causes", ())
    return bool(causes) and is_it(causes[0], (row["kind"], row["where"]), strictly=strictly)


def is_it(cause: Row, hidden: Name, *, strictly: bool = False) -> bool:
    """True if a cause, with its alternatives, counts as the hidden one."""
    first, *others = reported(cause)
    if matches(first, hidden, strictly=strictly):
        return True
    if strictly or {first[0], hidden[0]} != {"parameter_jump"}:
        return False
    places = {first[1], hidden[1]}
    return (
        "k" in places
        and bool(places & set(MOVED_BY_A_LOAD))
        and any(matches(other, hidden) for other in others)
    )


def is_wrong_name(row: Row) -> bool:
    """True if the first cause is named, and the hidden one is not even among its alternatives."""
    return _first_is_another(row) and not has_truth(row)


def is_doubtful(row: Row) -> bool:
    """True if the first cause is named and not right, but the hidden one is an alternative."""
    return _first_is_another(row) and has_truth(row)


def _first_is_another(row: Row) -> bool:
    causes = row.get("causes", ())
    return bool(causes) and causes[0]["kind"] != UNKNOWN and not is_right(row)


def has_truth(row: Row) -> bool:
    """True if the hidden effect is the first cause or one of its alternatives."""
    hidden = row["kind"], row["where"]
    return any(matches(pair, hidden) for c in row["causes"][:1] for pair in reported(c))


def set_size(row: Row) -> int:
    """How many things the first cause may be, with its alternatives."""
    return len(list(reported(row["causes"][0])))


def found_of_pair(row: Row) -> tuple[bool, bool]:
    """Whether each of two hidden effects is among the causes, one cause for one effect."""
    causes = row.get("causes", ())
    hidden = [(row["kind"], row["where"]), (row["second"]["kind"], row["second"]["where"])]
    by = [[i for i, cause in enumerate(causes) if is_it(cause, truth)] for truth in hidden]
    if all(by) and len({*by[0], *by[1]}) == 1:  # one cause cannot stand for both
        return True, False
    return bool(by[0]), bool(by[1])


def reported(cause: Row) -> Iterator[Name]:
    """A cause and its alternatives."""
    yield cause["kind"], cause["where"]
    for kind, where, *_ in cause["alternatives"]:
        yield kind, where


def matches(named: Name, hidden: Name, *, strictly: bool = False) -> bool:
    """True if what is named is what was hidden, whatever stands beside it."""
    kind, where = hidden
    if kind in TIMING and where in PAIR and not strictly:
        return named[0] in TIMING and named[1] in PAIR
    if named[0] != kind:
        return False
    if kind == "parameter_jump" and where == "m":
        return named[1] in MOVED_BY_A_LOAD
    return named[1] == where
