"""Moment equations of one output of one record, their covariance, and their nonlinear programs."""
