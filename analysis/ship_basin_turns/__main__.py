"""`python -m analysis.ship_basin_turns`."""

from analysis.ship_basin_turns.study import STUDY

STUDY.run()
