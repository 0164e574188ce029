"""Linear loops: a plant and its controller, in continuous and in sampled time."""
