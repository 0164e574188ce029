"""`python -m analysis.diagnosis_power`."""

from analysis.diagnosis_power.study import STUDY

STUDY.run()
