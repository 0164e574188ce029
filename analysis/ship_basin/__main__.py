"""`python -m analysis.ship_basin`."""

import sys

from analysis.ship_basin.study import STUDY

sys.exit(STUDY.main())
