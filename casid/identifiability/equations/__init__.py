"""Equations whose identifiability is assessed: from files, text, or a fitted model."""
