"""`python -m analysis.network_examples`."""

import sys

from analysis.network_examples.study import STUDY

sys.exit(STUDY.main())
