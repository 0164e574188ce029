"""What one case of the power study gives: a flat row for the file of cases.

A row holds what was hidden, how visible it is, what the diagnosis said and how long it took. It is
judged later (`judgement`), so that a change of the rules needs no new run.
"""

from __future__ import annotations

import time
from typing import Any

import casid
from analysis.common.case_file import Row, of_diagnosis
from analysis.diagnosis_power.cases import Hidden, draw_case, make
from analysis.diagnosis_power.energy import OF_SAMPLES, energy_of_samples, visible_energy


def problem_of(system: str) -> casid.Problem:
    """The problem that a case's records are diagnosed with."""
    from analysis.diagnosis_power import ship as diagnosis_power_ship
    from problems import pendulum, roll_decay

    if system == "ship":
        return diagnosis_power_ship.problem()
    return {"pendulum": pendulum.problem, "roll": roll_decay.problem}[system]


def diagnosed(part: str, number: int) -> Row:
    """Draw, make and diagnose one case. What fails is in the row as `error`."""
    case = draw_case(part, number)
    began = time.perf_counter()
    hidden = make(case)
    problem = problem_of(case.system)
    row: Row = {**_of_case(hidden), **_energies(problem, hidden)}
    row["preparation"] = time.perf_counter() - began
    try:
        row.update(_of_diagnosis(problem, hidden))
    except Exception as error:  # of whichever class: a case that fails is a result, too
        row["error"] = f"{type(error).__name__}: {error}"
    return row


def gained(part: str, number: int) -> Row:
    """What an oracle gains in one case (`gain`)."""
    from analysis.diagnosis_power.gain import WITHOUT_GAIN, oracle

    row: Row = {"part": "gain", "of": part, "number": number}
    if draw_case(part, number).kind in WITHOUT_GAIN:
        return row
    hidden = make(draw_case(part, number))
    return {**row, "kind": hidden.case.kind, **oracle(problem_of(hidden.case.system), hidden)}


def judged_by_peers(part: str, number: int) -> Row:
    """What others would name in one case (`peers`)."""
    from analysis.diagnosis_power.peers import peers_of

    hidden = make(draw_case(part, number))
    began = time.process_time()
    found = peers_of(problem_of(hidden.case.system), hidden)
    row: Row = {"part": "peers", "of": part, "number": number, "kind": hidden.case.kind}
    return row | {"where": hidden.where, "peers": found, "cpu": time.process_time() - began}


def judged_by_oracles(part: str, number: int) -> Row:
    """What the oracles would name in one case (`oracle`)."""
    from analysis.diagnosis_power.oracle import oracles

    case = draw_case(part, number)
    row: Row = {"part": "oracle", "of": part, "number": number, "kind": case.kind}
    if case.kind == "none" or case.kind in OF_SAMPLES:
        return row
    hidden = make(case)
    return {**row, "where": hidden.where, **oracles(problem_of(case.system), hidden)}


def _of_case(hidden: Hidden) -> Row:
    case = hidden.case
    same = ("part", "number", "system", "kind", "seed", "duration", "Ts", "noise")
    row: Row = {name: getattr(case, name) for name in same}
    row |= {"where": hidden.where, "strength": hidden.strength, "without": list(case.without)}
    row["N"] = hidden.record.N
    if hidden.second is not None:
        row["second"] = dict(zip(("kind", "where", "strength"), hidden.second, strict=True))
    return row


def _energies(problem: casid.Problem, hidden: Hidden) -> Row:
    """`energy` of the first effect, alone, and that of the second in its own place."""

    def of(kind: str, strength: float, clean: casid.Record) -> float:
        if kind in OF_SAMPLES:
            return energy_of_samples(kind, strength, clean.N)
        return visible_energy(problem, clean, hidden.sd, hidden.start)

    case = hidden.case
    if case.kind == "none":
        return {"energy": 0.0}
    if hidden.second is None:
        return {"energy": of(case.kind, hidden.strength, hidden.clean)}
    first, other = hidden.alone
    kind, _, strength = hidden.second
    return {
        "energy": of(case.kind, hidden.strength, first),
        "second_energy": of(kind, strength, other),
    }


class _Clock:
    """Processor seconds of the first scoring, from the progress lines of a diagnosis."""

    def __init__(self) -> None:
        self.scoring: float | None = None
        self._since: float | None = None

    def __call__(self, line: str) -> None:
        now = time.process_time()
        if self._since is not None and self.scoring is None:
            self.scoring = now - self._since
        if line.startswith("test every effect") and self._since is None:
            self._since = now

    def end(self) -> None:
        """The diagnosis is over: what was being scored is scored."""
        self("")


def _of_diagnosis(problem: casid.Problem, hidden: Hidden) -> Row:
    clock = _Clock()
    options: dict[str, Any] = {"progress": clock}
    if hidden.case.without:
        options["without"] = hidden.case.without
    began, cpu = time.perf_counter(), time.process_time()
    d = casid.diagnose(problem, hidden.record, **options)
    clock.end()
    return {
        "seconds": time.perf_counter() - began,
        "cpu": time.process_time() - cpu,
        "scoring": clock.scoring,
        **of_diagnosis(d),
    }
