"""`python -m analysis.diagnosis_advice`."""

from analysis.diagnosis_advice.study import STUDY

STUDY.run()
