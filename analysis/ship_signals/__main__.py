"""`python -m analysis.ship_signals`."""

import sys

from analysis.ship_signals.study import STUDY

sys.exit(STUDY.main())
