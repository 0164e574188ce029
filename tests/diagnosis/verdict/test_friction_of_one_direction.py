"""A constant force that opposes a motion which never reverses may be dry friction: they are one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import casid
from tests.diagnosis.search.noise_assumptions.test_first_cause import spindle

TS, N, INERTIA, DRAG = 0.05, 1200, 0.4, 0.5


def record(constant: float) -> casid.Record:
    """A spindle under steps of its drive that never stop it, and a constant torque."""
    rng = np.random.default_rng(11)
    drive = np.repeat(rng.uniform(2.0, 6.0, N // 40), 40)
    (b, a, _) = cont2discrete(([1.0], [INERTIA, DRAG]), TS, "zoh")
    speed = lfilter(b.ravel(), a, drive + constant) + 0.02 * rng.standard_normal(N)
    channels = {"u": drive[200:], "speed": speed[200:]}  # behind the run-up from rest
    return casid.Record(channels, {"u": "N m", "speed": "rad/s"}, Ts=TS)


@pytest.mark.parametrize(("constant", "opposes"), [(-0.8, True), (0.8, False)])
def test_a_constant_torque_may_be_dry_friction_where_it_opposes_a_rotation_of_one_direction(
    constant: float, opposes: bool
) -> None:
    found = casid.diagnose(spindle(), record(constant))
    (cause,) = found.causes
    assert (cause.kind, cause.where) == ("offset", "torque")
    size = cause.parameters[0]
    assert abs(size.value - constant) < 3 * size.std_error
    friction = [a for a in cause.alternatives if a.kind == "coulomb_friction"]
    assert len(friction) == opposes
    assert ("dry friction" in found.sentence) is opposes
    for a in friction:
        assert a.why == "acts as the same constant where w keeps its sign, as in this record"
