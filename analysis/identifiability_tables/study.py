"""Ranks and tables of identifiability in Linder (2017), chapters 7 and 8, decided exactly.

    python -m analysis.identifiability_tables [--quick] [--out DIR]

Table 7.1 of the pendulum, its direct and indirect models, with and without a moving cart; ranks of
the ship's models by what is taken as known of the sensor and by number of records; Table 8.1 and
the sets of nine parameters; the nine parameters that the thesis sets out to estimate, which are one
too many, the curve along which they can be traded, and the remedy. Where the thesis' numbers
hold only for a sensor at a known height beside an axis at an unknown one, the rows say so. Last,
how often two compartment networks must be observed.

In the labels phi' and a_s are outputs, and z_s is tied where z_s = zbar_s + z_f. Ranks are found at
random points modulo primes of 30 bits; full rank is a proof, and a deficiency is wrong with a
probability below 1e-12. --quick: one seed instead of five. Exit 1 where a target is missed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from analysis.common.runner import AbsentError, Study, sections, shared_folder
from analysis.common.targets import Target, equal
from analysis.identifiability_tables import models
from casid.algebra.prime_field import random_prime, to_field
from casid.identifiability.combinations.fixing_sets import Exclusion, fixing_sets
from casid.identifiability.equations.equation_file import read_equations
from casid.identifiability.equations.model_system import translated
from casid.identifiability.equations.system import System
from casid.identifiability.rank.observability import observability, rank_at
from problems import ship
from problems.ship import NINE, FreeTurn

TURNS: tuple[FreeTurn, ...] = ("K_ur", "K_r")

RANK_TABLE: tuple[tuple[dict[str, Any], tuple[int, ...]], ...] = (
    ({"tied": False, "is_indirect": False, "outputs": models.GYRO}, (7, 11, 15, 17)),
    ({"tied": False, "is_indirect": False, "outputs": models.BOTH}, (7, 11, 15, 17)),
    ({"tied": False, "is_indirect": True, "outputs": models.GYRO}, (7, 11, 15, 17)),
    ({"tied": True, "is_indirect": False, "outputs": models.GYRO}, (7, 11, 15, 17)),
    ({"tied": True, "is_indirect": False, "outputs": models.BOTH}, (8, 12, 15, 17)),
    ({"tied": True, "is_indirect": True, "outputs": models.GYRO}, (7, 11, 14, 17)),
)
"""How the ship is modelled, and the rank with 1, 2, 3 and 4 records."""

EXCEPTIONS = {"K_ur": (20, 115, 296, 43), "K_r": (20, 130, 326, 46)}
"""Sets of 3, 4, 5 parameters in one record and of 9 in three that are not identifiable."""

KNOWN_PAIRS = (
    "A_x K_vdot, A_x K_ur, k A_x, zbar_g K_vdot, zbar_g K_ur, zbar_g A_x, zbar_g k, M K_vdot, "
    "M K_ur, M A_x, M k, M zbar_g"
)
"""Pairs that, once known, leave nine identifiable parameters in three records (K_ur free)."""


# -- chapter 7 -------------------------------------------------------------------------------------


def pendulum_tables(seeds: Sequence[int]) -> Iterator[Target]:
    """Table 7.1, for the direct model with one and two outputs and for the indirect model."""
    for label, is_indirect, outputs in (
        ("(7.10), phi'", False, models.GYRO),
        ("(7.10), phi' and a_s", False, models.BOTH),
        ("(7.24), phi'", True, models.GYRO),
    ):
        for is_moved, rank, triples in ((True, 5, "22 of 56"), (False, 4, "56 of 56")):
            system = models.pendulum_system(
                is_indirect=is_indirect, outputs=outputs, is_moved=is_moved
            )
            what = f"{label}{'' if is_moved else ', a_y = 0'}"
            found = {seed: observability(system, seed=seed) for seed in seeds}
            yield equal(f"{what}: rank", _only({f.rank for f in found.values()}), rank)
            sets = {size: models.excluded(found[seeds[0]], size) for size in (1, 2, 3)}
            yield equal(f"{what}: single parameters", sets[1].count, 0)
            yield equal(f"{what}: pairs not identifiable", _share(sets[2]), "1 of 28")
            yield equal(f"{what}: triples not identifiable", _share(sets[3]), triples)
            for size in (2, 3) if is_moved else (2,):
                by_rule = models.holding(models.PENDULUM, size, models.pendulum_rule())
                held = models.as_sets(sets[size]) == by_rule
                yield equal(f"{what}: sets of {size} by the rule", held, True)


def pendulum_two_records() -> Iterator[Target]:
    """Nominal and loaded, seven parameters unknown: what must be known (section 7.4).

    The records determine S and I_1 of both up to a common factor, so z_m = (change of I_1)/(change
    of S) is identifiable, unless the weight brings an inertia of its own, known or not.
    """
    light = {
        frozenset({a, b})
        for a in ("M", "z_g", "I_x")
        for b in ("M", "z_g", "I_x", "k", "d", "m")
        if a != b
    }
    heavy = light | {frozenset({a, "z_m"}) for a in ("M", "z_g", "I_x")}
    for label, is_indirect in (("(7.10)", False), ("(7.24)", True)):
        loaded = models.pendulum_system(is_indirect=is_indirect).with_known("I_xm")
        empty = loaded.substituted({"m": 0.0, "I_xm": 0.0}).where(name="nominal")
        for own, with_load, wanted in (
            ("I_xm = 0", loaded.substituted({"I_xm": 0.0}), light),
            ("I_xm known", loaded, heavy),
        ):
            what = f"{label}, nominal + loaded, {own}"
            found = observability([empty, with_load])
            yield equal(f"{what}: rank of 11", found.rank, 9)
            is_light = own == "I_xm = 0"
            yield equal(f"{what}: z_m is identifiable", found.identifiable["z_m"], is_light)
            point = found.points[0]
            sets = fixing_sets(point.information, point.parameters, point.prime).sets
            pairs = {frozenset(s) for s in sets}
            yield equal(f"{what}: pairs to be known", len(pairs), len(wanted))
            yield equal(f"{what}: they are as stated", pairs == wanted, True)


# -- chapter 8 -------------------------------------------------------------------------------------


def ship_ranks(seeds: Sequence[int]) -> Iterator[Target]:
    """The rank by model, sensor and number of records."""
    for turn in TURNS:
        for how, ranks in RANK_TABLE:
            records = models.ship_records(models.ship_system(turn=turn, **how))
            for (name, systems), rank in zip(records.items(), ranks, strict=True):
                found = {observability(systems, seed=seed).rank for seed in seeds}
                yield equal(f"{_described(turn, **how)}: rank, {name}", _only(found), rank)


def ship_exceptions() -> Iterator[Target]:
    """Table 8.1 and the sets of nine, as counts and set by set."""
    for turn in TURNS:
        system = models.ship_system(tied=False, turn=turn, outputs=models.BOTH)
        names, what = system.parameters, _described(turn, False, False, models.BOTH)
        for size, exclusion in models.exclusions([system], (1, 2)).items():
            yield equal(f"{what}: sets of {size}, single", exclusion.count, 0)
        wanted = dict(zip((3, 4, 5), EXCEPTIONS[turn], strict=False))
        for size, exclusion in models.exclusions([system], wanted).items():
            held = models.as_sets(exclusion) == models.holding(names, size, models.ship_rule(turn))
            share = f"{wanted[size]} of {exclusion.total}"
            yield equal(f"{what}: sets of {size}, single", _share(exclusion), share)
            yield equal(f"{what}: sets of {size} by the rule", held, True)
        sixes = models.exclusions([system], [6])[6]
        yield equal(f"{what}: sets of 6, single", _share(sixes), "462 of 462")
        for tied, outputs in ((False, models.BOTH), (True, models.GYRO), (True, models.BOTH)):
            yield from _nines(turn, tied, outputs)


def _nines(turn: FreeTurn, tied: bool, outputs: Sequence[str]) -> Iterator[Target]:
    """Sets of nine in three records of the direct model."""
    system = models.ship_system(tied=tied, turn=turn, outputs=outputs)
    what = _described(turn, tied, False, outputs)
    nines = models.exclusions(models.ship_records(system)["with calibration"], [9])[9]
    yield equal(f"{what}: sets of 9, three records", _share(nines), f"{EXCEPTIONS[turn][3]} of 55")
    failing = models.as_sets(nines)
    by_rule = models.holding(system.parameters, 9, models.three_record_rule(turn))
    yield equal(f"{what}: sets of 9 by the rule", failing == by_rule, True)
    if turn == "K_ur":
        every = models.holding(system.parameters, 9, [[]])
        known = {frozenset(system.parameters) - s for s in every - failing}
        listed = {frozenset(pair.split()) for pair in KNOWN_PAIRS.split(", ")}
        yield equal(f"{what}: pairs to be known as listed", known == listed, True)


# -- the nine parameters ---------------------------------------------------------------------------


def nine_parameters() -> Iterator[Target]:
    """The problem as it is fitted: its rank, its family, its remedy."""
    system = models.with_sought(models.ship_system(is_indirect=True))
    records = models.ship_records(system)
    three = records["with calibration"]
    found = observability(three)
    fitted = observability(translated(ship.nine_parameters(), ship.experiments()).systems)
    yield equal("(8.20), nine parameters, three records: rank of 15", found.rank, 14)
    yield equal("the same with the numbers of Table 8.2: rank of 15", fitted.rank, 14)
    direct = models.with_sought(models.ship_system(is_indirect=False, outputs=models.BOTH))
    rank = observability(models.ship_records(direct)["with calibration"]).rank
    yield equal("(8.10), nine parameters, three records: rank of 15", rank, 15)
    identifiable = [n for n in NINE if found.identifiable[n]]
    yield equal("identifiable of the nine", _list(identifiable), "zbar_m")
    point = found.points[0]
    fixing = fixing_sets(point.information, point.parameters, point.prime)
    single = {s[0] for s in fixing.sets if len(s) == 1}
    remedies = [n for n in NINE if n in single]
    yield equal("one of these, once known, is a remedy", _list(remedies), _list(NINE[:-1]))
    by_rank = [n for n in NINE if observability(_fixing(three, n)).is_full]
    yield equal("the same by ranks, one known at a time", _list(by_rank), _list(NINE[:-1]))
    yield from family()
    yield from second_calibrations(system)


def family() -> Iterator[Target]:
    """The direction along which the nine can be traded is that of the family, exactly."""
    sought = models.with_sought(models.ship_system(is_indirect=True))
    three = models.ship_records(sought)["with calibration"]
    slopes, rng = models.ship_slopes(), np.random.default_rng(0)
    prime = random_prime(rng)
    values = {n: to_field(v, prime) for n, v in models.true_ship().items()}
    point = rank_at(three, prime, values=values, rng=rng)
    direction = [to_field(slopes[n], prime) for n in point.parameters]
    moved = [
        sum(a * b for a, b in zip(row, direction, strict=True)) % prime
        for row in point.information.tolist()
    ]
    yield equal("at Table 8.3: rank of 15", point.rank, 14)
    yield equal("at Table 8.3: what the family's slopes change", sum(map(bool, moved)), 0)
    printed = {
        "k": "-238.0", "A_x": "-0.0618", "d": "-1.0335", "K_r": "2.5", "K_vdot": "-19.45",
        "K_delta": "2.025", "m": "-0.0952", "zbar_m": "0",
    }  # fmt: skip
    for name, text in printed.items():
        digits = len(text.partition(".")[2])
        found = f"{float(slopes[name]):.{digits}f}"
        yield equal(f"slope of {name} along z_f at Table 8.3", found, text)
    where = {"zbar_m": 12345, "zbar_c": 12345}
    point = rank_at(three, prime, values=where, rng=rng)
    identifiable = dict(zip(point.parameters, point.identifiable(), strict=True))
    both = _list([n for n in NINE if identifiable[n]])
    yield equal("identifiable where zbar_m = zbar_c", both, "m, zbar_m")


def second_calibrations(system: System) -> Iterator[Target]:
    """Another weight at the same height adds no information; at another height it does."""
    first, loaded = models.calibration(system), system
    for label, second, rank in (
        ("the same calibration again", first, 16),
        ("another weight at the same height", models.calibration(system, mass="m_c2"), 16),
        ("the same weight at another height", models.calibration(system, height="zbar_c2"), 17),
    ):
        found = observability([models.nominal(system), first, second, loaded])
        yield equal(f"nine parameters and {label}: rank of 17", found.rank, rank)


def _fixing(systems: Sequence[System], name: str) -> list[System]:
    return [s.with_known(name) if name in s.parameters else s for s in systems]


# -- how often an experiment must be repeated ------------------------------------------------------


def repetitions() -> Iterator[Target]:
    """Deficiency of the parameters by number of records that start elsewhere; the shared files."""
    try:
        folder = shared_folder("identifiability")
    except AbsentError as error:
        print(error, file=sys.stderr)
        return
    for path in sorted(folder.glob("me_*.json")):
        expected = json.loads(path.read_text(encoding="utf-8"))["expected"]
        wanted = expected["parameter_deficiency_by_number_of_replicates"]
        (system,) = read_equations(path).systems
        found = [observability([system] * (i + 1)).deficiency for i in range(len(wanted))]
        yield equal(f"{path.stem}: deficiency by records", found, wanted)
        needed = found.index(0) + 1 if 0 in found else None
        yield equal(f"{path.stem}: records needed", needed, expected["replicates_needed"])


# -- everything ------------------------------------------------------------------------------------


def _only(ranks: set[int]) -> int:
    """The rank that all seeds agree on; -1 where they do not."""
    return ranks.copy().pop() if len(ranks) == 1 else -1


def _share(exclusion: Exclusion) -> str:
    return f"{exclusion.count} of {exclusion.total}"


def _list(names: Sequence[str]) -> str:
    return ", ".join(names)


def _described(turn: str, tied: bool, is_indirect: bool, outputs: Sequence[str]) -> str:
    model = "(8.20)" if is_indirect else "(8.10)"
    seen = "phi'" + (" a_s" if "accel" in outputs else "")
    return f"{turn}, z_s {'tied' if tied else 'known'}, {model} {seen}"


SECTIONS: Mapping[str, Callable[[Sequence[int]], Iterator[Target]]] = {
    "Table 7.1: the pendulum, eight parameters": pendulum_tables,
    "Section 7.4: the pendulum, two records": lambda _: pendulum_two_records(),
    "Section 8.3: the ship, eleven parameters, ranks": ship_ranks,
    "Table 8.1: the ship, sets of parameters": lambda _: ship_exceptions(),
    "The ship as it is fitted, nine parameters": lambda _: nine_parameters(),
    "Compartment networks: how many records": lambda _: repetitions(),
}

STUDY = Study(
    lambda run: sections(SECTIONS, range(1 if run.quick else 5)),
    quick="one seed instead of five",
    out="folder for identifiability_tables.json",
    file="identifiability_tables.json",
)
