"""Estimates from moment equations, stage after stage, with the errors that each passes on."""
