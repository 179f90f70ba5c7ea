"""Detection of lane lines with networks or edges, and tracking of the ego lane."""
