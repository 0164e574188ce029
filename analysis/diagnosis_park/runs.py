"""What one case of the park gives: a flat row, judged later."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

import casid
from analysis.common.case_file import Row, of_diagnosis
from analysis.diagnosis_park.bench import Variant
from analysis.diagnosis_park.cases import Case, Hidden, make
from analysis.diagnosis_park.oracle import judged, signatures_of
from tests.support.park.networks import KINDS, network
from tests.support.park.simulator import System
from tests.support.park.systems import SYSTEMS

FILES = Path(__file__).with_name("problem_files")
NAMES = (*SYSTEMS, *KINDS)


def system_and_problem(case: Case) -> tuple[System, casid.Problem]:
    """The system of a case with the problem that a stranger wrote of it."""
    if case.system in KINDS:
        return network(case.system, np.random.default_rng([case.seed, case.number]))
    return SYSTEMS[case.system], casid.load_problem(FILES / f"{case.system}.py")


def record_of(hidden: Hidden) -> casid.Record:
    """The record as it would be read from a file."""
    s, case = hidden.bench.system, hidden.case
    name = f"{case.system} {case.seed} {case.number}"
    return casid.Record(hidden.channels, hidden.units, Ts=s.Ts, name=name)


def row_of(case: Case, *, oracles: bool = True) -> Row:
    """Make, diagnose and judge by the oracles; what fails is in the row as `error`."""
    system, problem = system_and_problem(case)
    hidden = make(case, system)
    row: Row = {
        "system": case.system,
        "domain": system.domain,
        "seed": case.seed,
        "number": case.number,
        "part": case.part,
        "kind": hidden.kind,
        "where": hidden.where,
        "energy": hidden.energy,
        "size": [float(s) for s in hidden.size],
        "hyper": hidden.hyper,
        "names": hidden.names,
    }
    if oracles:
        row |= _of_oracles(hidden)
    began, cpu = time.perf_counter(), time.process_time()
    try:
        found = casid.diagnose(problem, record_of(hidden))
        row |= of_diagnosis(found)
        if hidden.effect is not None:
            row |= {"left": left_by(hidden, found), "free": _free(hidden, row)}
    except Exception as error:  # of whichever class: a case that fails is a result, too
        row["error"] = f"{type(error).__name__}: {error}"
    row["seconds"], row["cpu"] = time.perf_counter() - began, time.process_time() - cpu
    return row


def left_by(hidden: Hidden, found: casid.Diagnosis) -> float:
    """Energy (as lambda) of what a diagnosis simulates less the true outputs without noise.

    With efficient estimates of the true model it is chi-squared of as many degrees of freedom as
    values were estimated.
    """
    bench, view = hidden.bench, found.records[0]
    truth = Variant(np.zeros(bench.n_phi), hidden.effect, hidden.size, hidden.hyper)
    e = bench.outputs([truth])[:, :, 0]
    simulated = view.baseline if view.extended is None else view.extended
    for j, output in enumerate(bench.system.outputs):
        i = view.outputs.index(output.name)
        in_its_unit = np.polyfit(view.measured[: bench.n, i], hidden.y[: bench.n, j], 1)
        e[:, j] -= np.polyval(in_its_unit, simulated[: bench.n, i])
    return float(np.sum(hidden.white(e[:, :, None]) ** 2))


def _free(hidden: Hidden, row: Row) -> int:
    """Values that were estimated: parameters, initial states, sizes of causes."""
    return hidden.bench.n_phi + sum(len(c["values"]) for c in row["causes"])


def _of_oracles(hidden: Hidden) -> Row:
    """Names and sets of both oracles, the nearest rival's cosine, and what is the same here."""
    if hidden.case.part not in ("single", "large") or hidden.effect is None:
        return {}
    bench, row = hidden.bench, Row()
    truth = (hidden.effect, hidden.hyper, np.asarray(hidden.size))
    y = hidden.y[: bench.n]
    found = signatures_of(bench, hidden.white, hidden.catalogue)
    for label, knows in (("oracle_2", False), ("oracle_1", True)):
        v = judged(bench, hidden.white, y, found, truth, knows_parameters=knows)
        row[label] = [v.effect.kind, v.effect.where]
        row[f"{label}_set"] = [[e.kind, e.where] for e in v.reported]
        if not knows:
            row["cosine"] = v.cosine
            hidden.names = v.same
    row["names"] = [list(pair) for pair in hidden.names]
    return row
