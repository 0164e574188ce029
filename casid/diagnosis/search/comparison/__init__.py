"""How candidates compare: in likelihood, in simulation error, record by record."""
