"""The simulation study of Linder (2017), section 7.5.1: 10 000 runs of two long records."""
