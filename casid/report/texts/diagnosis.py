"""The diagnosis as text: what `print` shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from casid.diagnosis.diagnosis import Cause, Diagnosis
from casid.estimation.estimate import Estimated

_LISTED = 5  # of what the page has in full


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """Verdict, causes, gain and what else there is to say, one line each."""
    d = diagnosis
    lines = [f"Diagnosis of {d.problem}: {d.verdict}", f"  {d.sentence}"]
    for i, c in enumerate(d.causes, 1):
        lines += _cause(i, c)
    lines.append(f"  {'rms error':<22}{'output':<14}{'before':>12}{'after':>12}{'noise floor':>13}")
    for label, part in (("fitted", d.fitted), ("held out", d.held_out)):
        for output, before in part.get("baseline_rmse", {}).items():
            after = part.get("extended_rmse", {}).get(output)
            floor = part.get("noise_floor", {}).get(output)
            lines.append(
                f"  {label:<22}{output:<14}{before:>12.4g}"
                f"{'' if after is None else format(after, '.4g'):>12}"
                f"{'' if floor is None else format(floor, '.4g'):>13}"
            )
    if d.remaining is not None:
        lines.append(f"  remains       {d.remaining.sentence}")
    if d.unexplained is not None:
        lines += _under("unknown", d.unexplained.sentences)
    lines += [f"  moved         {line}" for line in _moved(d)]
    if d.isolability is not None:
        # Of causes that act alike here, those that a named one is among; the page has them all.
        named = {(c.kind, c.where) for c in d.causes}
        for group in d.isolability.groups:
            if named & set(group):
                names = [f"{kind} in {where}" for kind, where in group]
                lines.append(f"  the same here {_first(names)}")
    lines += [f"  noise         {k}: {v}" for k, v in d.noise.items()]
    structural = [f"{i.kind} in {i.where}" for i in d.invisible if i.is_structural]
    if structural:
        lines.append(f"  invisible     in any record of these channels: {_first(structural)}")
    practical = [f"{i.kind} in {i.where}" for i in d.invisible if not i.is_structural]
    if practical:
        lines.append(f"  invisible     in this record: {_first(practical)}")
    if d.calibration is not None:
        lines.append(f"  false alarms  {d.calibration.sentence}")
        lines += [f"  {'':<14}{note}" for note in d.calibration.notes]
    lines += [f"  note          {n}" for n in d.notes]
    lines.append(f"  advice        {d.advice}")
    if d.proposals:
        lines.append(f"  next          {d.proposals[0].description}")
    return "\n".join(lines)


def _cause(i: int, c: Cause) -> Iterator[str]:
    values = ", ".join(_value(p) for p in c.parameters)
    yield (
        f"  {i}. {c.kind} in {c.where} (p = {c.p_value:.1e})"
        + (f": {c.description.rstrip('.')}" if c.description else "")
        + (f"{';' if c.description else ':'} {values}" if values else "")
    )
    for record, found in c.by_record.items():
        yield f"     {record}: " + ", ".join(_value(p) for p in found.values())
    for a in c.alternatives:
        yield f"     or {a.name} (p = {a.p_value:.2g}): {a.why}"


def _value(p: Estimated) -> str:
    error = f" +- {p.std_error:.2g}" if p.std_error is not None else ""
    return f"{p.name} = {p.value:.4g}{error} {p.unit}"


def _moved(d: Diagnosis) -> Iterator[str]:
    for m in d.moved[:_LISTED]:
        far = "" if m.shift is None else f", by {abs(m.shift):.3g} standard errors"
        yield f"{m.name} from {m.before:.4g} to {m.after:.4g} {m.unit}{far}"
    if len(d.moved) > _LISTED:
        yield f"and {len(d.moved) - _LISTED} more"


def _under(heading: str, lines: Sequence[str]) -> list[str]:
    return [f"  {heading if k == 0 else '':<14}{line}" for k, line in enumerate(lines)]


def _first(names: list[str]) -> str:
    more = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {more} more" if more > 0 else "")
