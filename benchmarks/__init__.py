"""Benchmarks of casid against other packages and against its own promises."""
