"""The causes as they are reported: sizes, contributions and what cannot be rejected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from casid.arrays import TINY
from casid.diagnosis.diagnosis import Alternative, Cause
from casid.diagnosis.evidence.score_tests import INVISIBLE
from casid.diagnosis.evidence.spoilt_samples import Spoilt
from casid.diagnosis.search.candidates import Adopted, Candidate
from casid.diagnosis.search.record_specific import Specific
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.verdict.contributions import contributions_of
from casid.diagnosis.verdict.sentences import says, says_kind, why_alternative
from casid.estimation.estimate import Estimate, Estimated
from casid.estimation.simulation.minimization import Fit
from casid.identification.wrong_signs import WrongSign
from casid.model.effects.effect import Effect


def causes_of(
    search: Search,
    adopted: Sequence[Adopted],
    spoilt: Spoilt,
    estimate: Estimate,
    fit: Fit,
    specific: Sequence[Specific] = (),
) -> list[Cause]:
    """Causes in the order of their contribution: the misfit that returns when one is taken out."""
    own = {found.key: found.by_record for found in specific}
    rows: list[tuple[float, Cause]] = []
    losses = contributions_of(search.weighing, adopted, fit)
    outputs, weights = fit.criterion.outputs, fit.criterion.weights
    scale = {o: weights[outputs.index(o)] ** 2 / 2 for o in outputs}
    # Few and small spikes are left out of the fit, but are nothing that a user would miss.
    least = 0.01 * fit.solution.value
    spikes = [s for s in spoilt.spikes if s.energy * scale[s.channel] > least]
    clipped = spoilt.plateaus  # a fact, however little it cuts off
    lost = sum(s.energy * scale[s.channel] for s in spikes)
    lost += sum(c.energy * scale[c.channel] for c in clipped)
    total = max(sum(losses) + lost, TINY)
    for a, loss in zip(adopted, losses, strict=True):
        effect = a.candidate.effect
        alternatives = tuple(
            Alternative(
                r.candidate.effect.kind,
                r.candidate.effect.where,
                r.p_value,
                why_alternative(a.candidate, r.candidate),
                r.candidate.effect.description,
            )
            for r in a.rivals
        )
        alternatives += tuple(_aliases(search, effect))
        rows.append(
            (
                loss,
                Cause(
                    kind=effect.kind,
                    where=effect.where,
                    p_value=a.p_value,
                    parameters=_parameters_of(a.candidate, estimate),
                    alternatives=alternatives,
                    share=loss / total,
                    sentence=says(effect),
                    description=effect.description,
                    by_record=own.get(effect.key, {}),
                ),
            )
        )
    for s in spikes:
        rows.append(
            (
                s.energy * scale[s.channel],
                Cause(
                    kind="outliers",
                    where=s.channel,
                    p_value=s.p_value,
                    parameters=(
                        Estimated("share", s.share, "1"),
                        Estimated("size", s.size, search_unit(search, s.channel)),
                    ),
                    share=s.energy * scale[s.channel] / total,
                    sentence=says_kind("outliers", s.channel),
                ),
            )
        )
    for c in clipped:
        unit = search_unit(search, c.channel)
        share = c.energy * scale[c.channel] / total
        rows.append(
            (
                c.energy * scale[c.channel],
                Cause(
                    kind="saturation",
                    where=c.channel,
                    p_value=c.p_value,
                    parameters=(Estimated(f"limit_{c.channel}", c.limit, unit),),
                    share=share,
                    sentence=says_kind("saturation", c.channel),
                    description=f"{c.count} samples stand exactly at the limit",
                ),
            )
        )
    rows.sort(key=lambda row: -row[0])
    return [cause for _, cause in rows]


def _parameters_of(candidate: Candidate, estimate: Estimate) -> tuple[Estimated, ...]:
    rows = [p for p in estimate.parameters if p.name in candidate.names]
    if candidate.effect.kind == "parameter_jump" and candidate.effect.variant is not None:
        rows.append(Estimated("time", candidate.effect.variant, "s", note="searched"))
    return tuple(rows)


def _aliases(search: Search, effect: Effect) -> list[Alternative]:
    """Effects whose signature is that of `effect`, or turned round: the same in this model.

    Parameters that depend on one channel may act alike; those refitted are judged by `rivals_of`.
    """
    table = search.first_table
    if table is None:
        return []
    keys = [s.effect.key for s in table.scores]
    refitted = {c.effect.key for c in search.first_candidates}
    out: list[Alternative] = []
    for i, key in enumerate(keys):
        if key != effect.key:
            continue
        for j, other in enumerate(keys):
            c = float(table.cosines[i, j])
            if other == key or table.scores[j].visible <= INVISIBLE or abs(c) < 0.99:
                continue
            kind, where = other
            if kind == effect.kind == "scheduled_parameter" and other not in refitted:
                why = f"with this record, {where} acts as {effect.where} does"
                out.append(Alternative(kind, where, 1.0, why))
            if kind == effect.kind == "time_delay" and c < 0.0:
                why = f"an advance of {where} looks the same as a delay of {effect.where}"
                out.append(Alternative(kind, where, 1.0, why))
    return out[:3]


def with_the_sign(turned: WrongSign, causes: list[Cause], before: Fit, after: Fit) -> list[Cause]:
    """The wrong sign in front of what was found with it mended."""
    lost = max(before.solution.value - after.solution.value, 0.0)
    share = lost / max(before.solution.value, TINY)
    alternatives = tuple(
        Alternative("sensor_scale", c, p, "negated, it fits as well: look at both sensors' axes")
        for c, p in turned.rivals.items()
    )
    first = Cause(
        kind="sensor_scale",
        where=turned.channel,
        p_value=turned.p_value,
        parameters=(Estimated("scale", -1.0, "1", note="the sign alone was tried"),),
        alternatives=alternatives,
        share=share,
        sentence=f"the channel {turned.channel} probably has the wrong sign, a scale of -1",
    )
    return [first, *(replace(c, share=(1 - share) * c.share) for c in causes)]


def search_unit(search: Search, channel: str) -> str:
    """Unit of a channel in the records searched."""
    return str(search.weighing.experiments[0].record.units.get(channel, "1"))
