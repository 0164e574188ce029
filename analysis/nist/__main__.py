"""`python -m analysis.nist`."""

from analysis.nist.study import STUDY

STUDY.run()
