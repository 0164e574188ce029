"""Fleets: many records of many assets, one table of causes, errors controlled over all of them."""
