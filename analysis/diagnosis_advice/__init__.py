"""Visibility at which one cause is distinguished from another, and what advised experiments add."""
