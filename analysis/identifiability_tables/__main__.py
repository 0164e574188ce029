"""`python -m analysis.identifiability_tables`."""

from analysis.identifiability_tables.study import STUDY

STUDY.run()
