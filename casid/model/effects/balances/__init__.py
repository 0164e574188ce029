"""Effects in the balances: forces, frictions, stops, losses, parts that move along."""
