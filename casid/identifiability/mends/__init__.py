"""What would mend a deficiency: sensors, experiments, replicas, known values."""
