"""`python -m analysis.load_monitoring`."""

from analysis.load_monitoring.study import STUDY

STUDY.run()
