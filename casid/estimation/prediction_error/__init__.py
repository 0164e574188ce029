"""Prediction-error estimation of polynomial models and of linear models with process noise."""
