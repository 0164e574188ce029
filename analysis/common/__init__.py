"""What the studies share: the runner, targets, tables and figures."""
