"""`python -m analysis.load_monitoring`."""

import sys

from analysis.load_monitoring.study import STUDY

sys.exit(STUDY.main())
