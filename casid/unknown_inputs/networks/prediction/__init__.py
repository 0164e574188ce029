"""Predictors of network nodes."""
