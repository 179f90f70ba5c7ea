"""Results of a run: columns, tables in memory, and files."""
