"""`python -m analysis.static_examples`."""

from analysis.static_examples.study import STUDY

STUDY.run()
