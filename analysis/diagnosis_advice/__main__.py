"""`python -m analysis.diagnosis_advice`."""

import sys

from analysis.diagnosis_advice.study import STUDY

sys.exit(STUDY.main())
