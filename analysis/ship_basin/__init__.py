"""Chapter 9 made again: the weight aboard a model ship from minute-long records in a basin."""
