"""Least squares and instrumental variables by cross moments of the data.

The folders are in the order in which they are used; each imports from those above it alone.

- `instruments`: signals that no disturbance reaches;
- `equations`: moment equations, their covariance, and their nonlinear programs;
- `stages`: the estimates, stage after stage, with the errors that each passes on.

`validation` simulates from the reference; `change_detection` watches a sequence of estimates.
"""
