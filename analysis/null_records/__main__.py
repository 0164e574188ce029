"""`python -m analysis.null_records`."""

import sys

from analysis.null_records.study import STUDY

sys.exit(STUDY.main())
