"""`python -m analysis.nist`."""

import sys

from analysis.nist.study import STUDY

sys.exit(STUDY.main())
