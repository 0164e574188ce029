"""What is left in the whitened residual: forces as functions of the motion, peaks and bursts."""
