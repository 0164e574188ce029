"""Intervals of an estimate: normal, by the profile of the criterion, by simulation."""
