"""The models that are exported: the extended pendulum, roll decay and EMPS."""

from __future__ import annotations

import numpy as np
import pytest

from casid.arrays import Array
from tests.support.fitted_models import (
    Simulated,
    extended_emps,
    extended_pendulum,
    extended_roll_decay,
    simulated,
)
from tests.support.shared import shared


def emps_force(N: int) -> Array:
    """The first N samples of the drive's force in the benchmark's record, 1 kHz."""
    import pandas as pd

    table = pd.read_csv(shared("data/emps/estimation.csv"), nrows=N)
    return np.asarray(table["force_N"], dtype=float)


@pytest.fixture(params=["pendulum", "roll decay", "EMPS"], scope="module")
def run(request: pytest.FixtureRequest) -> Simulated:
    """An extended model with what casid simulates of it."""
    if request.param == "pendulum":
        return simulated(extended_pendulum())
    if request.param == "roll decay":
        return simulated(extended_roll_decay())
    return simulated(extended_emps(), {"force": emps_force(400)})
