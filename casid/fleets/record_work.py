"""The work on one record: it is read, screened and searched; the outcome is one flat row.

A row depends on the record, the problem, the settings and the asset's reference alone. It holds no
time taken and no machine, so that it is the same wherever and whenever it is made.
"""

from __future__ import annotations

import functools
import json
import math
import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from casid.data.experiment import Experiment
from casid.data.problem import Problem
from casid.data.reading.sources import sha256
from casid.diagnosis.diagnose import diagnose
from casid.diagnosis.diagnosis import Diagnosis
from casid.diagnosis.verdict.cause import Cause
from casid.errors import CasidError, OutOfTimeError
from casid.estimation.estimate import Estimate
from casid.fleets.fleet_settings import REFUSED, FleetSettings, Reference, Row
from casid.fleets.record_files import local
from casid.fleets.record_list import FleetRecord
from casid.fleets.screening import ParameterValue, Screen, Screened
from casid.fleets.supervision import over_time
from casid.identification.identify import identify


@dataclass(frozen=True, slots=True, eq=False)
class RecordWork:
    """The problem and the settings, in any process."""

    problem: Problem
    settings: FleetSettings

    def read(self, path: str) -> Experiment:
        """The record of a file."""
        with local(path) as file:
            return self._read(file)

    def _read(self, file: Path) -> Experiment:
        s = self.settings
        return self.problem.read(
            file, mapping=s.mapping, window=s.window, ignore=s.ignore, name=file.stem
        )

    def reference(self, record: FleetRecord) -> Row:
        """A record's own fit for the asset's reference: parameters in SI, or why there is none."""
        try:
            problem = self.problem.in_si()
            estimate = identify(problem, [_in_si(self.problem, self.read(record.path))])
        except (CasidError, OSError) as error:
            return {"refusal": _line(error)}
        values = {p.name: p.value for p in estimate.parameters if not p.known}
        if not estimate.is_converged or not all(map(math.isfinite, values.values())):
            return {"refusal": "its fit did not converge"}
        return {"values": json.dumps(values)}

    def row(self, record: FleetRecord, reference: Reference | None, seconds: float) -> Row:
        """The outcome of one record."""
        try:
            with local(record.path) as file:
                digest, experiment = sha256(file), self._read(file)
        except (CasidError, OSError, UnicodeDecodeError) as error:
            return {**REFUSED, "refusal": f"it cannot be read: {_line(error)}"}
        data = experiment.record
        row: Row = {"sha256": digest, "samples": data.N, "Ts": data.Ts}
        row["quality"] = _quality(experiment)
        screened = self._screened(experiment, reference)
        if screened is not None:
            row["p_screen"] = screened.p_value if not screened.why else None
            row["screen"] = screened.why
            if not screened.passes(self.settings.level):
                return row | {
                    "stage": "screened",
                    "verdict": "adequate",
                    "p": 1.0,
                    "parameters": _json(screened.parameters),
                    "causes": "[]",
                }
        return row | self._searched(experiment, seconds)

    def _screened(self, experiment: Experiment, reference: Reference | None) -> Screened | None:
        if not self.settings.screen or reference is None:
            return None
        try:
            screen = _screen_of(self, reference)
        except (CasidError, OSError) as error:
            return Screened(0.0, f"the asset's reference cannot be used: {_line(error)}")
        return screen(experiment)

    def _searched(self, experiment: Experiment, seconds: float) -> Row:
        s = self.settings
        try:
            found = diagnose(
                self.problem,
                [experiment],
                hold_out=s.hold_out,
                false_alarm_rate=s.level,
                max_causes=s.max_causes,
                without=s.without,
                advise=False,
                budget=seconds,
                starts=s.starts,
                seed=s.seed,
            )
            if found.not_done:
                raise OutOfTimeError("")
        except OutOfTimeError:
            return {**REFUSED, "refusal": over_time(seconds)}
        except (CasidError, ArithmeticError, ValueError, RuntimeError) as error:
            return {**REFUSED, "refusal": f"it cannot be diagnosed: {_line(error)}"}
        return _row_of(found)


@functools.lru_cache(maxsize=4)
def work_of(content: bytes) -> RecordWork:
    """The work in another process, once for all of its records."""
    return RecordWork(*pickle.loads(content))


def do_row(content: bytes, record: FleetRecord, reference: Reference | None, seconds: float) -> Row:
    """The row of a record, in whatever process."""
    return work_of(content).row(record, reference, seconds)


def do_reference(content: bytes, record: FleetRecord) -> Row:
    """A record's own fit, in whatever process."""
    return work_of(content).reference(record)


@functools.lru_cache(maxsize=48)
def _screen_of(work: RecordWork, reference: Reference) -> Screen:
    s = work.settings
    return Screen.of(
        work.problem,
        work.read(reference.path),
        dict(reference.values),
        level=s.level,
        without=s.without,
    )


def _in_si(problem: Problem, experiment: Experiment) -> Experiment:
    from casid.data.arguments import in_si

    return in_si(problem, [experiment])[1][0]


def _line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


def _quality(experiment: Experiment) -> str:
    """What bears on the record, in words: samples missing."""
    data = experiment.record
    out = []
    for name in data:
        missing = float(np.mean(data.is_missing(name)))
        if missing > 0.0:
            out.append(f"{name}: {100 * missing:.2g} % missing")
    return "; ".join(out)


def _row_of(found: Diagnosis) -> Row:
    """The row of a diagnosis.

    Its p is the smallest family-wise one among its causes; 1 where nothing was adopted, which keeps
    it valid: at most as often small as the test's own.
    """
    causes = found.causes if found.verdict == "deficient" else ()
    estimate = found.extended if found.extended is not None and causes else found.baseline
    return {
        "stage": "searched",
        "verdict": found.verdict,
        "p": min((c.p_value for c in causes), default=1.0),
        "gain": _gain(found),
        "parameters": _json(_parameters(estimate, found.baseline)),
        "causes": json.dumps([_cause(c) for c in causes]),
        "why": found.sentence if found.verdict == "undecided" else "",
    }


def _gain(found: Diagnosis) -> float | None:
    """The largest share by which an output's error fell on what was not fitted."""
    part = found.held_out if found.held_out.get("baseline_rmse") else found.fitted
    before, after = part.get("baseline_rmse", {}), part.get("extended_rmse", {})
    falls = [1.0 - after[o] / before[o] for o in after if before.get(o, 0.0) > 0.0]
    return max(falls, default=None) if all(map(math.isfinite, falls)) else None


def _parameters(estimate: Estimate, baseline: Estimate) -> list[ParameterValue]:
    """The model's own parameters, as the extended model estimates them."""
    names = {p.name for p in baseline.parameters if not p.known}
    return [
        ParameterValue(p.name, p.value, p.std_error, p.unit)
        for p in estimate.parameters
        if p.name in names and not p.known
    ]


def _json(parameters: Sequence[ParameterValue]) -> str:
    return json.dumps([[p.name, p.value, p.std_error, p.unit] for p in parameters])


def _cause(cause: Cause) -> dict[str, Any]:
    size = cause.parameters[0] if cause.parameters else None
    return {
        "kind": cause.kind,
        "where": cause.where,
        "p": cause.p_value,
        "share": cause.share,
        "size": None if size is None else size.value,
        "std_error": None if size is None else size.std_error,
        "unit": "" if size is None else size.unit,
        "parameters": [[p.name, p.value, p.std_error, p.unit] for p in cause.parameters],
        "rivals": [[a.kind, a.where, a.description] for a in cause.alternatives],
        "description": cause.description,
    }
