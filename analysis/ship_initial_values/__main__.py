"""`python -m analysis.ship_initial_values`."""

import sys

from analysis.ship_initial_values.study import STUDY

sys.exit(STUDY.main())
