"""Unknown inputs: eliminated, classed, counted; and experiments that own or share them."""
