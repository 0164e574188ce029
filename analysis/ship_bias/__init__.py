"""What biases the estimate of a weight aboard, and what does not (Linder 2017, section 9.6)."""
