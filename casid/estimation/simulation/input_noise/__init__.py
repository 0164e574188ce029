"""Noise of inputs and sensors that the records themselves show, and draws of it."""
