"""A channel is negated with its gaps."""

from __future__ import annotations

import numpy as np

import casid
from casid.identification.channel_signs import negated


def test_gaps_without_numbers_stay_gaps_when_a_channel_is_negated():
    values, mask = np.array([1.0, np.nan, 3.0]), np.array([False, True, False])
    record = casid.Record({"y": values}, {"y": "m"}, Ts=0.1, missing={"y": mask})
    (turned,) = negated([casid.Experiment(record)], "y")
    assert turned.record.is_missing("y").tolist() == mask.tolist()
    assert turned.record["y"][~mask].tolist() == [-1.0, -3.0]
