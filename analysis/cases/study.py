"""Records with a hidden effect: is the first cause named the one that was hidden?

    python -m analysis.cases [--quick] [--out DIR]

Pendulum on a cart, synthesised by an independent simulator; `strength` is the rms misfit that the
best linear refit leaves, in units of the gyro's noise. Wanted: a kind that the catalogue has, at a
strength of 0.4 or more, is the first cause, with at most one further cause; a record without a
hidden effect is not called deficient. Other kinds are shown without a target.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import casid
from analysis.common.runner import Run, Study, shared_folder
from analysis.common.targets import Target
from casid.diagnosis.diagnosis import Cause
from problems import pendulum

KINDS = {
    "quadratic_damping",
    "coulomb_friction",
    "cubic_stiffness",
    "offset",
    "sensor_bias",
    "time_delay",
    "extra_input",
    "parameter_jump",
    "scheduled_parameter",
    "saturation",
    "outliers",
}
QUICK = ("case_001", "case_006", "case_013", "case_015")
MOVED_BY_A_LOAD = {"m", "I_x", "M", "z_g", "k", "d"}  # any of them may stand for a load


def _is_it(cause: Cause, truth: dict[str, Any]) -> bool:
    """True if a cause is the hidden one, or is indistinguishable from it."""
    pairs = [(cause.kind, cause.where), *((a.kind, a.where) for a in cause.alternatives)]
    kind, where = truth["kind"], truth["where"]
    if cause.kind != kind and not {cause.kind, kind} <= {"offset", "sensor_bias"}:
        return False
    if kind == "parameter_jump" and where == "m":
        return cause.where in MOVED_BY_A_LOAD
    if kind in ("saturation", "outliers", "parameter_jump", "extra_input"):
        return bool(cause.where == where)
    return (kind, where) in pairs


def judge(diagnosis: casid.Diagnosis, truth: dict[str, Any]) -> tuple[bool, bool]:
    """Whether the answer is right, and whether it counts."""
    if truth["kind"] == "none":
        return diagnosis.verdict != "deficient", True
    causes = diagnosis.causes
    right = bool(causes) and _is_it(causes[0], truth) and len(causes) <= 2
    return right, truth["kind"] in KINDS and truth["strength"] >= 0.4


def diagnosed(run: Run) -> Iterator[Target]:
    """A target for each record."""
    folder = run.options.folder or shared_folder("cases/pendulum")
    for truth in json.loads((folder / "truth.json").read_text(encoding="utf-8")):
        if run.quick and truth["case"] not in QUICK:
            continue
        began = time.perf_counter()
        hidden = f"{truth['kind']}({truth['where']}) {truth['strength']:.2g}"
        try:
            experiment = pendulum.problem.read(folder / f"{truth['case']}.csv")
            d = casid.diagnose(pendulum.problem, experiment)
            right, counts = judge(d, truth)
            named = ", ".join(f"{c.kind}({c.where}) {c.p_value:.0e}" for c in d.causes) or d.verdict
            run.output.report(truth["case"], d)
        except casid.CasidError as error:
            right, counts, named = False, True, f"{type(error).__name__}: {error}"
        word = "right" if right else "wrong"
        wanted = word if counts else f"{word}, no target"
        seconds = f"{time.perf_counter() - began:.0f} s"
        yield Target(
            f"{truth['case']} {hidden}", named, f"{wanted}, {seconds}", right or not counts
        )


STUDY = Study(
    diagnosed,
    quick=f"only {', '.join(QUICK)}",
    out="folder for targets.json and the reports",
    options={"--folder": {"type": Path, "help": "other records of the same kind"}},
)
