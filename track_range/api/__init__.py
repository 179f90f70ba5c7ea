"""What `import track_range` offers beside types and runs: parts for use on their own, and evaluations."""
