"""The model that a fit leaves: simulated, predicted with, compared and written out."""
