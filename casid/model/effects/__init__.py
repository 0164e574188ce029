"""Effects: named, parameterised extensions of a model or of a sensor, each with its null value."""
