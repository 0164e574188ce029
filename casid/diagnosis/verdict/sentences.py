"""Sentences of a diagnosis: each kind of effect, the verdict, and the next experiment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from casid.arrays import TINY
from casid.data.problem import Problem
from casid.diagnosis.evidence.disturbances import Disturbance, is_seen, shown_source
from casid.diagnosis.evidence.whitening.weighted_model import Weighted
from casid.diagnosis.search.candidates import Candidate, Rival
from casid.diagnosis.thresholds import COMPARISON, DESCRIPTION, JUDGING
from casid.diagnosis.verdict.cause import NO_DOUBTS, Alternative, Cause, Doubts, Verdict
from casid.model.effects.channels.channel_effects import COURSES
from casid.model.effects.effect import OF_SAMPLES, Effect
from casid.model.effects.names import (
    BESIDE_ITS_ZERO,
    BY_ANOTHER_GAIN,
    CLAMP,
    FOR_ONE_SAMPLE,
    GAIN_OF_INPUT,
    GROWS,
    OPPOSES,
    OVERFLOW,
    RADIATION,
    RATE,
    RATE_LIMIT,
    RECORDED_LATE,
    TOGETHER,
    constant_quantity,
    effect_words,
    either_words,
    law_of,
    place_of_law,
    place_words,
)
from casid.model.effects.parameter_effects import is_scheduled_by_power
from casid.model.identifiers import made_identifier
from casid.model.model import Model
from casid.model.quantities import instant_text, quantity_text, quantity_texts, while_text

_SAYS = {
    "quadratic_damping": "damping that grows with the rate squared acts in {place}",
    "cubic_damping": "damping that grows with the cube of the rate acts in {place}",
    "coulomb_friction": "dry (Coulomb) friction acts in {place}",
    "asymmetric_friction": "friction is larger in one direction than in the other in {place}",
    "stribeck_friction": "friction that falls as the motion begins (Stribeck) acts in {place}",
    "cubic_stiffness": "{restoring} is not linear: it has a cubic term",
    "quadratic_stiffness": "{restoring} is not linear: it is stiffer to one side",
    "deadzone": "{restoring} has play (a dead zone)",
    "backlash": "the coupling of {where} has play (backlash)",
    "end_stop": "a stop limits the motion in {place}",
    "cogging": "a force that is periodic in the position (cogging) acts in {place}",
    "offset": "a constant {quantity} acts in {place}",
    "periodic_disturbance": "an unrecorded periodic disturbance acts in {place}",
    "parameter_drift": "the parameter {where} drifts during the record",
    "extra_input": "the recorded channel {where}, which the model omits, acts {on}",
    "parameter_jump": "the parameter {where} changes during the record",
    "scheduled_parameter": "the parameter {own} changes with {source}",
    "sensor_bias": "the channel {where} has a constant bias",
    "time_delay": "the channel {where} is delayed",
    "sensor_scale": "the gain of the sensor of {where} differs from the model's",
    "sensor_lag": "the sensor of {where} has a first-order lag",
    "cross_axis": "the sensor of {where} is also sensitive to another channel",
    "hold": "the input {where} behaves between samples in another way than the model assumes",
    "actuator_lag": "the input {where} acts with a first-order lag",
    "missing_mode": "an unmodelled oscillating part reacts on {place}",
    "actuator_saturation": "the input {where} saturates at a limit",
    "saturation": "the channel {where} is clipped",
    "rectified": "the channel {where} shows the absolute value",
    "lever_arm": "the sensor of {where} is mounted away from the assumed point",
    "outliers": "the channel {where} has isolated outliers",
}


_SEPARATES = {
    "quadratic_damping": "free decays from a large and a small amplitude",
    "cubic_damping": "free decays from a large and a small amplitude",
    "asymmetric_friction": "the same motion in both directions",
    "stribeck_friction": "motion that is reversed slowly, and at speed",
    "quadratic_stiffness": "the same motion to both sides, and a static deflection",
    "backlash": "motion well inside the play and far beyond it, and an impact across it",
    "end_stop": "motion up to the stop, and well within it",
    "cogging": "slow turning through several periods, at two speeds",
    "actuator_saturation": "a record at half the command",
    "rectified": "a record in which {where} passes through zero, beside a sensor that shows its "
    "sign",
    "lever_arm": "rotation about another point, or a second sensor at a known distance",
    "coulomb_friction": "slow motion and free decays to rest, where dry friction dominates",
    "cubic_stiffness": "excitation at two clearly different amplitudes",
    "deadzone": "motion well inside the play and far beyond it",
    "offset": "a stretch in which everything rests, or the same motion in the other direction",
    "periodic_disturbance": "a record without excitation, whose spectrum shows the line alone",
    "parameter_drift": "a record that starts where the present one ends",
    "unknown": "excitation at several amplitudes and frequencies",
    "extra_input": "a record in which {where} moves while everything else rests",
    "parameter_jump": "a record under constant conditions, with a note of every change of "
    "load or setting",
    "scheduled_parameter": "records in each of which {source} is held, at different values",
    "sensor_bias": "a stretch in which {where} is known, at rest or beside a reference instrument",
    "time_delay": "wide-band excitation, and a sudden change that every channel records at once",
    "sensor_scale": "{where} beside a reference instrument, over its whole range",
    "sensor_lag": "excitation at frequencies well above one over its time constant, where a lag "
    "also attenuates and a delay does not",
    "cross_axis": "a record in which only the other channel moves",
    "hold": "excitation near a third of the sampling rate; or look whether {where} is held, as a "
    "command is, or smooth, as a measured signal is",
    "actuator_lag": "fast steps of the command, with the actuator's own position recorded",
    "missing_mode": "a step and a long rest after it, in which the missing part moves alone",
    "saturation": "a record at half the amplitude",
    "outliers": "a check of the logger: cable, range, radio link",
}


_SEPARATES_LAWS = {
    OPPOSES: "small and large values of both signs: what is constant does not grow with them",
    GROWS: "steady states at several clearly different levels",
    OVERFLOW: "a record that stays below the limit, and one that goes beyond it",
    CLAMP: "a record that stays below the limit, and one that goes beyond it",
}
"""The same of laws that circuits and stores have."""


_OF_RELATIVES = {
    "quadratic_damping": "a resistance that grows with the square of {where} is missing",
    "cubic_damping": "a resistance that grows with the cube of {where} is missing",
}


_FORCES = ("force", "torque", "moment")
"""Balances that are called by what restores in them."""


_STEADY = ("offset", "sensor_bias", "sensor_scale")
"""Kinds that hold all the time, or from an instant on."""


_OF_COMMANDS = {
    "backlash": "the command {where} acts through play (backlash)",
    "deadzone": "the command {where} acts only beyond a dead zone",
}


def says_kind(
    kind: str,
    where: str,
    *,
    is_relative: bool = False,
    is_command: bool = False,
    on: str = "on the system",
    quantity: str = "term",
) -> str:
    """A kind of the catalogue in words; where its place is a relative motion, or a command.

    Parameters
    ----------
    on : what a further input acts on.
    quantity : what is constant in a balance: a torque, a voltage.
    """
    if is_command and kind in _OF_COMMANDS:
        return _OF_COMMANDS[kind].format(where=where)
    if is_relative and kind in _OF_RELATIVES:
        return _OF_RELATIVES[kind].format(where=where)
    place = f"the relative motion {where}" if is_relative else f"the {where} balance"
    if TOGETHER in where:
        place = f"the plane of {where}"
    restoring = f"the restoring {where if where in _FORCES else f'term of {place}'}"
    restoring = f"the spring that acts on {where}" if is_relative else restoring
    own, _, source = where.partition("~")
    if kind == "actuator_lag" and ", " in where:
        return f"{_inputs_do(where, 'acts')} with one first-order lag"
    return _SAYS[kind].format(
        where=where,
        place=place,
        restoring=restoring,
        own=own,
        source=source,
        on=on,
        quantity=quantity,
    )


_OF_SEVERAL = {RECORDED_LATE: "are recorded later than they act, by one time"}


def _inputs_do(where: str, does: str) -> str:
    """An input, or several with commas between them, and what they do: "the inputs u, v act"."""
    if ", " in where:
        does = _OF_SEVERAL.get(does, does.replace("acts", "act", 1))
        return f"the inputs {where} {does}"
    return f"the input {where} {does}"


def _drift_time(effect: Effect) -> str:
    """From when to when an effect drifts."""
    start, stop = (quantity_text(effect.constants[end], "s") for end in ("start", "stop"))
    return f"from {start} to {stop}"


def _says_constant(effect: Effect) -> str:
    """A constant term, bias or gain that has more to it than its kind, or an empty text."""
    if "stop" in effect.constants:
        return f"{effect.description} (its size is what it grows to {_drift_time(effect)})"
    if effect.description == BESIDE_ITS_ZERO:
        acts = f"as {effect.where} - {effect.parameters[0].name}"
        return (
            f"the command {effect.where} {effect.description}, {acts} (an error of the actuator, "
            "or a constant part beside it that is not recorded)"
        )
    if effect.description == BY_ANOTHER_GAIN:
        return f"the command {effect.where} {effect.description}"
    return effect.description if effect.is_on_the_clock else ""


def says_rate_limit(where: str, rate: str) -> str:
    """An actuator's largest rate in words, a cause's sentence without its capital."""
    return f"the actuator of {where} moves at no more than {rate}"


def says(effect: Effect, column: str = "") -> str:
    """One effect in words, a cause's sentence without its capital.

    Parameters
    ----------
    column : of the file that a missing input is read from, named where its channel is not.
    """
    if effect.kind == "extra_input":
        of = f" (column {column!r})" if column and column != effect.where else ""
        on = f"in the {effect.shape} balance" if effect.shape else "on the system"
        return effect.description or says_kind(effect.kind, f"{effect.where}{of}", on=on)
    if effect.end is not None:
        start, stop = effect.constants["time"], effect.constants["end"]
        if effect.description.endswith(FOR_ONE_SAMPLE):
            lasts = quantity_text(stop - start, "s")
            how = f": an impulse of that times {lasts}" if effect.kind == "offset" else ""
            return f"{effect.description}, at {instant_text(start, stop - start)}{how}"
        return f"{effect.description}, from {while_text(start, stop)}"
    if effect.kind in _STEADY and (text := _says_constant(effect)):
        return text
    if effect.kind == "parameter_drift" and "stop" in effect.constants:
        change = f"its change is that {_drift_time(effect)}, its value the one in the middle"
        return f"{says_kind(effect.kind, effect.where)} ({change})"
    if effect.is_store or is_scheduled_by_power(effect) or _is_of_flow(effect):
        return effect.description
    if effect.shape == RATE:
        return says_rate_limit(effect.where, "a rate")
    law = law_of(effect.kind, effect.description)
    if law and effect.kind != "offset":
        comma = "," if "," in law else ""
        return f"{law}{comma} is missing{place_of_law(law, effect.where)}"
    if effect.kind == "time_delay" and effect.description:
        return _inputs_do(effect.where, effect.description)
    if effect.kind == "hold" and effect.description:
        one, is_one = ("the input", "is") if "," not in effect.where else ("the inputs", "are")
        course = f'{effect.description} (hold="{HOLD_OF[effect.description]}")'
        return f"{one} {effect.where} {is_one} {course}, unlike in the model"
    if effect.kind in _SAYS:
        of_command = effect.parameters[0].name == made_identifier(f"gap_{effect.where}")
        return says_kind(
            effect.kind,
            effect.where,
            is_relative="acts on " in effect.description,
            is_command=of_command,
            quantity=constant_quantity(effect.description),
        )
    if effect.description.startswith(RADIATION):
        return f"{effect.description} is missing"
    what = effect.description or f"{effect.kind} acts"
    if effect.kind == "unknown":
        return f"an unidentified term in {effect.where}, best described as: {what}"
    return f"{what} ({effect.kind} in {effect.where})"


def _is_of_flow(effect: Effect) -> bool:
    """True of an output that also shows the flow into a store."""
    return effect.kind == "cross_axis" and bool(effect.description)


HOLD_OF = {text: hold for hold, text in COURSES.items()}
"""What a hold has an input do -> how it is declared."""


def declares(causes: Sequence[Cause]) -> str:
    """How to declare the holds among the causes in the problem file; "" where there is none."""
    holds = [c for c in causes if c.kind == "hold" and c.description in HOLD_OF]
    each = [f'hold="{HOLD_OF[c.description]}" for {c.where}' for c in holds]
    if not each:
        return ""
    return f"Declare {' and '.join(each)} in the problem file: no equation changes."


def separates(kind: str, where: str = "", description: str = "") -> str:
    """The experiment that separates a kind from its rivals; of a user's kind, that of any shape.

    Parameters
    ----------
    description : of the cause: a command that acts beside its zero has no sensor to turn over.
    """
    if description == BESIDE_ITS_ZERO:
        return "the command held at several values, with the actuator's own position recorded"
    if description == RATE_LIMIT:
        return "steps of the command of several sizes, with the actuator's own position recorded"
    if description.startswith(GAIN_OF_INPUT):
        return "the same input before and after, with what the actuator does recorded beside it"
    if kind == "cross_axis" and description:
        return "steps of what flows there: over a resistance they show at once"
    law = law_of(kind, description)
    if kind == "offset" and constant_quantity(description) not in (*_FORCES, "term"):
        return _SEPARATES_LAWS[GROWS]
    for what, experiment in _SEPARATES_LAWS.items():
        if what in law:
            return experiment
    channel, _, source = where.partition(": ")[0].partition("~")
    text = _SEPARATES.get(kind, _SEPARATES["unknown"])
    return text.format(where=channel, source=source or "the state")


def why_alternative(best: Candidate, rival: Rival) -> str:
    """Why a rival cannot be rejected; what would separate it is the advice's matter."""
    other = rival.candidate
    gap = best.merit - other.merit
    by = f"{abs(gap):.1f}"
    lasts = other.effect.is_on_the_clock and other.effect.end is None
    as_one = f"as a {other.effect.shape}, " if lasts and other.effect.kind in _STEADY else ""
    if by == "0.0":
        return f"{as_one}explains the misfit equally well"
    if gap > COMPARISON.strong and rival.p_value >= 0.5:
        return f"{as_one}fits as closely, but noise of inputs has a part in that (BIC {by} worse)"
    word = "worse" if gap >= 0 else "better"
    how = "as well" if abs(gap) <= DESCRIPTION.as_well else word
    return f"{as_one}explains the misfit {how} (BIC {by} {word})"


def verdict_sentence(
    verdict: Verdict,
    causes: list[Cause],
    part: Mapping[str, Mapping[str, float]],
    why_undecided: str,
    problem: Problem,
    disturbances: Sequence[Disturbance] = (),
    why_untested: str = "",
    doubts: Doubts = NO_DOUBTS,
) -> str:
    """The diagnosis in one or two sentences."""
    if verdict == "undecided":
        return f"This record does not determine whether the model is adequate: {why_undecided}."
    if verdict == "adequate":
        text = "o effect of the catalogue is significant and improves the held-out part"
        if doubts.said:
            text = f"N{text}, but {doubts.said}."
        else:
            text = f"Nothing in this record contradicts the model: n{text}."
        return text + _says_disturbances(disturbances)
    text = _joined([_says_cause(c) for c in causes])
    what = "it" if len(causes) == 1 else "them"
    if not all(c.parameters for c in causes):
        named = any(c.parameters for c in causes)
        what = "the named causes" if named else "the nearest effect of the catalogue"
    untested = f" Nothing else was tested: {why_untested}." if why_untested else ""
    apart = f" Beside that, {doubts.worst}." if doubts.worst else ""
    if all(c.kind in OF_SAMPLES for c in causes) and not untested:
        apart = _beside_samples(why_undecided, disturbances, doubts)
    return f"{text[0].upper()}{text[1:]}.{_gain(part, problem, what)}{apart}{untested}"


def _says_disturbances(disturbances: Sequence[Disturbance]) -> str:
    said = "; ".join(d.sentence for d in disturbances)
    return f" {said[0].upper()}{said[1:]}." if said else ""


def _beside_samples(why_undecided: str, disturbances: Sequence[Disturbance], doubts: Doubts) -> str:
    """What is known of the model itself, where only samples of a sensor are wrong."""
    if why_undecided:
        return f" Whether the model is adequate without them is not known: {why_undecided}."
    rest = f" They do not explain all: {doubts.said}." if doubts.said else ""
    return rest + _says_disturbances([d for d in disturbances if d.is_dominant])


def _gain(part: Mapping[str, Mapping[str, float]], problem: Problem, what: str) -> str:
    """By how much including the causes lowers, or raises, the errors that it changes.

    An error that rises by less than `JUDGING.practical`, or stays below its noise floor, is the
    same.
    """
    lowered: list[str] = []
    raised: list[str] = []
    for output, before in part.get("baseline_rmse", {}).items():
        after = part.get("extended_rmse", {}).get(output, before)
        sizes = [problem.model.shown_size(output, e) for e in (before, after)]
        (old, new), unit = quantity_texts(sizes, problem.model.unit_of(output))
        floor = part.get("noise_floor", {}).get(output, 0.0)
        is_worse = after > max((1 + JUDGING.practical) * before, floor)
        if new != old and (after < before or is_worse):
            changed = f"{output} from {old} to {new} {unit}".rstrip()
            (raised if is_worse else lowered).append(changed)
    if lowered:
        more = f", and raises that of {', '.join(raised)}" if raised else ""
        return f" Including {what} lowers the RMS error of {', '.join(lowered)}{more}."
    return f" Including {what} raises the RMS error of {', '.join(raised)}." if raised else ""


_OPEN = "the model lacks one of these, and this record does not separate them: "
_NEVER = "the model lacks one of these, and no record of these channels can separate them: "


def _joined(said: Sequence[str]) -> str:
    """Causes in one sentence; that the record does not separate what they may be stands once."""
    out: list[str] = []
    for text in said:
        for opening in (_OPEN, _NEVER):
            if any(opening in before for before in out):
                text = text.replace(opening, "and one of these: ")
        out.append(text)
    return "; ".join(out)


def _says_cause(c: Cause) -> str:
    """A cause in words, or everything that it may be."""
    if not c.tied:
        return c.sentence
    every: list[Cause | Alternative] = [c, *c.alternatives]
    same = partial(effect_words, c.kind, description=c.description)
    if all((e.kind, e.words) == (c.kind, same(e.where)) for e in every):
        # The place alone is open.
        places = either_words(place_words(a.where) for a in c.alternatives if a.where != c.where)
        return f"{c.sentence} (this record does not separate it from the same effect in {places})"
    words = [c.words, *(a.words for a in c.alternatives)]
    words = list(dict.fromkeys(words))
    if len(words) > DESCRIPTION.names:
        first = words[: DESCRIPTION.names - 1]
        words = [*first, f"one of {len(words) - len(first)} others"]
    return f"{_NEVER if c.is_inseparable else _OPEN}{either_words(words)}"


def noise_text(at: Weighted, *, is_all: bool = False) -> dict[str, str]:
    """Channel or balance -> the noise found there, where it makes a part of the residual.

    Parameters
    ----------
    is_all : the residual is consistent with noise. What an input could have of it at most, and what
        a force could, is then noise of the outputs, and implies nothing.
    """
    text_of, records = partial(_size_text, at.model), range(len(at.criterion.experiments))
    left = np.sqrt(np.mean([at.full.floor(e) ** 2 for e in records], axis=0))
    out = {
        name: f"white output noise {_output_noise_text(at, name, sd)}"
        if sd > DESCRIPTION.noiseless * rms
        else "no white output noise found: other sources account for its error"
        for name, sd, rms in zip(
            at.criterion.outputs, at.full.output_sd.tolist(), left.tolist(), strict=True
        )
    }
    for source, sd in at.full.source_sd.items():
        if sd <= 0:
            continue
        if source in at.model.inputs:
            own = at.input_sd.get(source, 0.0)
            moves = max(float(np.std(e.record[source])) for e in at.criterion.experiments)
            is_found = own > DESCRIPTION.no_noise * moves
            if own <= 0 and not is_seen(at, source):
                continue
            text = (
                f"white input noise {text_of(source, own)}" if is_found else "no white noise found"
            )
            if not is_all and sd > moves:
                text += (
                    f"; the residual implies more than the motion of {source} itself "
                    f"({text_of(source, moves)}): it is model error, not noise of {source}"
                )
            elif not is_all and sd > JUDGING.more_noise * max(own, TINY):
                most = text_of(source, sd)
                text += f"; the residual implies up to {most}: a disturbance or model error"
        elif not is_all and is_seen(at, source):
            size = quantity_text(*shown_source(at.model, at.full, source, sd))
            text = f"random disturbance, standard deviation {size}"
        else:
            continue
        out[source] = text
    return out


def _size_text(model: Model, name: str, sd: float) -> str:
    """A standard deviation of a channel, in its declared unit."""
    return quantity_text(model.shown_size(name, sd), model.unit_of(name))


def _output_noise_text(at: Weighted, name: str, sd: float) -> str:
    """Noise of an output in words: a share of the reading where it grows with that."""
    size = at.criterion.experiments[0].noise_sizes.get(name)
    if size is None or not size.per_reading:
        return _size_text(at.model, name, sd)
    least = _size_text(at.model, name, sd * size.at_zero)
    return f"{100 * sd * size.per_reading:.2g} % of the reading, {least} at least"
