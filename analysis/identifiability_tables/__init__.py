"""Ranks and tables of identifiability in Linder (2017), chapters 7 and 8, decided exactly."""
