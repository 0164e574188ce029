"""The causes as they are reported: sizes, contributions and what cannot be rejected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from casid.arrays import TINY
from casid.data.reading.columns import ColumnSpec
from casid.diagnosis.evidence.recording_faults.corrupted_samples import confirmed
from casid.diagnosis.evidence.recording_faults.plateaus import Plateaus
from casid.diagnosis.evidence.recording_faults.rectified_channels import Rectified
from casid.diagnosis.evidence.recording_faults.spikes import Spikes
from casid.diagnosis.evidence.recording_faults.stuck_sensors import Standstills
from casid.diagnosis.evidence.records.signal_sizes import sizes_of
from casid.diagnosis.search.candidates import Adopted, Candidate, Rival, found_values
from casid.diagnosis.search.comparison.contributions import contributions_of
from casid.diagnosis.search.findings import Findings
from casid.diagnosis.search.instants.jump_times import events_of
from casid.diagnosis.search.rounds import Search
from casid.diagnosis.thresholds import JUDGING, OUTLIERS, SCORES
from casid.diagnosis.verdict.cause import Alternative, Cause
from casid.diagnosis.verdict.sentences import says, says_kind, says_rate_limit, why_alternative
from casid.diagnosis.verdict.wrong_units import said_of_gain
from casid.estimation.estimate import Estimate, Estimated
from casid.estimation.simulation.minimization import Fit
from casid.identification.signs_from_simulation import WrongSign
from casid.model.effects.clock_effects import with_duration
from casid.model.effects.effect import Effect
from casid.model.effects.names import ACTS_LATE, ADVANCE, RATE, place_words
from casid.model.effects.places.places import place_named
from casid.model.quantities import instant_text, quantity_text

SWITCHED_ON = "not estimated: either present or absent"
"""Note on the parameter of a kind that is there or not."""


def causes_of(
    found: Findings, estimate: Estimate, columns: Mapping[str, ColumnSpec] | None = None
) -> list[Cause]:
    """Causes in the order of their contribution: the misfit that returns when one is taken out.

    Parameters
    ----------
    columns : channel -> the column of the file that it is read from, named where it differs.
    """
    fit = found.best_fit
    outputs, weights = fit.criterion.outputs, fit.criterion.weights
    scale = {o: weights[outputs.index(o)] ** 2 / 2 for o in outputs}
    # Few and small spikes are left out of the fit, but are nothing that a user would miss. What a
    # disturbance leaves besides is no measure: it has nothing to do with the sensor.
    noise = found.at.likelihoods.full.output_sd
    counts = sum(d.used.sum(axis=0) for d in fit.criterion.data)
    white = {o: counts[i] * noise[i] ** 2 * scale[o] for i, o in enumerate(outputs)}
    least = {o: JUDGING.small_outliers * min(fit.solution.value, white[o]) for o in outputs}
    corrupted = found.baseline.corrupted
    onsets = events_of([a.candidate for a in found.adopted])
    spikes = [confirmed(s, fit, found.baseline.split, onsets) for s in corrupted.spikes]
    kept = [s for s in spikes if s is not None and s.energy * scale[s.channel] > least[s.channel]]
    samples = [(s.energy * scale[s.channel], _outliers(found.search, s)) for s in kept]
    samples += [  # a fact, however little it cuts off
        (c.energy * scale[c.channel], _saturation(found.search, c)) for c in corrupted.plateaus
    ]
    samples += [
        (s.energy * scale[s.channel], _standing(found.search, s)) for s in corrupted.standstills
    ]
    losses = contributions_of(found.search.weighing, found.adopted, fit, found.search.attempts)
    effects = [_adopted(found, a, estimate, columns or {}) for a in found.adopted]
    rows = [*zip(losses, effects, strict=True), *samples]
    total = max(sum(losses) + sum(loss for loss, _ in samples), TINY)
    rows.sort(key=lambda row: -row[0])
    return [replace(cause, share=loss / total) for loss, cause in rows]


def remainders_of(found: Findings) -> tuple[Cause, ...]:
    """Significant effects that explain too little to be causes, with sizes in the last fit.

    What the extended model leaves out has its size as first fitted. Of what nobody would see, only
    that which stays in the extended model for the causes' sizes.
    """
    out = []
    last = found.best_fit
    for a in sorted(found.remainders, key=lambda a: -a.share):
        if a.share < JUDGING.visible and a.candidate.names[0] not in last.criterion.names:
            continue
        effect, values = a.candidate.effect, found_values(a.candidate)
        named = zip(effect.parameters, a.candidate.names, strict=True)
        values |= {p.name: last.values[name] for p, name in named if name in last.criterion.names}
        out.append(
            Cause(
                kind=effect.kind,
                where=effect.where,
                p_value=a.p_value,
                parameters=tuple(
                    Estimated(p.name, values[p.name], p.unit)
                    for p in effect.parameters
                    if p.name in values
                ),
                share=a.share,
                sentence=says(effect),
                description=effect.description,
                shape=effect.shape,
            )
        )
    return tuple(out)


def _adopted(
    found: Findings, adopted: Adopted, estimate: Estimate, columns: Mapping[str, ColumnSpec]
) -> Cause:
    """An effect of the catalogue, without its share."""
    Ts = min(d.Ts for d in adopted.candidate.fit.criterion.data)
    effect = with_duration(adopted.candidate.effect, Ts)
    named = {a.candidate.effect.key for a in found.adopted}  # beside it, and not in its place
    alternatives = tuple(
        _alternative(adopted, r) for r in adopted.rivals if r.candidate.effect.key not in named
    )
    by_record = {s.key: s.by_record for s in found.specific}
    column = columns.get(effect.where)
    parameters = _parameters_of(adopted, estimate)
    sentence = says(effect, column.column if column is not None else "")
    if effect.kind == "sensor_scale" and not effect.sets_in:
        is_about_zero = not effect.constants.get("about")
        unit = _unit(found.search, effect.where)
        like = said_of_gain(parameters[0], unit, is_about_zero=is_about_zero)
        sentence += f", {like}" if like else ""
    if effect.shape == RATE:
        sentence = says_rate_limit(effect.where, _rate_text(adopted.candidate, parameters))
    return Cause(
        kind=effect.kind,
        where=effect.where,
        p_value=adopted.p_value,
        parameters=parameters,
        alternatives=(
            *alternatives,
            *_aliases(found.search, effect),
            *_as_dry_friction(found, effect, parameters),
        ),
        sentence=sentence,
        description=effect.description,
        by_record=by_record.get(effect.key, {}),
        shape=effect.shape,
    )


def _alternative(adopted: Adopted, rival: Rival) -> Alternative:
    """A rival that the record cannot reject, or that none can: the same term of the equations."""
    effect, why = rival.candidate.effect, why_alternative(adopted.candidate, rival)
    if adopted.is_same_term(effect):
        as_one = f"as a {effect.shape}, " if effect.shape and effect.end is None else ""
        why = f"{as_one}is the same term: no record of these channels can separate them"
        # Even odds, whatever the rounding of two fits makes of them.
        return Alternative(
            effect.kind,
            effect.where,
            0.5,
            why,
            effect.description,
            has_reason=True,
            is_same_term=True,
        )
    return Alternative(effect.kind, effect.where, rival.p_value, why, effect.description)


def _rate_text(candidate: Candidate, parameters: tuple[Estimated, ...]) -> str:
    """An actuator's largest rate in the unit that the extended model has for it: 3.02 deg/s."""
    model, name = candidate.model, candidate.names[1]
    value = {p.name: p.value for p in parameters}.get(name, candidate.fit.values.get(name))
    return (
        "a rate"
        if value is None
        else quantity_text(model.shown_size(name, value), model.unit_of(name))
    )


def _outliers(search: Search, spikes: Spikes) -> Cause:
    """Isolated spikes of a channel, without their share of the misfit."""
    return Cause(
        kind="outliers",
        where=spikes.channel,
        p_value=_family_wise(spikes.p_value),
        parameters=(
            Estimated("share", spikes.share, "1"),
            Estimated("size", spikes.size, _unit(search, spikes.channel)),
        ),
        sentence=says_kind("outliers", spikes.channel),
    )


def _standing(search: Search, still: Standstills) -> Cause:
    """A sensor that stood still, without its share of the misfit."""
    samples = sum(len(m) for m in still.masks)
    ends = "to the end of the record" if any(m[-1] for m in still.masks) else "and leaps in the end"
    return Cause(
        kind="outliers",
        where=still.channel,
        p_value=_family_wise(still.p_value),
        parameters=(
            Estimated("share", still.count / samples, "1"),
            Estimated("size", still.size, _unit(search, still.channel)),
        ),
        sentence=f"the sensor of {still.channel} stands still for {still.count} samples",
        description=f"it repeats one value while the motion goes on, {ends}",
    )


def _saturation(search: Search, cut: Plateaus) -> Cause:
    """The clipping of a channel, without its share of the misfit."""
    unit = _unit(search, cut.channel)
    equal = f"{cut.count} samples equal the limit exactly"
    if cut.lower is not None and cut.upper is not None:
        ends = f"{quantity_text(cut.lower, unit)} or {quantity_text(cut.upper, unit)}"
        equal = f"{cut.count} samples equal one of the limits exactly, {ends}"
    return Cause(
        kind="saturation",
        where=cut.channel,
        p_value=_family_wise(cut.p_value),
        parameters=(Estimated(f"limit_{cut.channel}", cut.limit, unit),),
        sentence=says_kind("saturation", cut.channel),
        description=equal,
    )


def _family_wise(p: float) -> float:
    """p of a test of the samples of one channel, which has its share of the false-alarm rate."""
    return min(p / OUTLIERS.test_share, 1.0)


def _parameters_of(adopted: Adopted, estimate: Estimate) -> tuple[Estimated, ...]:
    candidate = adopted.candidate
    rows = [p for p in estimate.parameters if p.name in candidate.names]
    if candidate.effect.is_switched:
        blend, note = candidate.names[0], SWITCHED_ON
        rows = [replace(p, note=note) if p.name == blend else p for p in rows]
    if candidate.effect.sets_in:
        Ts = min(d.Ts for d in candidate.fit.criterion.data)
        errors = [*adopted.instant_errors, None, None]
        ends = (("time", candidate.effect.variant), ("end", candidate.effect.end))
        for (name, when), error in zip(ends, errors, strict=False):
            if when is not None:
                known = max(Ts, error or 0.0)
                note = (
                    f"searched, to within {quantity_text(known, 's')}: {instant_text(when, known)}"
                )
                rows.append(
                    Estimated(name, when, "s", std_error=error, note=note, resolution=known)
                )
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
    # Of these an advance is an effect of its own.
    both_ways = {s.effect.where for s in table.scores if s.effect.shape == ACTS_LATE}
    out: list[Alternative] = []
    for i, key in enumerate(keys):
        if key != effect.key:
            continue
        for j, other in enumerate(keys):
            c = float(table.cosines[i, j])
            if (
                other == key
                or table.scores[j].visible <= SCORES.undetectable
                or abs(c) < JUDGING.alias
            ):
                continue
            kind, where = other
            if kind == effect.kind == "scheduled_parameter" and other not in refitted:
                why = (
                    f"in this record {place_words(where)} acts as {place_words(effect.where)} does"
                )
                out.append(Alternative(kind, where, 1.0, why))
            is_one_way = where.partition(": ")[0] not in both_ways
            if kind == effect.kind == "time_delay" and c < 0.0 and is_one_way:
                out.append(Alternative(kind, where, 1.0, as_an_advance(where, effect), ADVANCE))
    return out[: JUDGING.aliases]


def as_an_advance(where: str, late: Effect) -> str:
    """That records which are ahead of time look the same as a delay or a dead time elsewhere."""
    is_dead_time = late.shape == ACTS_LATE or late.description.startswith(ACTS_LATE)
    what = "dead time" if is_dead_time else "delay"
    return f"an advance of {where} in the record looks the same as a {what} of {late.where}"


def _as_dry_friction(
    found: Findings, effect: Effect, parameters: Sequence[Estimated]
) -> list[Alternative]:
    """Dry friction where a constant force opposes a motion that never reverses: the same there."""
    model = found.at.model
    if effect.kind != "offset" or effect.shape or effect.where not in model.balances:
        return []
    place = place_named(model, effect.where)
    if not place.is_mechanical or not parameters:
        return []
    motion = sizes_of(found.at, found.search.recorded).motion_of(place.velocity)
    if not motion.is_signed or motion.mean * parameters[0].value >= 0.0:
        return []
    why = f"acts as the same constant where {place.velocity_name} keeps its sign, as in this record"
    return [Alternative("coulomb_friction", effect.where, 1.0, why, has_reason=True)]


def with_the_sign(turned: WrongSign, causes: list[Cause], before: Fit, after: Fit) -> list[Cause]:
    """The causes with the wrong sign first: the others were found with the sign corrected."""
    alternatives = tuple(
        Alternative(
            "sensor_scale", c, p, "negated, it fits as well: check the axes of both sensors"
        )
        for c, p in turned.rivals.items()
    )
    first = Cause(
        kind="sensor_scale",
        where=turned.channel,
        p_value=turned.p_value,
        parameters=(Estimated("scale", -1.0, "1", note="only the sign was tested"),),
        alternatives=alternatives,
        sentence=f"the channel {turned.channel} probably has the wrong sign, a scale of -1",
    )
    return _with_first(first, causes, before, after)


def with_the_sizes(shown: Rectified, causes: list[Cause], before: Fit, after: Fit) -> list[Cause]:
    """The causes with a channel of absolute values first: the others were found with it."""
    first = Cause(
        kind="rectified",
        where=shown.channel,
        p_value=shown.p_value,
        parameters=(Estimated(shown.name, 1.0, "1", note=SWITCHED_ON),),
        sentence=says_kind("rectified", shown.channel),
    )
    return _with_first(first, causes, before, after)


def _with_first(first: Cause, causes: list[Cause], before: Fit, after: Fit) -> list[Cause]:
    """Causes behind one that was found before all others, by the misfit that it explains."""
    old, new = (_square_over_spread(fit) for fit in (before, after))
    share = max(old - new, 0.0) / max(old, TINY)
    return [
        replace(first, share=share),
        *(replace(c, share=(1 - share) * c.share) for c in causes),
    ]


def _square_over_spread(fit: Fit) -> float:
    """Sum of squared errors, every output in units of its spread."""
    c = fit.criterion
    parts = (c.simulated(fit.x, e).residual / c.spread for e in range(len(c.data)))
    return float(sum(np.sum(part**2) for part in parts))


def _unit(search: Search, channel: str) -> str:
    """Unit of a channel in the records searched."""
    return str(search.weighing.experiments[0].record.units.get(channel, "1"))
