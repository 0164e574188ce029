"""Algebra, exact and numeric: rational functions, prime fields, realisation."""
