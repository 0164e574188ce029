"""The remainder of the misfit with the causes included, and the parameters that they moved."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from casid.data.files import plain_fields
from casid.diagnosis.thresholds import DESCRIPTION, JUDGING, RESIDUAL
from casid.estimation.estimate import Estimate, Estimated
from casid.model.effects.effect import OF_SAMPLES


@dataclass(frozen=True, slots=True)
class Moved:
    """A parameter of the baseline that moved when the missing causes were included, in `unit`."""

    name: str
    unit: str
    before: float  # fitted without the causes
    after: float  # fitted with them
    std_error_after: float | None  # None: at a bound
    std_error_before: float | None = None

    def in_unit(self, unit: str) -> Moved:
        """The parameter in another unit of its dimension."""
        before = Estimated(self.name, self.before, self.unit, std_error=self.std_error_before)
        after = Estimated(self.name, self.after, self.unit, std_error=self.std_error_after)
        before, after = before.in_unit(unit), after.in_unit(unit)
        return Moved(self.name, unit, before.value, after.value, after.std_error, before.std_error)

    @property
    def bias(self) -> float:
        """The bias of the estimate that omitting the causes gave."""
        return self.before - self.after

    @property
    def shift(self) -> float | None:
        """Signed shift of the parameter in the larger of both fits' standard errors.

        Whatever the correlation r of the two estimates, the error of their difference lies between
        s1 - s2 and s1 + s2, and is the larger one, s1, at r = s2 / (2 s1).
        """
        if not self.std_error_after or not math.isfinite(self.bias):
            return None
        return (self.after - self.before) / max(self.std_error_after, self.std_error_before or 0.0)

    def to_json(self) -> dict[str, Any]:
        """Part of `diagnosis.json`."""
        return plain_fields(self, "bias", "shift")


@dataclass(frozen=True, slots=True)
class Explained:
    """Share of the excess misfit that one cause explains."""

    kind: str
    where: str
    share: float  # of the excess misfit, 0..1
    description: str = ""  # of the effect, for its name in words

    def to_json(self) -> dict[str, Any]:
        """Part of `diagnosis.json`."""
        return plain_fields(self)


@dataclass(frozen=True, slots=True, eq=False)
class NoiseFound:
    """The noise that a remainder is compared with.

    Attributes
    ----------
    coloured : output -> what its autocorrelated residual is like (`Agreement.coloured`).
    is_random : the remainder is a disturbance, and no deficiency of the model.
    is_poor : it moves an output, and the recorded inputs hardly do.
    is_of_inputs : noise of measured inputs was found, which colours a residual.
    chance : output -> how far above the floor its error may be by chance (`chance_over_floor`).
    held_out : output -> the error of what was held out over its floor, where the errors that count
        are those of the fitted part.
    is_predicted : what was held out is predicted, sample by sample, as well as what was fitted.
    """

    coloured: Mapping[str, str] = field(default_factory=dict)
    is_random: bool = False
    is_poor: bool = False
    is_of_inputs: bool = True
    chance: Mapping[str, float] = field(default_factory=dict)
    held_out: Mapping[str, float] = field(default_factory=dict)
    is_predicted: bool = False

    def further_off(self, over: Mapping[str, float]) -> str:
        """The output that is `JUDGING.unlike` times as far off where it was held out, or empty.

        Parameters
        ----------
        over : output -> its error over its floor, in the fitted part.
        """
        limits = {o: JUDGING.unlike * max(ratio, 1.0) for o, ratio in over.items()}
        held = {o: r for o, r in self.held_out.items() if r > limits.get(o, math.inf)}
        return max(held, key=lambda o: held[o]) if held else ""

    @property
    def coloured_by(self) -> str:
        """The source of the residual's autocorrelation; empty where it is not known."""
        if self.is_random:
            return "the disturbance"
        return "noise of measured inputs" if self.is_of_inputs else ""


@dataclass(frozen=True, slots=True, eq=False)
class Remaining:
    """The remainder of the misfit when every named cause is in the model.

    The excess misfit is the baseline's squared error above the noise floor, in units of the floor
    and added over the outputs.
    """

    explained: tuple[Explained, ...]  # in the order of contribution
    unexplained: float  # share of the excess misfit, 0..1
    over_floor: Mapping[str, float] = field(default_factory=dict)  # output -> rms after over floor
    p_value: float | None = None  # of the test of the remainder; None: not tested
    test: str = ""  # which test that was
    sentence: str = ""

    def to_json(self) -> dict[str, Any]:
        """Part of `diagnosis.json`."""
        return plain_fields(self)


def moved_parameters(
    baseline: Estimate, extended: Estimate, *, at_least: float = JUDGING.moved
) -> tuple[Moved, ...]:
    """Parameters that both fits estimate and that moved, the furthest in standard errors first.

    Parameters
    ----------
    at_least : smallest move reported, in standard errors (`Moved.shift`; a heuristic). Were the
        causes absent, a move would vary with the difference of both fits' variances (Hausman,
        Econometrica 46 (1978) 1251-1271, section 2), which is below the larger of them: at 2 a
        parameter is listed by chance in less than one case in twenty. Where a missing cause makes
        the residual of the baseline large, so is its own error, which then judges.

    Returns
    -------
    Parameters at a bound after the extension have no standard error; they come last, and only
    where their value has changed.
    """
    after = {p.name: p for p in extended.parameters if not p.known}
    found = []
    for p in baseline.parameters:
        q = after.get(p.name)
        if p.known or q is None or not (math.isfinite(p.value) and math.isfinite(q.value)):
            continue
        m = Moved(p.name, p.unit, p.value, q.value, q.std_error, p.std_error)
        # A parameter that stays at its bound comes back with the solver's last digits changed.
        same = math.isclose(p.value, q.value, rel_tol=1e-6, abs_tol=1e-12)
        if (m.shift is None and not same) or abs(m.shift or 0.0) >= at_least:
            found.append(m)
    found.sort(key=lambda m: -abs(m.shift) if m.shift is not None else 0.0)
    return tuple(found)


def what_remains(
    shares: Iterable[tuple[str, str, float]],
    part: Mapping[str, Mapping[str, float]],
    *,
    p_value: float | None = None,
    test: str = "",
    false_alarm_rate: float = 0.05,
    noise: NoiseFound | None = None,
    descriptions: Mapping[tuple[str, str], str] | None = None,
) -> Remaining | None:
    """The remainder of the misfit, from the RMS errors of one part of the records.

    Parameters
    ----------
    shares : kind, place and share of every cause, in the order of contribution; the shares are of
        the misfit that all causes together removed (`Cause.share`).
    part : `Diagnosis.held_out`, or `Diagnosis.fitted` where nothing was held out: output -> value
        under "baseline_rmse", "extended_rmse" (empty where nothing was named) and "noise_floor".
    p_value, test : of the test of the remaining residual, and the test's name.
    false_alarm_rate : below it, the test rejects that the remainder is noise.
    noise : what is known of the noise; white, and without chance in the errors, where not given.
    descriptions : kind and place of a cause -> its description.

    Returns
    -------
    None where no output has both an error and a noise floor.
    """
    over = over_floors(part)
    if not over:
        return None
    baseline, floor = part["baseline_rmse"], part["noise_floor"]
    before = sum(max((baseline[o] / floor[o]) ** 2 - 1, 0.0) for o in over)
    after = sum(max(ratio**2 - 1, 0.0) for ratio in over.values())
    left = min(after / before, 1.0) if before > 0 else 0.0
    like = descriptions or {}
    explained = tuple(
        Explained(k, w, share * (1 - left), like.get((k, w), "")) for k, w, share in shares
    )
    return Remaining(
        explained=explained,
        unexplained=left,
        over_floor=over,
        p_value=p_value,
        test=test,
        sentence=_sentence(explained, left, over, is_above=before > 0)
        + _kind_of_remainder(over, p_value, false_alarm_rate, noise or NoiseFound()),
    )


def over_floors(part: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Output -> its error with the causes, or as it is without any, over its noise floor.

    Parameters
    ----------
    part : as for `what_remains`.
    """
    baseline, floor = part.get("baseline_rmse", {}), part.get("noise_floor", {})
    extended = part.get("extended_rmse") or baseline
    outputs = [o for o in extended if o in baseline and floor.get(o, 0.0) > 0]
    return {
        o: extended[o] / floor[o]
        for o in outputs
        if math.isfinite(baseline[o]) and math.isfinite(extended[o])
    }


def _sentence(
    explained: tuple[Explained, ...], left: float, over: Mapping[str, float], *, is_above: bool
) -> str:
    """Sentence on the share that the causes explain and the error over the noise floor.

    Parameters
    ----------
    is_above : an error of the model without the causes is above its floor.
    """
    worst = max(over, key=lambda o: over[o])
    times = f"{over[worst]:.3g}"
    at = "its noise floor" if times == "1" else f"{times} times its noise floor"
    if not explained:
        return f"No cause is named; the error of {worst} is at {at}."
    ends = f"the error of {worst} ends at {at}"
    if all(e.kind in OF_SAMPLES for e in explained):
        return f"Samples with a faulty sensor are left out; {ends}."
    causes = "causes" if len(explained) > 1 else "cause"
    if not is_above:
        return (
            f"No error is above its noise floor without the named {causes}, which the course of "
            f"the residual shows, and not its size; {ends}."
        )
    if left >= 1:
        nothing = "brings the errors no nearer to their noise floors"
        return f"Including the named {causes} {nothing}: {ends}."
    share = f"{100 * (1 - left):.0f} %"
    if left < JUDGING.nearly_all:
        share = "more than 99.5 %" if left > 0 else "all"
    elif 1 - left < JUDGING.nearly_all:
        share = "less than 0.5 %"
    explain = f"{causes} explain" if len(explained) > 1 else f"{causes} explains"
    return f"The named {explain} {share} of the excess misfit, and {ends}."


def _kind_of_remainder(
    over: Mapping[str, float],
    p_value: float | None,
    alpha: float,
    noise: NoiseFound,
) -> str:
    """Whether the remainder is noise: one answer from the test, the floor and the whiteness."""
    is_more = p_value is not None and p_value < alpha
    above = [o for o, ratio in over.items() if ratio > JUDGING.at_floor]
    is_above = any(over[o] > noise.chance.get(o, 0.0) for o in above)
    far = noise.further_off(over) if noise.is_random else ""
    if far:
        said = (
            "sample by sample it is predicted there as well as where it was fitted, so the "
            "disturbance makes it"
            if noise.is_predicted
            else "the disturbance was larger there, or the model does not hold there"
        )
        return (
            " So much for the fitted part, whose remainder passes for a random disturbance; held "
            f"out, the error of {far} is {noise.held_out[far]:.3g} times its noise floor: {said}."
        )
    if noise.is_random and (is_more or is_above):
        if noise.is_poor:
            return (
                " The remainder passes for a random disturbance, but so would an error of the "
                "model: it explains next to nothing itself."
            )
        return " The remainder is a random disturbance, not an error of the model."
    if is_more:
        like = "more than noise" if above else "no larger than the noise, but it is not random"
        return f" The remainder is {like}: part of the misfit is unexplained."
    if is_above:
        why = " that no effect of the catalogue explains" if p_value is not None else ""
        return f" An error above the floor remains{why}."
    by_chance = _by_chance(above, over, noise.chance) if above else ""
    what = "the remainder of the fitted part" if above else "the remainder"
    what = f"{by_chance} {what[:1].upper()}{what[1:]}"
    said = "; ".join(f"{output}: {text}" for output, text in noise.coloured.items())
    if p_value is None:
        also = f", and the residual is autocorrelated ({said})" if said else ""
        return by_chance or f" No error remains above the floor{also}."
    if not said:
        return f"{what} is consistent with noise."
    why = f", as {noise.coloured_by} makes it" if noise.coloured_by else ""
    return (
        f"{what} is consistent with the noise that was estimated, which is coloured: the residual "
        f"is autocorrelated ({said}){why}."
    )


def _by_chance(above: Sequence[str], over: Mapping[str, float], chance: Mapping[str, float]) -> str:
    """That no error above the floor is more than chance may give, and the number behind it."""
    worst = max(above, key=lambda o: over[o])
    limit = chance[worst]
    rare = f"in all but one record of {1 / RESIDUAL.held_out_chance:.0f}"
    if limit <= JUDGING.unlike:
        return (
            f" By chance and by the errors of the estimates it may be up to {limit:.3g} times the "
            f"floor in the held-out part ({rare})."
        )
    size = (
        f"of up to {limit:.2g}"
        if limit < DESCRIPTION.reported
        else f"of more than {DESCRIPTION.reported:g}"
    )
    return (
        " The held-out part tells little: it has few independent samples, or lies far from what "
        f"was fitted. An error there {size} times the floor may be due to chance and to the errors "
        f"of the estimates ({rare})."
    )
