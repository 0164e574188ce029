"""The verdict: causes with sizes and alternatives, the gain, and what remains."""
