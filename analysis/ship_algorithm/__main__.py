"""`python -m analysis.ship_algorithm`."""

from analysis.ship_algorithm.study import STUDY

STUDY.run()
