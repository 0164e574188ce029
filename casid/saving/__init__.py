"""Results kept in files: JSON, Parquet and CasADi's own serialisation, and read again."""
