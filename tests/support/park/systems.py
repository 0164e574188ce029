"""The systems of the park, by name."""

from __future__ import annotations

from tests.support.park import machines, process
from tests.support.park.simulator import System

SYSTEMS: dict[str, System] = {s.name: s for s in (*machines.SYSTEMS, *process.SYSTEMS)}
