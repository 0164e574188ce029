"""The sensitivity to initial values of Linder (2017), section 8.6, and what it was."""
