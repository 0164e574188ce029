"""Predictors of a network node, their exact errors, and filters that estimate its noise."""
