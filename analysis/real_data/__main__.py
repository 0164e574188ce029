"""`python -m analysis.real_data`."""

import sys

from analysis.real_data.study import STUDY

sys.exit(STUDY.main())
