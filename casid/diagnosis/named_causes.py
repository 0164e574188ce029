"""The names that a whole diagnosis gives to one record, for studies of many records."""

from __future__ import annotations

from casid.data.problem import Problem
from casid.data.record import Record
from casid.diagnosis.diagnose import diagnose
from casid.errors import CasidError


def named_causes(problem: Problem, record: Record, *, seed: int = 0) -> tuple[str, ...]:
    """Kind and place of every cause that `diagnose` names, each before those it is tied with.

    All of the record is fitted. Empty where nothing is missing or the record cannot be diagnosed.
    """
    try:
        found = diagnose(problem, [record], hold_out=0, advise=False, starts=1, seed=seed)
    except CasidError:
        return ()
    return tuple(
        dict.fromkeys(
            name
            for cause in found.causes
            for name in (f"{cause.kind} in {cause.where}", *(a.name for a in cause.alternatives))
        )
    )
