"""The simulation error: a model integrated with its sensitivities, compared with records."""
