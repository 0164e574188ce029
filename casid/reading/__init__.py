"""Records from files: sources, tables, columns, cells, clocks."""
