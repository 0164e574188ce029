"""Dynamic networks in which some nodes have no sensor."""
