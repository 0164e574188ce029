"""Records as a simulation takes them: signals in order, gaps filled, measured states."""
