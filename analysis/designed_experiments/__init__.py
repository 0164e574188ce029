"""How much sooner designed inputs decide between two causes than searched standard ones."""
