"""Observers decoupled from unknown inputs, and estimates of the inputs themselves."""
