"""`python -m analysis.ship_basin`."""

from analysis.ship_basin.study import STUDY

STUDY.run()
