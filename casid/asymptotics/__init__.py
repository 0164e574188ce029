"""Limits, covariances and mean square errors of estimators: what an unknown input does to them."""
