"""What rests where it is held out refuses nothing: all of the record is fitted then."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import casid
from casid.diagnosis.search.refusals import SUPERFLUOUS, Refusal
from casid.diagnosis.verdict.resting_held_out import refused_at_rest
from casid.estimation.holdout import split_records

NOISE, N = 0.05, 400
CHANCE = Refusal("its held-out improvement may be chance", "held-out")


def found_in(motion: np.ndarray, why: Refusal, adopted: tuple[str, ...] = ()) -> SimpleNamespace:
    """What was found in a record of this motion, in which an effect was refused."""
    y = motion + NOISE * np.random.default_rng(1).standard_normal(N)
    record = casid.Record({"y": y}, {"y": "m"}, Ts=0.1, name="r")
    split = split_records([casid.Experiment(record, {}, "r")], 0.3)
    start = SimpleNamespace(noise=SimpleNamespace(output_sd=np.array([NOISE])))
    return SimpleNamespace(
        baseline=SimpleNamespace(why_undecided="", split=split, start=start),
        base_fit=SimpleNamespace(criterion=SimpleNamespace(outputs=["y"])),
        search=SimpleNamespace(refused=[(SimpleNamespace(), why)]),
        adopted=adopted,
    )


T = 0.1 * np.arange(N)
DECAYED, MOVING, NEVER = np.exp(-T / 2.0), np.sin(T), np.zeros(N)


@pytest.mark.parametrize(
    ("motion", "why", "adopted", "is_doubted"),
    [
        (DECAYED, CHANCE, (), True),
        (MOVING, CHANCE, (), False),
        (NEVER, CHANCE, (), False),
        (DECAYED, SUPERFLUOUS, (), False),
        (DECAYED, CHANCE, ("a cause",), False),
    ],
)
def test_a_refusal_counts_where_something_moves(motion, why, adopted, is_doubted) -> None:
    assert refused_at_rest(found_in(motion, why, adopted)) is is_doubted
