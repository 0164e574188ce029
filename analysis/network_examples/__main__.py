"""`python -m analysis.network_examples`."""

from analysis.network_examples.study import STUDY

STUDY.run()
