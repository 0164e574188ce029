"""The observability rank: power series over a prime field, with an error bound."""
