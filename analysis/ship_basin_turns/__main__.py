"""`python -m analysis.ship_basin_turns`."""

import sys

from analysis.ship_basin_turns.study import STUDY

sys.exit(STUDY.main())
