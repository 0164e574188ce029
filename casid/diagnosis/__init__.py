"""What the simulation of a model gets wrong, why, and what naming the cause gains."""
