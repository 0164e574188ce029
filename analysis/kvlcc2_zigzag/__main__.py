"""`python -m analysis.kvlcc2_zigzag`."""

from analysis.kvlcc2_zigzag.study import STUDY

STUDY.run()
