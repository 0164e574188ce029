"""The false-alarm rate of a diagnosis, by parametric bootstrap."""
