"""Random forces that nobody recorded: their spectra, and the parameters estimated beside them."""
