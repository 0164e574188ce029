"""`python -m analysis.pendulum_study`."""

from analysis.pendulum_study.study import STUDY

STUDY.run()
