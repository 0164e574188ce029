"""What given records tell: excitation, expected errors, profiles."""
