"""What a diagnosis says in words: of each kind, of the verdict, and of what to do next."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from casid.arrays import TINY
from casid.data.problem import Problem
from casid.diagnosis.evidence.prewhitening import Weighted
from casid.diagnosis.search.candidates import Candidate
from casid.diagnosis.thresholds import JUDGING
from casid.diagnosis.verdict.cause import Cause, Verdict
from casid.model.effects.effect import Effect

_SAYS = {
    "quadratic_damping": "damping that grows with the rate squared acts in the {where} balance",
    "coulomb_friction": "dry (Coulomb) friction acts in the {where} balance",
    "cubic_stiffness": "the restoring {where} is not linear: it has a cubic term",
    "deadzone": "the restoring {where} has play (a dead zone)",
    "offset": "a constant {where} acts on the system",
    "periodic_disturbance": "a periodic force that nobody recorded acts in the {where} balance",
    "parameter_drift": "the parameter {where} drifts during the record",
    "extra_input": "the recorded channel {where} acts on the system, which the model leaves out",
    "parameter_jump": "the parameter {where} changes during the record",
    "scheduled_parameter": "a parameter depends on a channel that the model leaves out: {where}",
    "sensor_bias": "the channel {where} has a constant bias",
    "time_delay": "the channel {where} arrives late",
    "sensor_scale": "the sensor of {where} has another gain than the model takes it to have",
    "sensor_lag": "the sensor of {where} follows with a first-order lag",
    "cross_axis": "the sensor of {where} also feels another channel",
    "hold": "the input {where} does not move between its samples as the model says",
    "actuator_lag": "the command {where} acts through a lag",
    "missing_mode": "a part that swings along acts back in the {where} balance",
    "saturation": "the channel {where} is clipped",
    "outliers": "the channel {where} has isolated outliers",
}


_SEPARATES = {
    "quadratic_damping": "free decays from a large and a small amplitude",
    "coulomb_friction": "slow motion and free decays to rest, where dry friction is all there is",
    "cubic_stiffness": "excitation at two clearly different amplitudes",
    "deadzone": "motion well inside the play and far beyond it",
    "offset": "a stretch at rest, or the same manoeuvre mirrored",
    "periodic_disturbance": "a record without excitation, where a line stands alone",
    "parameter_drift": "a second record, begun when the first has ended",
    "unknown": "excitation at several amplitudes and frequencies",
    "extra_input": "a record in which that channel moves while everything else rests",
    "parameter_jump": "a second record with all conditions held, and a note of when loads move",
    "scheduled_parameter": "records in each of which that channel is held, at different values",
    "sensor_bias": "a stretch at rest with the sensor turned over",
    "time_delay": "wide-band excitation, and a knock that all loggers see",
    "sensor_scale": "a known motion or load: the sensor against a reference",
    "sensor_lag": "excitation well above 1/tau, where a lag also attenuates and a delay does not",
    "cross_axis": "a record in which only the other channel moves",
    "hold": "excitation near a third of the sampling rate, or a look at what drives the actuator",
    "actuator_lag": "fast steps of the command, with the actuator's own position recorded",
    "missing_mode": "a slow sweep across the frequency found, or the part held fast",
    "saturation": "a record at half the amplitude",
    "outliers": "a look at the logger: cable, range, radio link",
}


def says_kind(kind: str, where: str) -> str:
    """A kind of the catalogue in words."""
    return _SAYS[kind].format(where=where)


def says(effect: Effect) -> str:
    """One effect in words, a cause's sentence without its capital."""
    if effect.kind in _SAYS:
        return says_kind(effect.kind, effect.where)
    what = effect.description or f"{effect.kind} acts"
    if effect.kind == "unknown":
        return f"{effect.where} lacks something that has no name here, like {what}"
    return f"{what} ({effect.kind} in {effect.where})"


def separates(kind: str) -> str:
    """What would tell a kind from its rivals; a user's kind is told as any shape is."""
    return _SEPARATES.get(kind, _SEPARATES["unknown"])


def why_alternative(best: Candidate, other: Candidate) -> str:
    """Why a rival cannot be rejected, and what would tell it from the named cause."""
    gap = best.merit - other.merit
    return (
        f"explains the misfit as well (BIC {abs(gap):.1f} {'worse' if gap >= 0 else 'better'}); "
        f"{separates(best.effect.kind)} would tell them apart"
    )


def verdict_sentence(
    verdict: Verdict,
    causes: list[Cause],
    part: Mapping[str, Mapping[str, float]],
    why_undecided: str,
    problem: Problem,
) -> str:
    """The diagnosis in one or two sentences."""
    if verdict == "undecided":
        return f"This record cannot tell whether the model is adequate: {why_undecided}."
    if verdict == "adequate":
        return (
            "Nothing in this record contradicts the model: no effect of the catalogue is "
            "significant and improves what was held out."
        )
    text = "; ".join(c.sentence for c in causes)
    gains = []
    for output, before in part.get("baseline_rmse", {}).items():
        after = part.get("extended_rmse", {}).get(output)
        if after is not None:
            unit = problem.model.outputs[output][1]
            gains.append(f"{output} from {before:.3g} to {after:.3g} {unit}")
    gain = f" Naming it brings the rms error of {', '.join(gains)}." if gains else ""
    return f"{text[0].upper()}{text[1:]}.{gain}"


def noise_text(at: Weighted) -> dict[str, str]:
    """Channel or balance -> what the noise found there is."""
    out = {
        name: f"white output noise {sd:.3g} {at.model.outputs[name][1]}"
        for name, sd in zip(at.criterion.outputs, at.full.output_sd.tolist(), strict=True)
    }
    for source, sd in at.full.source_sd.items():
        if sd <= 0:
            continue
        if source in at.model.inputs:
            own, unit = at.input_sd.get(source, 0.0), at.model.inputs[source].unit
            text = f"white input noise {own:.3g} {unit}"
            moves = max(float(np.std(e.record[source])) for e in at.criterion.experiments)
            if sd > moves:
                text += (
                    f"; the residual shows more than {source} itself moves ({moves:.3g} {unit}): "
                    f"it is no noise of {source}, but a misfit"
                )
            elif sd > JUDGING.more_noise * max(own, TINY):
                text += f"; the residual shows as much as {sd:.3g}, a disturbance or a misfit"
        else:
            text = f"disturbance {sd:.3g} {at.model.balances[source].unit} a sample"
        out[source] = text
    return out
