"""Causes that a record cannot separate or detect, and experiments that can."""
