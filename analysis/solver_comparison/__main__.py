"""`python -m analysis.solver_comparison`."""

from analysis.solver_comparison.study import STUDY

STUDY.run()
