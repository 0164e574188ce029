"""`python -m analysis.fleet`."""

from analysis.fleet.study import STUDY

STUDY.run()
