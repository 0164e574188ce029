"""How sharply dry friction reverses: of candidates, and of causes in the whole records."""
