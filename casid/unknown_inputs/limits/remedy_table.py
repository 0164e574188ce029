"""The table of remedies for unknown inputs, and one row of a comparison of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from casid.errors import CasidError, IdentifiabilityError, ModelError
from casid.estimation.prediction_error.polynomial.orders import Orders
from casid.unknown_inputs.limits.asymptotics import Asymptotics
from casid.unknown_inputs.limits.comparison import RemedyRow

Signals = Mapping[str, str] | None
"""Unknown input -> the signal that replaces it."""


@dataclass(frozen=True, slots=True, eq=False)
class Substitution:
    """What replaces the unknown inputs in a relation.

    Attributes
    ----------
    name : of the remedy in tables, without its estimator. kind : as of `Remedy`.
    by : unknown input -> signal; an input that has none is neglected.
    explained : known signals that are added in the place of the neglected inputs.
    signals : those that replace them, in words.
    """

    name: str
    kind: str
    by: Mapping[str, str]
    explained: Any = ()
    signals: str = ""


def remedy_table(
    unknown: Sequence[str],
    approximations: Signals = None,
    explained: Sequence[tuple[str, Any]] = (),
    measured: Signals = None,
    eliminated: Signals = None,
) -> list[Substitution]:
    """The remedies of Linder (2017), 3.3-3.6 and 4.2, that the given signals allow.

    Parameters
    ----------
    explained : signals in words, and the signals themselves.

    Raises
    ------
    ModelError
        If a signal is given for what is no unknown input.
    """

    def replaced(verb: str, kind: str, by: Signals) -> list[Substitution]:
        """The substitution of unknown inputs by signals, as a list of one, or none."""
        for name in by or {}:
            if name not in unknown:
                raise ModelError(
                    f"{(by or {})[name]} is given for {name}, which is no unknown input; these are "
                    f"{', '.join(unknown)}"
                )
        neglected = ", ".join(name for name in unknown if name not in (by or {}))
        text = ", ".join((by or {}).values()) + (f" and neglect {neglected}" if neglected else "")
        return [Substitution(f"{verb} {text}", kind, dict(by), signals=text)] if by else []

    return [
        Substitution("all inputs known", "known", {name: name for name in unknown}),
        Substitution("neglect", "neglect", {}),
        *replaced("approximate by", "approximate", approximations),
        *(Substitution(f"explain by {text}", "approximate", {}, own) for text, own in explained),
        *replaced("measure", "measure", measured),
        *replaced("eliminate with", "eliminate", eliminated),
    ]


def attempted_row(
    name: str,
    kind: str,
    estimate: Callable[[], Asymptotics],
    remark: str = "",
    *,
    raised: type[CasidError] | tuple[()] = (),
) -> RemedyRow:
    """The row of an estimator, or its refusal; errors of the class `raised` are no refusals."""
    try:
        return RemedyRow(name, kind, estimate(), "", remark)
    except raised:
        raise
    except CasidError as why:
        return RemedyRow(name, kind, None, str(why), remark)


def with_simpler_noise(
    estimate: Callable[[Orders], Asymptotics], orders: Orders
) -> Callable[[], Asymptotics]:
    """An estimator whose noise model is no larger than the noise.

    Where C and D would cancel (the noise is simpler than they are) both orders are lowered, and a
    note says so.
    """

    def estimated() -> Asymptotics:
        """The limit for the largest noise orders that are identifiable, with a note if reduced."""
        now = orders
        note: tuple[str, ...] = ()
        while True:
            try:
                found = estimate(now)
            except IdentifiabilityError:
                if not (now.nc and now.nd):
                    raise
                now = replace(now, nc=now.nc - 1, nd=now.nd - 1)
                note = (f"the noise is simpler than specified: nc = {now.nc}, nd = {now.nd}",)
            else:
                return replace(found, notes=found.notes + note)

    return estimated
