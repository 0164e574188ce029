"""`python -m analysis.coverage`."""

from analysis.coverage.study import STUDY

STUDY.run()
