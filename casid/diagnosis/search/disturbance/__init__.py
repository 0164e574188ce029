"""Causes against a random disturbance, which may explain as much as they do."""
