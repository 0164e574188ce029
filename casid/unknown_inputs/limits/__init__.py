"""Limits, covariances and mean square errors of estimators on linear systems."""
