"""Which parameters the experiments can determine, and which combinations of them."""
