"""Prediction error: polynomial models, Kalman predictors, grey-box models with process noise."""
