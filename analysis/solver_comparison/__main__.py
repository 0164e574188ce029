"""`python -m analysis.solver_comparison`."""

import sys

from analysis.solver_comparison.study import STUDY

sys.exit(STUDY.main())
