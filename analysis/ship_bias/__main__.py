"""`python -m analysis.ship_bias`."""

from analysis.ship_bias.study import STUDY

STUDY.run()
