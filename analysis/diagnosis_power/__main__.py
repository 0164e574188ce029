"""`python -m analysis.diagnosis_power`."""

import sys

from analysis.diagnosis_power.study import STUDY

sys.exit(STUDY.main())
