"""Signals that no disturbance reaches: instruments, and whether a reference may make them."""
