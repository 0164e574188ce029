"""`python -m analysis.diagnosis_park`."""

from analysis.diagnosis_park.study import STUDY

STUDY.run()
