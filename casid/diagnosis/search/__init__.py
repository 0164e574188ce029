"""The search for causes: candidates, joint refits and forward selection."""
