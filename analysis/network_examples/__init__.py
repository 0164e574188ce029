"""Dynamic networks with unknown inputs: the examples of chapters 3, 4 and 6, and their figures."""
