"""`python -m analysis.ship_signals`."""

from analysis.ship_signals.study import STUDY

STUDY.run()
