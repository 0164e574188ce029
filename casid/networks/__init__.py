"""Dynamic networks: node sets, elimination of unknown nodes, and what may be concluded from it."""
