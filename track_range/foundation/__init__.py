"""What all packages may import: array aliases, files, statistics and per-track state."""
