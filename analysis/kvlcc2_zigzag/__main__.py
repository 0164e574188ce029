"""`python -m analysis.kvlcc2_zigzag`."""

import sys

from analysis.kvlcc2_zigzag.study import STUDY

sys.exit(STUDY.main())
