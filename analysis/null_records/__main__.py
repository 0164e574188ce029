"""`python -m analysis.null_records`."""

from analysis.null_records.study import STUDY

STUDY.run()
