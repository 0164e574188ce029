"""What a report says of a cause whose size is not known to within itself."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from casid.diagnosis.verdict.cause import Cause
from casid.diagnosis.verdict.error_bars import unknown_sizes
from casid.estimation.estimate import Estimated


def test_a_size_that_exchanges_for_another_is_said_to():
    """Two jumps, each 60 +- 70 as the other makes up for it; a third that is known."""
    jumps = [
        Estimated(f"jump_{n}", 60.0, "1", std_error=e)
        for n, e in zip("abc", (70, 70, 5), strict=True)
    ]
    causes = [Cause("parameter_jump", p.name, 1e-20, (p,)) for p in jumps]
    covariance = np.diag([70.0**2, 70.0**2, 5.0**2, 9.0])
    covariance[0, 1] = covariance[1, 0] = -0.95 * 70**2
    covariance[0, 3] = covariance[3, 0] = 0.9 * 70 * 3  # an initial state tells nobody anything
    reported = SimpleNamespace(
        covariance_names=("jump_a", "jump_b", "jump_c", "x(0)"),
        covariance=covariance,
        initial_states=(Estimated("x(0)", 0.0, "1"),),
    )
    first, second = unknown_sizes(causes, reported)
    assert "jump_a is not known to within itself: jump_b would make up" in first
    assert "jump_b is not known to within itself: jump_a would make up" in second
    (alone,) = unknown_sizes(
        causes[:1], SimpleNamespace(**{**vars(reported), "covariance": np.eye(4)})
    )
    assert "within itself. What is significant" in alone
    assert unknown_sizes(causes[2:], reported) == ()
