"""Identifiability: which parameters the experiments can tell, from the model's own expressions."""
