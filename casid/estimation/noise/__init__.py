"""Noise of sensors, measured inputs and unrecorded forces: its model, variances and whitening."""
