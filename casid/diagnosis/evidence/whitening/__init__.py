"""The fit under the noise that it leaves: the whitened error, and how sure its parameters are."""
