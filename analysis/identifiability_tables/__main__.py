"""`python -m analysis.identifiability_tables`."""

import sys

from analysis.identifiability_tables.study import STUDY

sys.exit(STUDY.main())
