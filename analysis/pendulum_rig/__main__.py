"""`python -m analysis.pendulum_rig`."""

from analysis.pendulum_rig.study import STUDY

STUDY.run()
