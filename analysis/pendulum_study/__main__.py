"""`python -m analysis.pendulum_study`."""

import sys

from analysis.pendulum_study.study import STUDY

sys.exit(STUDY.main())
