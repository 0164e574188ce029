"""`python -m analysis.designed_experiments`."""

from analysis.designed_experiments.study import STUDY

STUDY.run()
