"""`python -m analysis.cases`."""

from analysis.cases.study import STUDY

STUDY.run()
