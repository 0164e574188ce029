"""The estimators users call: each checks identifiability before it starts."""
