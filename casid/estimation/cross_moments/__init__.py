"""Sums over time of products of lagged samples: all that least squares needs."""
