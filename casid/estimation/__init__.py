"""What the parameters are: criteria, their minimisation, and the uncertainty of the result."""
