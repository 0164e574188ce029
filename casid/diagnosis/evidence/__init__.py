"""Evidence of a missing effect: whitened residuals, score tests and signatures."""
