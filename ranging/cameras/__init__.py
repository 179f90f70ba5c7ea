"""The one posterior of the cameras of a drive, its evidence, and doubt about what was given."""
