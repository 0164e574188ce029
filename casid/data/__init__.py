"""What was measured: records, experiments and problems; preparation and data quality."""
