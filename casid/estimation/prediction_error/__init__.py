"""Prediction-error estimation: polynomial models and linear models with process noise."""
