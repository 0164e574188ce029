"""The exact rank: a system as a program, its power series over a prime field, the error bound."""
