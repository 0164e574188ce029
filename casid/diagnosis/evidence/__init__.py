"""Tests: what the residual and the samples say before any candidate is refitted."""
