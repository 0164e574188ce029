"""`python -m analysis.ship_initial_values`."""

from analysis.ship_initial_values.study import STUDY

STUDY.run()
