"""Misfit that no catalogued effect explains: where it acts and what it depends on."""
