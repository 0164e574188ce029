"""`python -m analysis.real_data`."""

from analysis.real_data.study import STUDY

STUDY.run()
