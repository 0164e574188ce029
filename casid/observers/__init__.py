"""Unknown inputs of linear systems: observers that do not see them, and their reconstruction."""
