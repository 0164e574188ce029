"""Kalman filters and smoothers, and the noise that they assume."""
