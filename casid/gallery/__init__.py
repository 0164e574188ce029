"""Worked cases as pages, scripts and notebooks."""
