"""Identifiable combinations, confounded groups and fixing sets of parameters."""
