"""`python -m analysis.pendulum_rig`."""

import sys

from analysis.pendulum_rig.study import STUDY

sys.exit(STUDY.main())
