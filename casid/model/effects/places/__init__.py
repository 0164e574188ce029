"""Where effects act: balances, relative motions between bodies, and vectors in a plane."""
