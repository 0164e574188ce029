"""What is known of a misfit without a name: the missing force, its shape, and when it acts."""
