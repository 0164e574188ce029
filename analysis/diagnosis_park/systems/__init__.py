"""The systems of the park, by name."""

from __future__ import annotations

from analysis.diagnosis_park.simulator import System
from analysis.diagnosis_park.systems import machines, process

SYSTEMS: dict[str, System] = {s.name: s for s in (*machines.SYSTEMS, *process.SYSTEMS)}
