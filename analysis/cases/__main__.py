"""`python -m analysis.cases`."""

import sys

from analysis.cases.study import STUDY

sys.exit(STUDY.main())
