"""What the model is missing: evidence, search, verdict and advice."""
