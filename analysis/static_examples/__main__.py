"""`python -m analysis.static_examples`."""

import sys

from analysis.static_examples.study import STUDY

sys.exit(STUDY.main())
