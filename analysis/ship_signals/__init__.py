"""What the ship's signals depend on (section 8.2), from the simulator's own linear model."""
