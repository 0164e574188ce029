"""Targets of the diagnosis of a measured record, and rms errors of its parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import casid
from analysis.common.targets import Target


def named(
    what: str, diagnosis: casid.Diagnosis, wanted: set[str], most: int, *, first: bool
) -> Target:
    """The wanted kinds are among the causes, or the first of them, and not more than `most`."""
    kinds = [c.kind for c in diagnosis.causes]
    met = wanted <= set(kinds[: len(wanted)] if first else kinds) and len(kinds) <= most
    text = f"{' and '.join(sorted(wanted))} {'first' if first else 'named'}, at most {most}"
    return causes(what, diagnosis, text, met)


def causes(what: str, diagnosis: casid.Diagnosis, wanted: str, is_met: bool) -> Target:
    """The kinds of the causes, or the verdict where there are none."""
    found = ", ".join(c.kind for c in diagnosis.causes) or diagnosis.verdict
    return Target(what, found, wanted, is_met)


def few_causes(most: int, quick: bool) -> dict[str, Any]:
    """Settings of a diagnosis in short order: at most so many causes, and no plans."""
    return {"max_causes": most, "advise": False} if quick else {}


def rms_after(part: Mapping[str, Mapping[str, float]], output: str) -> float:
    """Rms error of the extended model, or of the model as it was where nothing was added."""
    return float(part.get("extended_rmse", part["baseline_rmse"])[output])


def rms_by_record(diagnosis: casid.Diagnosis, *, extended: bool) -> dict[str, float]:
    """Rms error of the first output over the fitted part of every record, by name.

    A record cut to a window has the window in its name, after an @: it is left off.
    """
    found = {}
    for r in diagnosis.records:
        simulated = r.extended if extended and r.extended is not None else r.baseline
        use = r.used[:, 0] & r.fitted
        error = (r.measured[:, 0] - simulated[:, 0])[use]
        found[r.name.partition("@")[0]] = float(np.sqrt(np.mean(error**2)))
    return found
