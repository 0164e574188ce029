"""What a designed experiment is for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from casid.argument_types import methods_name_wrong_types
from casid.errors import DataError
from casid.experiment_design.thresholds import DESIGN

Kind = Literal["estimate", "separate", "detect", "identifiable"]
OPTIMALITY = ("D", "A", "E")


@methods_name_wrong_types()
@dataclass(frozen=True, slots=True)
class Aim:
    """What a designed experiment is for; made by one of the methods below.

    Attributes
    ----------
    kind : "estimate", "separate", "detect" or "identifiable".
    names : parameters, or causes as `kind` or `kind@where`.
    optimality : of an estimate, "D", "A" or "E".
    function : of parameters, whose variance is minimised; empty without one.
    false_alarm_rate : of the detection.
    relative_error : standard error over value, up to which a parameter counts as identifiable.
    """

    kind: Kind
    names: tuple[str, ...] = ()
    optimality: str = "D"
    function: str = ""
    false_alarm_rate: float = 0.05
    relative_error: float = DESIGN.relative_error

    @classmethod
    def estimate(cls, *parameters: str, optimality: str = "D") -> Aim:
        """Estimate parameters (default: all unknown ones), the others being nuisance.

        `optimality` "D" maximises the determinant of the information, which needs no units; "A"
        minimises the mean of the relative variances, "E" the variance in the worst direction of
        relative changes (Atkinson and Donev 1992; Kiefer 1974).

        Raises
        ------
        DataError
            If the criterion is none of the three.
        """
        if optimality not in OPTIMALITY:
            raise DataError(f"optimality {optimality!r} is not known; use 'D', 'A' or 'E'")
        return cls("estimate", parameters, optimality)

    @classmethod
    def variance_of(cls, function: str) -> Aim:
        """Minimise the variance of one function of the parameters, as ``"m * z_m"``."""
        return cls("estimate", (), function=function)

    @classmethod
    def separate(cls, *causes: str) -> Aim:
        """Name the right one of several causes, each as `kind` or `kind@where`.

        Raises
        ------
        DataError
            If there are fewer than two causes, or one is given twice.
        """
        if len(set(causes)) < max(len(causes), 2):
            raise DataError(
                f"separate {', '.join(causes) or 'nothing'}: give at least two causes, each once, "
                "for example quadratic_damping,coulomb_friction"
            )
        return cls("separate", causes)

    @classmethod
    def detect(cls, cause: str, *, false_alarm_rate: float = 0.05) -> Aim:
        """Detect a cause, given as `kind` or `kind@where`, at a rate of false alarms.

        Raises
        ------
        DataError
            If the rate does not lie between 0 and 0.5.
        """
        if not 0 < false_alarm_rate < 0.5:
            raise DataError(
                f"a false-alarm rate of {false_alarm_rate:g}: give one between 0 and 0.5"
            )
        return cls("detect", (cause,), false_alarm_rate=false_alarm_rate)

    @classmethod
    def identifiable(cls, *parameters: str, relative_error: float = DESIGN.relative_error) -> Aim:
        """Find the cheapest input with which every parameter has a small enough standard error.

        `relative_error` is the largest standard error over the parameter's value; the input's
        energy is what is minimised.

        Raises
        ------
        DataError
            If the relative error is no positive number.
        """
        if not 0 < relative_error < float("inf"):
            raise DataError(f"a relative error of {relative_error:g}: give a positive number")
        return cls("identifiable", parameters, relative_error=relative_error)

    @classmethod
    def of(cls, diagnosis: object) -> Aim:
        """Separate what a diagnosis could not: the first cause with alternatives, and these.

        Of the alternatives the likeliest are taken, and those that have a name: a mere shape is no
        hypothesis to design for.

        Raises
        ------
        DataError
            If it has no such tie.
        """
        found = tie_of(diagnosis)
        if found:
            return cls.separate(*found)
        raise DataError(
            f"{diagnosis!r} ended without a tie between causes; say what the next record is for: "
            "Aim.separate(a, b), Aim.detect(a) or Aim.estimate(m), or --separate, --detect, "
            "--estimate"
        )

    def __str__(self) -> str:
        """In words."""
        if self.kind == "separate":
            return "separate " + " from ".join(self.names)
        if self.kind == "detect":
            return f"detect {self.names[0]}"
        what = self.function or ", ".join(self.names) or "every unknown parameter"
        if self.kind == "identifiable":
            return f"make identifiable {what}, each to {100 * self.relative_error:.3g} %"
        return f"estimate {what}" + ("" if self.function else f" ({self.optimality}-optimal)")


def tie_of(diagnosis: object) -> tuple[str, ...]:
    """The first cause of a diagnosis that has alternatives with a name, and these; or nothing."""
    for cause in getattr(diagnosis, "causes", ()):
        rivals = [c for c in (cause, *cause.alternatives) if c.kind != "unknown"]
        names = tuple(dict.fromkeys(f"{c.kind}@{c.where}" for c in rivals))
        if len(names) > 1:
            return names[: DESIGN.rivals]
    return ()
