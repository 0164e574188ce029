"""Records from CSV and Parquet files: tables, columns, units and clocks."""
