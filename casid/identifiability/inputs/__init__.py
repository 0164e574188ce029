"""Unknown inputs: their elimination and their classes."""
