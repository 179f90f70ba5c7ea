"""Parts of the benchmark of collision warnings."""
