"""Sampled linear models, the difference equations that they obey, and their way back."""
