"""Many runs: seeds, processes, clusters, and Monte Carlo studies of problems."""
