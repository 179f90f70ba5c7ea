"""Detection of road users and lane lines in images; all results are in pixels, none in metres."""
