"""`python -m analysis.ship_algorithm`."""

import sys

from analysis.ship_algorithm.study import STUDY

sys.exit(STUDY.main())
