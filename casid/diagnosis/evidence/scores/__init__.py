"""Which effects of the catalogue lower the misfit to first order: score tests of all at once."""
