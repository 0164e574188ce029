"""Estimates from which the bias that noise on measured inputs gives is removed."""
