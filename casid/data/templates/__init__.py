"""Problem files to fill in, written from a file of measurements: one template a kind of system."""
