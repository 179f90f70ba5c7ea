"""What the parts of a run report: notes for the user and entries of summary.json."""
