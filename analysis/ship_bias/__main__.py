"""`python -m analysis.ship_bias`."""

import sys

from analysis.ship_bias.study import STUDY

sys.exit(STUDY.main())
