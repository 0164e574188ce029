"""Modules of a network estimated from records: least squares, instruments, two stages, joint."""
